"""Projections other than perspective, as users give them to cameras and scenes.

Owns their values and the checks of these. `ray_model.py` makes rays of them.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any

from ...errors import SceneError
from ..vectors import is_finite_number

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


def as_named(projection: Projection | None) -> dict[str, Any] | None:
    """Return a projection as plain values: its kind, and its own."""
    return None if projection is None else {"kind": name_of(projection), **asdict(projection)}


def from_named(values: object) -> Projection | None:
    """Return the projection of plain values, as `as_named` makes them; None for perspective.

    Raises
    ------
    SceneError
        The kind is unknown, or a value is not one of that kind.
    """
    if values is None:
        return None
    if not isinstance(values, dict):
        raise SceneError(f"the camera's projection must be a table, not {type(values).__name__}")
    values = dict(values)
    name = values.pop("kind", None)
    kind = find_kind(name)
    known = [] if kind is None else [each.name for each in fields(kind)]
    for other in values:
        if other not in known:
            raise SceneError(f"a camera of the kind {name} has no {other}")
    return None if kind is None else kind(**values)


def parse_projection(text: str) -> Projection | None:
    """Return the projection of the command line: a kind, and perhaps its value, as in ``fisheye:220``.

    Raises
    ------
    SceneError
        The kind is unknown, or it has no value, or not this one.
    """
    name, colon, value = text.partition(":")
    kind = find_kind(name)
    if not colon:
        return None if kind is None else kind()
    if kind not in (Orthographic, Fisheye):
        raise SceneError(f"a camera of the kind {name} has no value: give '{name}' alone")
    try:
        number = float(value)
    except ValueError as error:
        raise SceneError(f"the value of a camera must be a number, as in {name}:2, not '{value}'") from error
    return kind(number)


def find_kind(name: object) -> type[Projection] | None:
    """Return the class of a projection's name, None for perspective; raise `SceneError` for an unknown one."""
    if not isinstance(name, str) or name not in PROJECTION_KINDS:
        raise SceneError(f"the camera's kind must be one of {', '.join(PROJECTION_KINDS)}, not {name!r}")
    return PROJECTION_KINDS[name]


def name_of(projection: Projection | None) -> str:
    """Return the name of a projection's kind."""
    if projection is None:
        return "perspective"
    return next(name for name, kind in PROJECTION_KINDS.items() if kind is not None and isinstance(projection, kind))
