"""Hits in float64: those beside their triangle move to its nearest point; a lone shape needs no transform."""

import numpy as np
import pytest

from clbvh import Mesh, Spheres, make_shape
from clbvh.structs import HIT, WORLD_HIT
from clbvh.trace.hits.refine import RefinedHits, refine_closest
from clbvh.trace.rays.batch import read_rays
from clbvh.trace.world.surface_arrays import lone_arrays, make_surface_arrays

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


@pytest.mark.parametrize("with_other", [False, True])
@pytest.mark.parametrize("kind", ["mesh", "spheres"])
def test_hits_on_a_lone_shape_are_those_on_its_instance_in_the_same_place(kind, with_other):
    generator = np.random.default_rng(8)
    knot, balls = make_shape("knot", triangles=500), Spheres(generator.normal(size=(50, 3)), np.linspace(0.1, 1, 50))
    shape, other = (knot, balls) if kind == "mesh" else (balls, knot)
    # Ten misses; more hits than a block has, and not a multiple.
    prims = np.r_[np.full(10, -1), generator.integers(0, shape.prim_count, 290)]
    origins, directions = generator.normal(size=(2, 300, 3))
    rays, _ = read_rays(origins, directions, 0.0, np.inf)
    results = []
    shapes = [other, shape] if with_other else [shape]
    placed = make_surface_arrays(shapes, np.array([len(shapes) - 1]), np.eye(4)[None])
    for arrays, dtype in ((lone_arrays(shape), HIT), (placed, WORLD_HIT)):
        found, hits = np.zeros(300, dtype), RefinedHits.make(300, is_lone=arrays.is_lone)
        found["prim_id"], found["u"] = prims, np.arange(300) % 2
        refine_closest(rays.part(0, 300), arrays, found, hits)
        results.append(hits)
    for name in ("t", "u", "v", "is_front", "prim_id"):
        np.testing.assert_array_equal(getattr(results[0], name), getattr(results[1], name), err_msg=name)
    assert len(results[0].instance_id) == 0
    np.testing.assert_array_equal(results[1].instance_id, np.minimum(prims, 0))
