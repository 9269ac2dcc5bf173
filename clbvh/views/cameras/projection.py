"""A camera in words and numbers, as users give them: its projection, its field of view, which way is up, its side.

Owns these values, their checks and their texts. `rays.py` makes rays of projections. Must not import numpy: the help of
the command line reads it.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import Any, Literal

from ...errors import SceneError
from ...support.settings import Kind, Vector, check_settings, number, one_of, setting, vector


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

    height: float | None = setting(None, "From the lower to the upper side of the picture.", number(above=0))

    def __post_init__(self) -> None:
        check_settings(self, "the orthographic ")


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

    angle: float = setting(180.0, "Across the circle, in degrees.", number(above=0, most=360))

    def __post_init__(self) -> None:
        check_settings(self, "the fisheye's ")


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

_KINDS: dict[str, Any] = {"perspective": None, "orthographic": Orthographic, "fisheye": Fisheye, "panorama": Panorama}


def read_projection(value: object) -> Projection | None:
    """Return the projection that a user gives: one, None for perspective, or a text such as ``fisheye:220``.

    Raises
    ------
    SceneError
        The kind is unknown, or it has no value, or not this one.
    TypeError
        This is neither a projection nor a text.

    Examples
    --------
    >>> from clbvh.views.cameras.projection import read_projection
    >>> read_projection("fisheye:220")
    Fisheye(angle=220.0)
    """
    if value is None or isinstance(value, Projection):
        return value
    if not isinstance(value, str):
        raise TypeError
    name, colon, text = value.partition(":")
    kind = _KINDS[one_of(_KINDS).take("the projection", name)]
    if not colon:
        return kind and kind()
    if kind not in (Orthographic, Fisheye):
        raise SceneError(f"the projection {name} has no value: give '{name}' alone")
    try:
        size = float(text)
    except ValueError:
        raise SceneError(f"the value of a projection must be a number, as in {name}:2, not '{text}'") from None
    return kind(size)


PROJECTION = Kind(
    'a clbvh.Orthographic, Fisheye or Panorama, or a text such as "fisheye:220"', read_projection, metavar="KIND"
)


def name_of(projection: Projection | None) -> str:
    """Return the name of a projection's kind."""
    return "perspective" if projection is None else type(projection).__name__.lower()


def text_of(projection: Projection | None) -> str:
    """Return the text of which `read_projection` makes an equal projection.

    Examples
    --------
    >>> import clbvh
    >>> from clbvh.views.cameras.projection import text_of
    >>> text_of(None), text_of(clbvh.Orthographic()), text_of(clbvh.Orthographic(0.1))
    ('perspective', 'orthographic', 'orthographic:0.1')
    """
    values = () if projection is None else astuple(projection)
    return ":".join([name_of(projection), *(repr(value) for value in values if value is not None)])


DEFAULT_FOV = 35.0


def check_focus(projection: Projection | None, aperture: float) -> None:
    """Raise `SceneError` for an aperture of a projection without a plane of focus."""
    if aperture and isinstance(projection, Fisheye | Panorama):
        raise SceneError(f"a {name_of(projection)} camera has no plane of focus: its aperture must be 0")


AUTO: Literal["auto"] = "auto"
DEFAULT_UP: Vector = (0.0, 1.0, 0.0)
_AXES = {
    sign + axis: tuple(length if each == axis else 0.0 for each in "xyz")
    for sign, length in (("", 1.0), ("+", 1.0), ("-", -1.0))
    for axis in "xyz"
}


def read_up(value: Any) -> Any:
    """Return the direction that a user calls up; ``"auto"`` stays.

    Parameters
    ----------
    value : (3,) float, or str
        An axis with or without a sign, such as ``z``, ``+z`` or ``-z``; three numbers such as ``0,0,1``; or ``auto``.

    Raises
    ------
    ValueError, TypeError
        For anything else.

    Examples
    --------
    >>> from clbvh.views.cameras.projection import read_up
    >>> read_up("z"), read_up("-Z"), read_up("0,0,1")
    ((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.0, 0.0, 1.0))
    """
    if not isinstance(value, str):
        return vector().read(value)
    return AUTO if value == AUTO else _AXES.get(value.lower()) or vector().read(value)


UP = Kind('a direction, an axis such as "z" or "-z", or "auto"', read_up, metavar="X,Y,Z|y|-z|auto")
