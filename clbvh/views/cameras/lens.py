"""The intrinsics of a camera: where its pixels lie in the plane at distance 1 from the eye, and its distortion.

Distortion is OpenCV's: radial k1, k2, k3 and tangential p1, p2. A point (x, y) of the plane appears at
``x f + 2 p1 x y + p2 (r^2 + 2 x^2)`` and ``y f + p1 (r^2 + 2 y^2) + 2 p2 x y`` with
``f = 1 + k1 r^2 + k2 r^4 + k3 r^6`` and ``r^2 = x^2 + y^2`` (Brown, "Decentering distortion of lenses", 1966, in the
form of OpenCV's calib3d). There is no formula for the inverse: it is found by Newton's method.

Must not know the position of the camera: that is `pose.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import SceneError
from ...support.settings import number, one_of, whole
from .arrays import read_array, show_matrix

# From the coordinates of a matrix to ours, where the pixel with index j covers the columns j to j + 1, as in OpenGL,
# COLMAP and Open3D. In OpenCV's calibration, whole numbers are the centres of pixels.
_SHIFTS = {"half": 0.0, "integer": 0.5}

# Largest focal length and largest offset of the principal point, in picture sizes; the inverse is the smallest focal
# length. Beyond these, float32 cannot tell the field of view from 0 or from 180 degrees.
_MOST = 10**9

# Tolerance of the aspect ratio, in pixels of either side: half of an odd side is no whole number.
_SHAPE_SLACK_PIXELS = 1.0


@dataclass(frozen=True)
class Lens:
    """The intrinsics of a camera for a picture of one size, in pixels.

    Attributes
    ----------
    fx, fy : float
        Focal lengths.
    cx, cy : float
        Principal point, from the left and upper sides of the picture: the centre of the pixel in row i and column j is
        at (j + 0.5, i + 0.5).
    skew : float
        Entry (0, 1) of the matrix; 0 if rows and columns are at right angles.
    width, height : int
        Size of the picture.
    distortion : (5,) float or None
        OpenCV's k1, k2, p1, p2 and k3; k3 may be left out. None: a pinhole.

    Raises
    ------
    SceneError
        A focal length is not above 0, a value is out of range, or the distortion folds inside the picture.

    Examples
    --------
    >>> import clbvh
    >>> lens = clbvh.Lens.from_matrix([[500, 0, 310], [0, 510, 250], [0, 0, 1]], (640, 480))
    >>> camera = clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0), lens=lens)
    >>> lens.fx, lens.cy, round(camera.fov, 3)
    (500.0, 250.0, 50.388)
    """

    fx: float
    fy: float
    cx: float
    cy: float
    skew: float
    width: int
    height: int
    distortion: tuple[float, float, float, float, float] | None = None

    def __post_init__(self) -> None:
        for name, side in zip(("width", "height"), check_size(self.width, self.height), strict=True):
            object.__setattr__(self, name, side)
        for name in ("fx", "fy", "cx", "cy", "skew"):
            object.__setattr__(self, name, number().take(f"the camera's {name}", getattr(self, name)))
        for name, value, side in (("fx", self.fx, self.width), ("fy", self.fy, self.height)):
            if not value > 0:
                raise SceneError(
                    f"the camera's {name} must be above 0, not {value:g}: the matrix looks along +z of the image, and "
                    f"`convention` says which axes the pose has"
                )
            if not 1 / _MOST <= value / side <= _MOST:
                raise SceneError(f"the camera's {name} of {value:g} pixels is no focal length for a side of {side}")
        if max(abs(self.cx / self.width), abs(self.cy / self.height), abs(self.skew) / self.fx) > _MOST:
            raise SceneError(
                f"the camera's principal point ({self.cx:g}, {self.cy:g}) and skew {self.skew:g} are too far from a "
                f"picture of {self.width} x {self.height}"
            )
        object.__setattr__(self, "distortion", read_distortion(self.distortion))
        if self.distortion is not None:
            check_invertible(window_of(self), self.distortion)

    @classmethod
    def from_matrix(
        cls, matrix: ArrayLike, size: tuple[int, int], pixel_centres: str = "half", distortion: ArrayLike | None = None
    ) -> Lens:
        """Return the lens of an intrinsic matrix, see `Camera.from_intrinsics`.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Lens.from_matrix([[500, 0, 320], [0, 500, 240], [0, 0, 1]], (640, 480)).cx
        320.0
        """
        try:
            width, height = size
        except (TypeError, ValueError) as error:
            raise SceneError(f"the camera's size must be (width, height) in pixels, not {size!r}") from error
        shift = _find_shift(pixel_centres)
        k = read_array("the camera's intrinsic matrix", matrix, (3, 3))
        if k[1, 0] or k[2, 0] or k[2, 1] or k[2, 2] != 1:
            raise SceneError(
                f"the camera's intrinsic matrix must be [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], not {show_matrix(k)}"
            )
        (fx, skew, cx), (_, fy, cy), _ = k.tolist()
        return cls(fx, fy, cx + shift, cy + shift, skew, width, height, read_distortion(distortion))

    @classmethod
    def from_fov(cls, fov: float, width: int, height: int) -> Lens:
        """Return the lens with this vertical field of view in degrees, square pixels and a centred principal point.

        Examples
        --------
        >>> import clbvh
        >>> lens = clbvh.Lens.from_fov(90, 640, 480)
        >>> round(lens.fx, 6), lens.cx, lens.cy
        (240.0, 320.0, 240.0)
        """
        width, height = check_size(width, height)
        focal = height / 2 / math.tan(math.radians(fov) / 2)
        return cls(focal, focal, width / 2, height / 2, 0.0, width, height)

    def matrix(self, pixel_centres: str = "half") -> NDArray[np.float64]:
        """Return the intrinsic matrix, (3, 3) float64, pixels.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Lens.from_fov(90, 640, 480).matrix().round(6)
        array([[240.,   0., 320.],
               [  0., 240., 240.],
               [  0.,   0.,   1.]])
        """
        shift = _find_shift(pixel_centres)
        return np.array([[self.fx, self.skew, self.cx - shift], [0.0, self.fy, self.cy - shift], [0.0, 0.0, 1.0]])

    def resized(self, width: int, height: int) -> Lens:
        """Return the lens for a picture of another size that shows the same view.

        Raises
        ------
        SceneError
            The other size has another aspect ratio.

        Examples
        --------
        >>> import clbvh
        >>> half = clbvh.Lens.from_fov(90, 640, 480).resized(320, 240)
        >>> half.width, half.cx, round(half.fx, 6)
        (320, 160.0, 120.0)
        """
        if (width, height) == (self.width, self.height):
            return self
        width, height = check_size(width, height)
        off_width = abs(width - height * self.width / self.height)
        off_height = abs(height - width * self.height / self.width)
        if min(off_width, off_height) > _SHAPE_SLACK_PIXELS:
            raise SceneError(
                f"the camera's intrinsics are those of a picture of {self.width} x {self.height}, and {width} x "
                f"{height} has another aspect ratio: give a size of the same one, or make the camera for that size"
            )
        across, down = width / self.width, height / self.height
        return replace(
            self, fx=self.fx * across, fy=self.fy * down, cx=self.cx * across, cy=self.cy * down,
            skew=self.skew * across, width=width, height=height,
        )  # fmt: skip

    def complete_size(self, width: int | None, height: int | None) -> tuple[int, int]:
        """Return the size of a picture; missing sides follow from the lens's size and aspect ratio.

        Raises
        ------
        SceneError
            A side is no number of pixels, or the size has another aspect ratio.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Lens.from_fov(90, 640, 480).complete_size(None, 240)
        (320, 240)
        """
        if width is None:
            width = self.width if height is None else max(1, round(check_size(1, height)[1] * self.width / self.height))
        if height is None:
            height = max(1, round(check_size(width, 1)[0] * self.height / self.width))
        resized = self.resized(width, height)
        return resized.width, resized.height

    @property
    def fov(self) -> float:
        """The angle from the upper to the lower side of the picture at the principal point's column, in degrees.

        Without distortion.
        """
        above, below = self.cy / self.fy, (self.height - self.cy) / self.fy
        # The sum of both arc tangents, without cancellation where the principal point is far outside the picture.
        return math.degrees(math.atan2(above + below, 1 - above * below))


def window_of(lens: Lens) -> Window:
    """Return the picture of a lens in the plane at distance 1."""
    half_width, half_height = lens.width / 2, lens.height / 2
    centre_x, centre_y = (half_width - lens.cx) / lens.fx, (lens.cy - half_height) / lens.fy
    return Window(half_width / lens.fx, half_height / lens.fy, centre_x, centre_y, lens.skew / lens.fx)


_SIDES = whole(1, _MOST)


def check_size(width: Any, height: Any) -> tuple[int, int]:
    """Return the sides of a picture in pixels; raise `SceneError` for anything else."""
    return _SIDES.take("the width of a camera's picture", width), _SIDES.take(
        "the height of a camera's picture", height
    )


def _find_shift(pixel_centres: str) -> float:
    return _SHIFTS[one_of(_SHIFTS).take("pixel_centres", pixel_centres)]


class Window(NamedTuple):
    """The picture in a plane, for perspective the one at distance 1: x to the right and y up from the optical axis.

    A point (a, b) of the picture, each from -1 to 1 and b upwards, is at ``y = centre_y + b * half_height`` and
    ``x = centre_x + a * half_width + shear * y``.
    """

    half_width: float
    half_height: float
    centre_x: float = 0.0
    centre_y: float = 0.0
    shear: float = 0.0

    def points(self, film_x: Any, film_y: Any) -> tuple[Any, Any]:
        """Return x and y of points of the picture: numbers, or arrays that broadcast."""
        y = self.centre_y + film_y * self.half_height
        x = self.centre_x + film_x * self.half_width
        return (x + self.shear * y if self.shear else x), y

    def film(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Return the points of the picture at x and y of the plane."""
        across = x - self.shear * y if self.shear else x
        return (across - self.centre_x) / self.half_width, (y - self.centre_y) / self.half_height


