"""Wireframes: lines along the edges of triangles, drawn over a picture."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry.appearance.srgb import linear_to_srgb
from ..structs import REPORT_SHADINGS
from .film.settings import find_tone_curve
from .vectors import Vector, check_vector

if TYPE_CHECKING:
    from .scene import Scene

DEFAULT_WIDTH = 1.0
BLACK = (0.0, 0.0, 0.0)

_MAX_WIDTH = 1000.0


@dataclass(frozen=True)
class Wireframe:
    """Lines along the edges of triangles, drawn over what the camera shows; spheres have none.

    Attributes
    ----------
    width : float, pixels
        Above 0, at most 1000. It is the same at any distance.
    colour : (3,) float
        Linear, from 0 to 1. Neither light nor exposure changes it.

    Raises
    ------
    SceneError
        A value is out of range.

    Notes
    -----
    An edge is drawn on the triangle that is seen, on either side of it, so an outline has half the width. Where a
    triangle is lower than 6 widths of the line (6 pixels of a thin one), the line grows fainter, and there is none at
    1.5 widths: a dense mesh shows its surface, and no black. The lines are smooth, and depend on the pixel alone.

    Examples
    --------
    >>> import clbvh
    >>> ball = clbvh.make_shape("icosphere", triangles=320)
    >>> picture = clbvh.render(ball, wireframe=clbvh.Wireframe(width=2), width=64, height=48)
    >>> bool(picture.rgb.mean() < clbvh.render(ball, width=64, height=48).rgb.mean())
    True
    """

    width: float = DEFAULT_WIDTH
    colour: Vector = BLACK

    def __post_init__(self) -> None:
        width = self.width
        if isinstance(width, bool) or not isinstance(width, Real) or not 0 < float(width) <= _MAX_WIDTH:
            raise SceneError(f"the width of a wireframe must be above 0, and at most 1000 pixels, not {width!r}")
        check_vector("the colour of a wireframe", self.colour)
        if not all(0 <= part <= 1 for part in self.colour):
            raise SceneError(f"the colour of a wireframe must be three numbers from 0 to 1, not {self.colour}")


def set_wireframe(view: NDArray[np.void], wireframe: Wireframe, scene: Scene) -> None:
    """Write the lines of a picture into a view.

    Parameters
    ----------
    view : (1,) `structs.VIEW`
    wireframe : Wireframe
    scene : Scene
        Its shading, exposure and tone curve are those of the picture.
    """
    view["line_width"] = wireframe.width
    colour = np.asarray(wireframe.colour, np.float64)
    if scene.shading in REPORT_SHADINGS:
        view["line_colour"] = linear_to_srgb(colour)
        return
    light = _invert_filmic(colour) if find_tone_curve(scene) == "filmic" else colour
    view["line_colour"] = light / 2.0**scene.exposure


def _invert_filmic(colour: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the light that the filmic curve maps to a colour; see cl/film/tone.cl."""
    square, linear, constant = 2.51 - 2.43 * colour, 0.03 - 0.59 * colour, -0.14 * colour
    return (np.sqrt(linear * linear - 4.0 * square * constant) - linear) / (2.0 * square)
