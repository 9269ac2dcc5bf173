"""The tables by which paths draw light from an environment; see cl/film/lights.cl."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.appearance.srgb import LUMINANCE
from ..views.view import View

# Shares of a pixel's area in which its neighbours on either side, and the pixel itself, make the light between the
# centres of pixels: the integral of the linear interpolation over the pixel.
_BESIDE, _WITHIN = 1 / 8, 6 / 8

# Beyond this share along x, the direction upwards has no clear x axis at right angles to it, and y takes its place.
_MOST_ALONG_X = 0.9


class EnvironmentTables(NamedTuple):
    """The tables, by the names of the kernels' arguments.

    Attributes
    ----------
    arrays : dict of str to array
        Empty for a black environment, from which nothing is drawn.
    width, height : int
        Pixels; 0 for a black one.
    """

    arrays: dict[str, NDArray[np.float32]]
    width: int
    height: int

    def describe(self, kernel_view: NDArray[np.void], view: View) -> None:
        """Fill what the kernel's view, (1,) `structs.VIEW`, says of the environment of a scene.

        The automatic light belongs to the gradient that the environment replaces: it goes out.
        """
        if view.light.direction is None:
            kernel_view["has_sun"] = 0
        front, right = find_axes(kernel_view["to_sky"][0].astype(np.float64), view.environment_rotation)
        kernel_view["environment_front"], kernel_view["environment_right"] = front, right
        kernel_view["environment_strength"] = view.environment_strength
        kernel_view["environment_width"], kernel_view["environment_height"] = self.width, self.height
        if self.width == 0 or view.environment_strength == 0:
            # A gradient from black to black.
            kernel_view["environment_width"] = kernel_view["environment_height"] = 0
            kernel_view["background_top"] = kernel_view["background_bottom"] = 0.0


def find_axes(up: NDArray[np.float64], rotation: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return two (3,) float64 unit vectors: to the middle column of the environment, and to the right of it.

    The middle is along +x, as in Blender and three.js, at a right angle to the direction upwards; along +y where that
    is nearly x. The rotation is in degrees, counter-clockwise seen from above.
    """
    axis = np.array([0.0, 1.0, 0.0] if abs(up[0]) > _MOST_ALONG_X else [1.0, 0.0, 0.0])
    front = axis - (axis @ up) * up
    front /= np.linalg.norm(front)
    left = np.cross(up, front)
    angle = np.radians(rotation)
    return np.cos(angle) * front + np.sin(angle) * left, np.sin(angle) * front - np.cos(angle) * left


def make_environment_tables(pixels: NDArray[np.float32]) -> EnvironmentTables:
    """Return the tables of a panorama.

    Pixels are drawn in proportion to the luminance of the light that is interpolated within them, times their solid
    angle: then a dark pixel beside a bright one is drawn for the light that it gets from there.

    Parameters
    ----------
    pixels : (h, w, 3) float32, linear, 0 or more
    """
    height, width, _ = pixels.shape
    light = pixels.astype(np.float64) @ LUMINANCE
    light = _WITHIN * light + _BESIDE * (np.roll(light, 1, axis=1) + np.roll(light, -1, axis=1))
    rows = np.r_[0, np.arange(height), height - 1]
    light = _WITHIN * light + _BESIDE * (light[rows[:-2]] + light[rows[2:]])
    light *= solid_angles(width, height)[:, None]
    columns = np.cumsum(light, axis=1)
    row_light = columns[:, -1].copy()
    total = np.cumsum(row_light)
    if not total[-1] > 0:
        return EnvironmentTables({}, 0, 0)
    # A black row is never drawn, but its sums end with 1, as all do.
    columns[row_light == 0] = np.arange(1, width + 1)
    columns /= columns[:, -1:]
    arrays: dict[str, Any] = {
        "environment": np.ascontiguousarray(pixels, np.float32),
        "environment_rows": (total / total[-1]).astype(np.float32),
        "environment_columns": columns.astype(np.float32),
    }
    return EnvironmentTables(arrays, width, height)


def solid_angles(width: int, height: int) -> NDArray[np.float64]:
    """Return (height,) float64: the solid angle of one pixel of each row."""
    latitudes = np.pi / height * np.arange(height + 1)
    # cos a - cos b, without cancellation near the poles.
    middles, half_row = (latitudes[1:] + latitudes[:-1]) / 2, np.pi / (2 * height)
    return 4 * np.pi / width * np.sin(middles) * np.sin(half_row)
