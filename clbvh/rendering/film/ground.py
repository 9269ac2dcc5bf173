"""The ground of a picture: a plane below all objects, which shows their shadows or is a surface of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ..scene_extent import SceneExtent
from ..view_bounds import Reaches

if TYPE_CHECKING:
    from ..scene import Scene

# By the shading, whether there is a ground unless the scene says so.
_HAS_GROUND = {"studio": True, "path": False}

# The radius up to which shadows are shown, in half diagonals of the box around all objects: a soft shadow of something
# as high as wide ends well within it.
_RADIUS = 4.0

# The ground of `path` lies below the plane by this share of that: surfaces that stand on the plane, and rays that begin
# at them, are above it by more than float32 rounds off.
GROUND_GAP = 2e-5

# Vertices per step: they stay in the cache.
_CHUNK_VERTICES = 2**16


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


def shows_ground(scene: Scene) -> bool:
    """Return whether a picture of a scene has a ground."""
    if scene.shading not in _HAS_GROUND:
        return False
    return _HAS_GROUND[scene.shading] if scene.ground is None else scene.ground


def find_ground(extent: Mesh | SceneExtent, up: NDArray[np.float64]) -> Ground:
    """Return the highest plane that no object reaches below.

    Parameters
    ----------
    extent : Mesh or SceneExtent
        What stands on the ground.
    up : (3,) float64, of any length
    """
    normal = up / np.linalg.norm(up)
    box = extent.local_box.astype(np.float64)
    if isinstance(extent, SceneExtent):
        lowest = -float(extent.largest(Reaches(-normal[None], np.zeros(1), normal))[0])
    else:
        lowest = _find_lowest(extent, normal)
    middle = box.mean(axis=0)
    point = middle + (lowest - middle @ normal) * normal
    half_diagonal = float(np.linalg.norm(np.ptp(box, axis=0))) / 2
    return Ground(extent.origin + point / extent.scale, normal, _RADIUS * half_diagonal / extent.scale)


def _find_lowest(mesh: Mesh, up: NDArray[np.float64]) -> float:
    """Return the least height of a vertex, in local units."""
    points, direction = mesh.local_vertices, up.astype(np.float32)
    return min(
        float((points[begin : begin + _CHUNK_VERTICES] @ direction).min())
        for begin in range(0, len(points), _CHUNK_VERTICES)
    )
