"""Projections other than perspective, as users give them to cameras and scenes.

Owns their values and the checks of these. `ray_model.py` makes rays of them.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import SceneError
from .finite_number import is_finite_number

_FULL_TURN = 360.0


@dataclass(frozen=True)
class Orthographic:
    """Parallel rays: no perspective, equal lengths are equal in the picture.

    The rays begin in the plane through the camera's eye, at right angles to its line of sight: nothing behind that
    plane is seen.

    Attributes
    ----------
    height : float or None, the scene's units
        From the lower to the upper side of the picture. None, for scenes only: chosen so that everything is visible.

    Raises
    ------
    SceneError
        The height is not a finite number above 0.

    Examples
    --------
    >>> import clbvh
    >>> camera = clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0), projection=clbvh.Orthographic(height=2))
    >>> origins, directions = camera.rays(width=2, height=2)
    >>> origins[0].tolist(), directions[0, 0].tolist()
    ([[-0.5, 0.5, 5.0], [0.5, 0.5, 5.0]], [0.0, 0.0, -1.0])
    """

    height: float | None = None

    def __post_init__(self) -> None:
        if self.height is None:
            return
        if not is_finite_number(self.height) or not self.height > 0:
            raise SceneError(f"the height of an orthographic camera must be a number above 0, not {self.height!r}")
        object.__setattr__(self, "height", float(self.height))


@dataclass(frozen=True)
class Fisheye:
    """An equidistant fisheye: the distance from the middle of the picture is the angle to the line of sight.

    The image is a circle that touches the shorter sides of the picture. Pixels outside it see nothing.

    Attributes
    ----------
    angle : float
        From one side of the circle to the other, in degrees, above 0 and up to 360.

    Raises
    ------
    SceneError
        The angle is out of range.

    Examples
    --------
    >>> import clbvh
    >>> camera = clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0), projection=clbvh.Fisheye(angle=180))
    >>> camera.sees(5, 5).sum()
    np.int64(21)
    """

    angle: float = 180.0

    def __post_init__(self) -> None:
        if not is_finite_number(self.angle) or not 0 < self.angle <= _FULL_TURN:
            raise SceneError(f"the angle of a fisheye must be above 0 and up to 360 degrees, not {self.angle!r}")
        object.__setattr__(self, "angle", float(self.angle))


@dataclass(frozen=True)
class Panorama:
    """An equirectangular panorama: 360 degrees from the left to the right side, 180 from the upper to the lower one.

    The line of sight is in the middle, the camera's up direction is the upper side. Rows and columns have the same
    angles in pictures that are twice as wide as high.

    Examples
    --------
    >>> import clbvh
    >>> camera = clbvh.Camera(eye=(0, 0, 0), look_at=(0, 0, -1), projection=clbvh.Panorama())
    >>> camera.rays(width=4, height=1)[1].round(6).tolist()
    [[[-0.707107, 0.0, 0.707107], [-0.707107, 0.0, -0.707107], [0.707107, 0.0, -0.707107], [0.707107, 0.0, 0.707107]]]
    """


Projection = Orthographic | Fisheye | Panorama

# By the names in scene files and on the command line.
PROJECTION_KINDS: dict[str, type[Projection] | None] = {
    "perspective": None,
    "orthographic": Orthographic,
    "fisheye": Fisheye,
    "panorama": Panorama,
}


def check_projection(projection: object) -> None:
    """Raise `SceneError` unless this is a projection, or None for perspective."""
    if projection is not None and not isinstance(projection, Projection):
        raise SceneError(
            f"the camera's projection must be a clbvh.Orthographic, Fisheye or Panorama, or None, not {projection!r}"
        )


def name_of(projection: Projection | None) -> str:
    """Return the name of a projection's kind."""
    return next(
        name
        for name, kind in PROJECTION_KINDS.items()
        if (projection is None if kind is None else type(projection) is kind)
    )
