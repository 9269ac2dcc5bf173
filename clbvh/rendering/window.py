"""The rectangle that a picture covers in the plane of its projection."""

from __future__ import annotations

from typing import Any, NamedTuple


class Window(NamedTuple):
    """The picture in a plane, for perspective the one at distance 1: x to the right and y up from the optical axis.

    A point (a, b) of the picture, each from -1 to 1 and b upwards, is at ``y = centre_y + b * half_height`` and
    ``x = centre_x + a * half_width + shear * y``.
    """

    centre_x: float
    centre_y: float
    half_width: float
    half_height: float
    shear: float

    def points(self, film_x: Any, film_y: Any) -> tuple[Any, Any]:
        """Return x and y of points of the picture: numbers, or arrays that broadcast."""
        y = self.centre_y + film_y * self.half_height
        x = self.centre_x + film_x * self.half_width
        if self.shear:
            x = x + self.shear * y
        return x, y

    def film(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Return the points of the picture at x and y of the plane."""
        across = x - self.shear * y if self.shear else x
        return (across - self.centre_x) / self.half_width, (y - self.centre_y) / self.half_height
