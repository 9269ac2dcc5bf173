"""The ground below all objects, on which their shadows fall, and the light that goes with it."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .cameras.bounds import SceneBounds
from .cameras.camera import Camera
from .view import View

# The radius up to which shadows are shown, in half diagonals of the box around all objects: a soft shadow of something
# as high as wide ends well within it.
_RADIUS = 4.0

# The ground of `path` lies below the plane by this share of that: surfaces that stand on the plane, and rays that begin
# at them, are above it by more than float32 rounds off.
GROUND_GAP = 2e-5


class Ground(NamedTuple):
    """A plane below all objects.

    Attributes
    ----------
    point : (3,) float64, the scene's coordinates
        Below the middle of the objects.
    normal : (3,) float64
        Unit vector upwards.
    radius : float, the scene's unit
        Up to which shadows are shown.
    """

    point: NDArray[np.float64]
    normal: NDArray[np.float64]
    radius: float


def is_lit_as_studio(view: View, camera: Camera, bounds: SceneBounds) -> bool:
    """Return whether `path` lights a scene without lamps as `studio` does.

    So it does where nobody has chosen a light, other than its direction, and the eye is outside the box around what
    counts: not in a room.
    """
    is_chosen = (replace(view.light, direction=None), view.background) != (View.light, View.background)
    if view.shading != "path" or view.environment is not None or is_chosen:
        return False
    eye = (np.asarray(camera.eye) - bounds.origin) * bounds.scale
    return not ((bounds.local_box[0] < eye) & (eye < bounds.local_box[1])).all()


def shows_ground(view: View) -> bool:
    """Return whether a picture of a scene has a ground."""
    if view.shading == "path":
        return bool(view.ground)
    return view.shading == "studio" and view.ground is not False


def find_ground(bounds: SceneBounds, up: NDArray[np.float64]) -> Ground:
    """Return the highest plane that no object reaches below.

    Parameters
    ----------
    bounds : SceneBounds
        What stands on the ground.
    up : (3,) float64, of any length
    """
    normal = up / np.linalg.norm(up)
    box = bounds.local_box.astype(np.float64)
    middle = box.mean(axis=0)
    point = middle + (bounds.lowest(normal) - middle @ normal) * normal
    half_diagonal = float(np.linalg.norm(np.ptp(box, axis=0))) / 2
    return Ground(bounds.origin + point / bounds.scale, normal, _RADIUS * half_diagonal / bounds.scale)


def sky_direction(view: View, camera: Camera) -> NDArray[np.float64]:
    """Return (3,) float64: the unit vector upwards in the view."""
    # The `up` of a camera with a lens, and that of one that looks straight down, is the picture's, not the world's.
    is_of_world = camera.lens is None and view.side is None
    to_sky = np.asarray(camera.up if is_of_world else view.up, np.float64)
    return to_sky / np.linalg.norm(to_sky)
