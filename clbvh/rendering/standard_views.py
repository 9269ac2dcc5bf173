"""Standard views: the side that is seen, and the direction that is up in its picture."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from .vectors import Vector

# The sides in the order of a contact sheet.
STANDARD_VIEWS = ("front", "right", "back", "left", "top", "bottom", "iso")

# Degrees to the right of the front, and above the level. The automatic view is from the front, a little from the right
# and from above; in the isometric one the three axes have equal lengths.
_AUTOMATIC = 30.0, 18.0
_ISOMETRIC = 45.0, math.degrees(math.atan(math.sqrt(0.5)))

_Vector = NDArray[np.float64]


def check_view(name: object) -> None:
    """Raise `SceneError` unless this is one of `STANDARD_VIEWS`."""
    if not isinstance(name, str) or name not in STANDARD_VIEWS:
        raise SceneError(f"the view must be one of {', '.join(STANDARD_VIEWS)}, not {name!r}")


def find_sides(name: str | None, up: Vector) -> tuple[_Vector, Vector]:
    """Return the unit vector towards the camera, and the direction that is up in the picture.

    Parameters
    ----------
    name : str or None
        One of `STANDARD_VIEWS`. None: the automatic view.
    up : (3,) float
        Up in the scene. The front is +z if y is up, and -y if z is up, as in modelling programs. The front is below in
        the view from the top, and above in that from the bottom.

    Raises
    ------
    SceneError
        Another name, or no direction.
    """
    if name is not None:
        check_view(name)
    upward = np.asarray(up, np.float64)
    if not np.isfinite(upward).all() or not np.linalg.norm(upward) > 0:
        raise SceneError(f"the camera's up must be a finite direction of length above 0, not {up}")
    upward = upward / np.linalg.norm(upward)
    front = np.array([0.0, 0.0, 1.0]) if abs(upward[2]) < abs(upward[1]) else np.array([0.0, -1.0, 0.0])
    front = front - upward * (front @ upward)
    front /= np.linalg.norm(front)
    right = np.cross(upward, front)
    match name:
        case "front" | "back":
            return (front if name == "front" else -front), up
        case "right" | "left":
            return (right if name == "right" else -right), up
        case "top" | "bottom":
            x, y, z = (-front if name == "top" else front).tolist()
            return (upward if name == "top" else -upward), (x, y, z)
    azimuth, elevation = map(math.radians, _AUTOMATIC if name is None else _ISOMETRIC)
    level = math.cos(azimuth) * front + math.sin(azimuth) * right
    return math.cos(elevation) * level + math.sin(elevation) * upward, up
