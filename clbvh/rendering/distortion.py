"""Lens distortion as in OpenCV: radial k1, k2, k3 and tangential p1, p2, in the plane at distance 1 from the eye.

A point (x, y) of the plane appears at ``x f + 2 p1 x y + p2 (r^2 + 2 x^2)`` and ``y f + p1 (r^2 + 2 y^2) + 2 p2 x y``
with ``f = 1 + k1 r^2 + k2 r^4 + k3 r^6`` and ``r^2 = x^2 + y^2`` (Brown, "Decentering distortion of lenses", 1966, in
the form of OpenCV's calib3d). There is no formula for the inverse: it is found by Newton's method.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError
from .finite_number import is_finite_number
from .window import Window

# k1, k2, p1, p2, k3: OpenCV's order.
Coefficients = tuple[float, float, float, float, float]

_COUNT = 5
_COUNT_WITHOUT_K3 = 4

# Steps of Newton's method. From the distorted point, four suffice for mild lenses in float64, ten close to a fold.
_MOST_STEPS = 30

# Residual of a solution, in shares of its distance from the middle, or of 1.
_SOLVED = 1e-12

# Points along each side at which a picture is checked, and steps on the way to each from the principal point.
_CHECKED_POINTS = 33
_CHECKED_STEPS = 16

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
        numbers = np.asarray(values, np.float64).ravel()
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if len(numbers) not in (_COUNT_WITHOUT_K3, _COUNT) or not all(map(is_finite_number, numbers.tolist())):
        raise SceneError(
            f"the camera's distortion must be OpenCV's k1, k2, p1, p2 and perhaps k3, four or five finite numbers, not "
            f"{values!r}: the models with more of them are not known here"
        )
    k1, k2, p1, p2, *rest = numbers.tolist()
    coefficients = (k1, k2, p1, p2, rest[0] if rest else 0.0)
    return coefficients if any(coefficients) else None


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
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        u, v = _solve(x, y, x, y, coefficients, _MOST_STEPS)
        again = distort(u, v, coefficients)
        slack = _SOLVED * np.maximum(1.0, np.hypot(x, y))
        is_found = (np.hypot(again[0] - x, again[1] - y) <= slack) & (
            _determinant(_derivatives(u, v, coefficients)) > 0
        )
    return np.where(is_found, u, np.nan), np.where(is_found, v, np.nan)


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
    x, y = np.broadcast_arrays(x, y)
    u, v = np.zeros_like(x), np.zeros_like(y)
    is_good = np.ones(x.shape, bool)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for step in range(1, _CHECKED_STEPS + 1):
            share = step / _CHECKED_STEPS
            u, v = _solve(x * share, y * share, u, v, coefficients, _MOST_STEPS // 2)
            is_good &= _determinant(_derivatives(u, v, coefficients)) > _LEAST_DETERMINANT
        again = undistort(x, y, coefficients)
        is_good &= np.hypot(again[0] - u, again[1] - v) <= 1e-6 * np.maximum(1.0, np.hypot(u, v))
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
        uu, uv, vv = derivatives = _derivatives(u, v, coefficients)
        determinant = _determinant(derivatives)
        step_u = (vv * off_x - uv * off_y) / determinant
        step_v = (uu * off_y - uv * off_x) / determinant
        u, v = u - step_u, v - step_v
        if not (np.abs(step_u) + np.abs(step_v) > _SOLVED).any():
            break
    return u, v


def _derivatives(u: _Array, v: _Array, coefficients: Coefficients) -> tuple[_Array, _Array, _Array]:
    """Return the derivatives of x by u, of x by v, which is that of y by u, and of y by v."""
    k1, k2, p1, p2, k3 = coefficients
    square = u * u + v * v
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    slope = 2 * (k1 + square * (2 * k2 + square * 3 * k3))
    return (
        radial + u * u * slope + 2 * p1 * v + 6 * p2 * u,
        u * v * slope + 2 * p1 * u + 2 * p2 * v,
        radial + v * v * slope + 6 * p1 * v + 2 * p2 * u,
    )


def _determinant(derivatives: tuple[_Array, _Array, _Array]) -> _Array:
    uu, uv, vv = derivatives
    return uu * vv - uv * uv
