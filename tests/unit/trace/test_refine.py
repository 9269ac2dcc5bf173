"""Hits that float64 sees beside their triangle move to the triangle's nearest point, and no further."""

import numpy as np
import pytest

from clbvh import Mesh
from clbvh.structs import HIT
from clbvh.trace.hits.refine import RefinedHits, refine_closest
from clbvh.trace.rays.batch import read_rays
from clbvh.trace.world.surface_arrays import lone_arrays

MESH = Mesh.from_arrays([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
BESIDE = 2.0**-30

# Points in the plane, beside each edge and each corner, and the (u, v) of the nearest point of the triangle.
POINTS = {
    "inside": ((1, 2), (0.25, 0.5)),
    "beside ab": ((1, -BESIDE), (0.25, 0)),
    "beside ac": ((-BESIDE, 1), (0, 0.25)),
    "beside bc": ((1 + BESIDE, 3 + BESIDE), (0.25, 0.75)),
    "beside bc, closer to b": ((3 + BESIDE, 1 + BESIDE), (0.75, 0.25)),
    "behind a": ((-BESIDE, -BESIDE), (0, 0)),
    "behind b": ((4 + 2 * BESIDE, 0), (1, 0)),
    "behind b, along ab": ((4 + BESIDE, -3 * BESIDE), (1, 0)),
    "behind c": ((0, 4 + 2 * BESIDE), (0, 1)),
}


@pytest.mark.parametrize("length", [1.0, 3.0])
@pytest.mark.parametrize("name", POINTS)
def test_a_hit_beside_its_triangle_moves_onto_it(name, length):
    (x, y), (expected_u, expected_v) = POINTS[name]
    rays, _ = read_rays(np.array([[x, y, 3.0]]), np.array([[0, 0, -length]]), 0.0, np.inf)
    found = np.zeros(1, HIT)
    hits = RefinedHits.make(1)
    refine_closest(rays.part(0, 1), lone_arrays(MESH), found, hits)
    t, u, v = hits.t, hits.u, hits.v
    assert hits.prim_id.tolist() == [0]
    np.testing.assert_allclose([u[0], v[0]], [expected_u, expected_v], rtol=0, atol=1e-9)
    assert min(u[0], v[0], 1 - u[0] - v[0]) >= 0
    assert t[0] == pytest.approx(3 / length)
