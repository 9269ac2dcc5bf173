"""The light of a scene."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from ..errors import SceneError
from .vectors import Vector, check_vector


@dataclass(frozen=True)
class Light:
    """A directed light, and ambient light from the sky and the ground. Colours are linear, 0 to 1.

    Attributes
    ----------
    direction : (3,) float, or None
        Towards the light, in the scene's coordinates. None: from behind the viewer's left shoulder.
    colour : (3,) float
        Of the directed light, on a surface that faces it.
    sky, ground : (3,) float
        On a surface that faces up, and one that faces down.

    Raises
    ------
    SceneError
        A value is not three finite numbers, or the direction is zero.

    Examples
    --------
    >>> import clbvh
    >>> light = clbvh.Light(direction=(0, 1, 0), sky=(0.3, 0.3, 0.35))
    >>> picture = clbvh.render(clbvh.Scene(clbvh.MeshSource(shape="icosphere", triangles=1000), light=light))
    """

    direction: Vector | None = None
    colour: Vector = (0.92, 0.88, 0.82)
    sky: Vector = (0.19, 0.21, 0.24)
    ground: Vector = (0.07, 0.065, 0.06)

    def __post_init__(self) -> None:
        for name in ("colour", "sky", "ground"):
            check_vector(f"the light's {name}", getattr(self, name))
        if self.direction is not None:
            check_vector("the light's direction", self.direction)
            if not any(self.direction):
                raise SceneError("the light's direction must not be zero")

    def with_direction(self, direction: Vector | None) -> Light:
        """Return a copy with another direction.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Light().with_direction((0, 1, 0)).direction
        (0, 1, 0)
        """
        return dataclasses.replace(self, direction=direction)


DEFAULT_LIGHT = Light()