# k1, k2, p1, p2, k3: OpenCV's order.
Coefficients = tuple[float, float, float, float, float]

_COUNTS = (4, 5)

# Steps of Newton's method. From the distorted point, four suffice for mild lenses in float64, ten close to a fold.
_MOST_STEPS = 30

# Residual of a solution, in shares of its distance from the middle, or of 1.
_SOLVED = 1e-12

# Points along each side at which a picture is checked, and steps on the way to each from the principal point.
_CHECKED_POINTS = 33
_CHECKED_STEPS = 16

# The way along a line of the picture and the direct one lead to the same point, within this share.
_SAME = 1e-6

# The determinant of the derivatives is 1 in the middle and 0 at a fold, beyond which the lens would show points again.
_LEAST_DETERMINANT = 1e-3

# The picture is checked with this margin, in shares of half its size: samples of a pixel reach beyond its square.
_CHECKED_MARGIN = 0.01

_Array = NDArray[np.float64]


def read_distortion(values: ArrayLike | None) -> Coefficients | None:
    """Return five coefficients of four or five numbers, of any shape as OpenCV returns them; None without distortion.

    Raises
    ------
    SceneError
        Another count, or no finite numbers.
    """
    if values is None:
        return None
    try:
        numbers = np.asarray(values, np.float64).ravel().tolist()
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) not in _COUNTS or not all(map(math.isfinite, numbers)):
        raise SceneError(
            f"the camera's distortion must be OpenCV's k1, k2, p1, p2 and perhaps k3, four or five finite numbers, not "
            f"{values!r}: the models with more of them are not known here"
        )
    k1, k2, p1, p2, k3 = (*numbers, 0.0)[: max(_COUNTS)]
    return (k1, k2, p1, p2, k3) if any(numbers) else None


