"""The handle of an instance: a geometry that is placed in a scene. Owns nothing: the scene's store does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..geometry.appearance.material import Material
from .geometry import Geometry

# Bits of a mask. A ray sees the instances whose mask shares a bit with its own.
MASK_BITS = 32
ALL_BITS = 2**MASK_BITS - 1

Colour: TypeAlias = tuple[float, float, float]
"""Linear red, green and blue, 0 to 1."""


def colour_of_row(row: NDArray[np.float64]) -> Colour | None:
    """Return the colour of a row of `SceneState.colours`; None for NaN."""
    return None if np.isnan(row).any() else (float(row[0]), float(row[1]), float(row[2]))


@dataclass(frozen=True, eq=False, repr=False)
class Instance:
    """A geometry at a position in a scene; `Scene.place` makes it.

    Attributes
    ----------
    id : int
        Its number in the scene, from 0 in the order of placing: the `instance_id` of hits.
    name : str
        Unique among the instances of the scene.
    geometry : Geometry
    mask : int, 0 to 2^32 - 1
        A ray sees the instance if its own mask shares a bit with this one.
    colour : (3,) float, or None
        Linear colour in pictures; None: that of the picture's surfaces.
    material : Material, or None
        Of all its primitives; None: those of the geometry.

    Examples
    --------
    >>> import clbvh
    >>> scene = clbvh.Scene()
    >>> ball = scene.add(clbvh.make_shape("icosphere", triangles=320), name="ball")
    >>> left, right = scene.place(ball), scene.place(ball, clbvh.Transform(translate=(5, 0, 0)))
    >>> left
    Instance(0, 'ball', of='ball')
    >>> right.id, right.name, right.geometry is ball
    (1, 'ball 2', True)
    """

    id: int
    name: str
    geometry: Geometry
    mask: int
    colour: tuple[float, float, float] | None = None
    material: Material | None = None

    @property
    def transform(self) -> NDArray[np.float64]:
        """(4, 4) float64: from the geometry's coordinates to the scene's; a copy.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene()
        >>> ball = scene.add(clbvh.make_shape("icosphere", triangles=320))
        >>> scene.place(ball, clbvh.Transform(translate=(5, 0, 0))).transform[:3, 3]
        array([5., 0., 0.])
        """
        return self.geometry.owner.transform(self.id)

    def __repr__(self) -> str:
        return f"Instance({self.id}, {self.name!r}, of={self.geometry.name!r})"
