"""The cost of a tree for three kinds of rays: those of a picture, random ones, and those that leave the surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..bvh import Bvh
from ..geometry import Mesh
from ..trace.oracle.visits import Visits, count_visits
from .camera import Camera

# Rays of each kind. Means over 50,000 rays are within 0.5 % of means over 500,000, for dragon, bunny and palace.
RAY_COUNT = 50_000

# Distance from the surface at which rays start, in sizes of the mesh: large enough for float32 to resolve.
_LIFT = 1e-5

_Rays = tuple[NDArray[np.float64], NDArray[np.float64]]


def measure_rays(bvh: Bvh, camera: Camera, aspect: float, *, ray_count: int = RAY_COUNT) -> dict[str, Visits]:
    """Count the node steps and triangle tests of rays.

    Parameters
    ----------
    bvh : Bvh
    camera : Camera
    aspect : float
        Width of its picture divided by the height.
    ray_count : int, optional
        The approximate number of rays of each kind.

    Returns
    -------
    dict of str to Visits
        ``"picture"``: the camera's rays. ``"random"``: uniform in the mesh's box, in any direction. ``"surface"``:
        uniform over the surface, to either side, distributed by the cosine. The same rays for the same mesh and camera.
    """
    generator = np.random.default_rng(0)
    height = max(1, round((ray_count / aspect) ** 0.5))
    width = max(1, round(height * aspect))
    origins, directions = camera.rays(width, height)
    rays = {
        "picture": (origins.reshape(-1, 3), directions.reshape(-1, 3)),
        "random": _random_rays(bvh.mesh, ray_count, generator),
        "surface": _surface_rays(bvh.mesh, ray_count, generator),
    }
    return {kind: count_visits(bvh, *cast) for kind, cast in rays.items()}


def _random_rays(mesh: Mesh, count: int, generator: np.random.Generator) -> _Rays:
    lower = mesh.vertices.min(axis=0)
    size = mesh.vertices.max(axis=0) - lower
    return lower + generator.random((count, 3)) * size, generator.normal(size=(count, 3))


def _surface_rays(mesh: Mesh, count: int, generator: np.random.Generator) -> _Rays:
    """Return rays from points that are uniform over the surface; none for a mesh without area."""
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    if not areas.sum() > 0:
        return np.empty((0, 3)), np.empty((0, 3))
    chosen = generator.choice(len(areas), count, p=areas / areas.sum())
    a, b, c = corners[chosen].transpose(1, 0, 2)
    root, share = np.sqrt(generator.random((count, 1))), generator.random((count, 1))
    points = (1 - root) * a + root * (1 - share) * b + root * share * c

    # A unit normal plus a point of the unit sphere is distributed by the cosine.
    upward = normals[chosen] / areas[chosen, None] * generator.choice([-1.0, 1.0], (count, 1))
    sphere = generator.normal(size=(count, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    size = float(np.ptp(mesh.vertices, axis=0).max())
    return points + _LIFT * size * upward, sphere + upward
