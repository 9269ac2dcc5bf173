"""A ray that runs in a thin triangle's plane, beside the triangle, does not hit it.

The areas that decide are differences of nearly equal products. Rounded to float32, one came out as zero, the others
with one sign, and triangles were hit that the ray passes at any distance.
"""

import numpy as np
import pytest

import clbvh
from clbvh.trace.hits import Hits
from clbvh.trace.reference import find_differences

from ..rays import aim, as_float32, centred


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
    a, b, c = mesh.vertices[mesh.faces[prims]].astype(np.float64).transpose(1, 0, 2)
    i, j = generator.uniform(-2, 3, (2, len(prims), 1))
    return as_float32(a + i * (b - a) + j * (c - a))


@pytest.mark.usefixtures("session")
@pytest.mark.parametrize("from_plane", [True, False], ids=["in-plane", "to-plane"])
@pytest.mark.parametrize("seed", range(2))
def test_what_is_hit_is_on_the_ray(seed, from_plane):
    generator = np.random.default_rng([13, seed])
    mesh = make_slivers(300, generator)
    prims = generator.integers(0, mesh.face_count, 20_000)
    starts = generator.uniform(-2, 2, (len(prims), 3))
    if from_plane:
        starts = points_of_planes(mesh, prims, generator)
    origins, directions = aim(starts, points_of_planes(mesh, prims, generator))
    with clbvh.Tracer(clbvh.build(mesh)) as tracer:
        hits = tracer.closest_hit(origins, directions)
    assert isinstance(hits, Hits)
    assert hits.count > 500
    assert [str(difference) for difference in find_differences(mesh, origins, directions, hits)] == []
