"""A ray that runs in a thin triangle's plane, beside the triangle, does not hit it.

The areas that decide are differences of nearly equal products. Rounded to float32, one came out as zero, the others
with one sign, and triangles were hit that the ray passes at any distance.
"""

import numpy as np
import pytest

import clbvh

from ..mesh_reference import find_differences
from ..profiles import seeds
from ..rays import aim, as_float32, centred

# The largest distance of a hit point from its ray, for coordinates of a few units: float32 rounds by about 3e-7.
MOST_DISTANCE = 2e-6


def make_slivers(count, generator):
    """Triangles that are nearly lines: 1e-8 to 0.1 wide, about 1 long."""
    a = generator.uniform(-1, 1, (count, 3))
    b = a + generator.uniform(-1, 1, (count, 3))
    width = 10 ** generator.uniform(-8, -1, (count, 1))
    c = a + generator.uniform(-1, 2, (count, 1)) * (b - a) + width * generator.normal(size=(count, 3))
    corners = np.stack((a, b, c), axis=1).reshape(-1, 3)
    return centred(clbvh.Mesh.from_arrays(corners, np.arange(3 * count).reshape(-1, 3)))


def points_of_planes(mesh, prims, generator):
    """A point in the plane of each triangle, on it or up to three of its sizes away."""
    a, b, c = mesh.vertices[mesh.faces[prims]].transpose(1, 0, 2)
    i, j = generator.uniform(-2, 3, (2, len(prims), 1))
    return as_float32(a + i * (b - a) + j * (c - a))


@pytest.mark.usefixtures("session")
@pytest.mark.parametrize("from_plane", [True, False], ids=["in-plane", "to-plane"])
@pytest.mark.parametrize("seed", seeds(2))
def test_hits_are_on_their_rays(seed, from_plane):
    generator = np.random.default_rng([13, seed])
    mesh = make_slivers(300, generator)
    prims = generator.integers(0, mesh.face_count, 20_000)
    starts = generator.uniform(-2, 2, (len(prims), 3))
    if from_plane:
        starts = points_of_planes(mesh, prims, generator)
    origins, directions = aim(starts, points_of_planes(mesh, prims, generator))
    with clbvh.Tracer(clbvh.build(mesh)) as tracer:
        hits = tracer.closest_hit(origins, directions)
    assert hits.count > 500
    found = np.flatnonzero(hits.is_hit)
    a, b, c = mesh.vertices[mesh.faces[hits.prim_id[found]]].transpose(1, 0, 2)
    to_point = a + hits.u[found, None] * (b - a) + hits.v[found, None] * (c - a) - origins[found]
    along = directions[found] / np.linalg.norm(directions[found], axis=1)[:, None]
    assert np.linalg.norm(np.cross(to_point, along), axis=1).max() < MOST_DISTANCE
    assert [str(difference) for difference in find_differences(mesh, origins, directions, hits)] == []