def upwards(coefficients: Coefficients) -> Coefficients:
    """Return the coefficients for coordinates with y upwards: OpenCV's go downwards."""
    k1, k2, p1, p2, k3 = coefficients
    return k1, k2, -p1, p2, k3


def distort(x: _Array, y: _Array, coefficients: Coefficients) -> tuple[_Array, _Array]:
    """Return where the lens shows points of the plane."""
    k1, k2, p1, p2, k3 = coefficients
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    return (
        x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
        y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
    )


def undistort(x: _Array, y: _Array, coefficients: Coefficients) -> tuple[_Array, _Array]:
    """Return the points of the plane that the lens shows at (x, y); NaN where Newton's method finds none."""
    with np.errstate(all="ignore"):
        u, v = _solve(x, y, x, y, coefficients, _MOST_STEPS)
        is_found = is_near(distort(u, v, coefficients), (x, y), _SOLVED) & (_derive(u, v, coefficients)[3] > 0)
    return np.where(is_found, u, np.nan), np.where(is_found, v, np.nan)


def is_near(points: tuple[_Array, _Array], expected: tuple[_Array, _Array], tolerance: float) -> NDArray[np.bool_]:
    """Return whether points are where they should be, within a share of the distance from the middle, or of 1."""
    off = np.hypot(points[0] - expected[0], points[1] - expected[1])
    return off <= tolerance * np.maximum(1.0, np.hypot(*expected))


def check_invertible(window: Window, distortion: Coefficients) -> None:
    """Raise `SceneError` unless each point of a picture shows one point of the plane.

    That point is followed from the principal point, where there is no distortion, along a straight line of the picture:
    the derivatives must not become singular on the way, and `undistort` must find the same point.

    Parameters
    ----------
    window : Window
        Of the picture, with y upwards.
    distortion : Coefficients
        OpenCV's.
    """
    coefficients = upwards(distortion)
    side = np.linspace(-1 - _CHECKED_MARGIN, 1 + _CHECKED_MARGIN, _CHECKED_POINTS)
    x, y = window.points(side[None, :], side[:, None])
    u = v = np.zeros((len(side), len(side)))
    is_good = np.ones(u.shape, bool)
    with np.errstate(all="ignore"):
        for step in range(1, _CHECKED_STEPS + 1):
            share = step / _CHECKED_STEPS
            u, v = _solve(x * share, y * share, u, v, coefficients, _MOST_STEPS // 2)
            is_good &= _derive(u, v, coefficients)[3] > _LEAST_DETERMINANT
        is_good &= is_near(undistort(x, y, coefficients), (u, v), _SAME)
    if not is_good.all():
        row, column = np.argwhere(~is_good)[0]
        raise SceneError(
            f"the camera's distortion {distortion} has no inverse in all of its picture: near "
            f"({side[column]:.2f}, {side[row]:.2f}), from -1 to 1 and y upwards, it folds, and pixels have several "
            f"rays or none. Give a smaller picture, or coefficients that were fitted up to the corners"
        )


def _solve(
    x: _Array, y: _Array, u: _Array, v: _Array, coefficients: Coefficients, step_count: int
) -> tuple[_Array, _Array]:
    """Return the points that are shown at (x, y), by Newton's method from (u, v)."""
    for _ in range(step_count):
        shown_x, shown_y = distort(u, v, coefficients)
        off_x, off_y = shown_x - x, shown_y - y
        uu, uv, vv, determinant = _derive(u, v, coefficients)
        step_u = (vv * off_x - uv * off_y) / determinant
        step_v = (uu * off_y - uv * off_x) / determinant
        u, v = u - step_u, v - step_v
        if not (np.abs(step_u) + np.abs(step_v) > _SOLVED).any():
            break
    return u, v


def _derive(u: _Array, v: _Array, coefficients: Coefficients) -> tuple[_Array, _Array, _Array, _Array]:
    """Return the derivatives of x by u, of x by v, which is that of y by u, and of y by v; and their determinant."""
    k1, k2, p1, p2, k3 = coefficients
    square = u * u + v * v
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    slope = 2 * (k1 + square * (2 * k2 + square * 3 * k3))
    uu = radial + u * u * slope + 2 * p1 * v + 6 * p2 * u
    uv = u * v * slope + 2 * p1 * u + 2 * p2 * v
    vv = radial + v * v * slope + 6 * p1 * v + 2 * p2 * u
    return uu, uv, vv, uu * vv - uv * uv
