"""What rays cost in a scene: by hand, as in the tree of one mesh, and against what the device finds."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Mesh, Scene, Spheres, Tracer, build, make_shape
from clbvh.builders.build import build_shape, build_top
from clbvh.geometry.corners import Boxes
from clbvh.support.host_threads import HostThreads
from clbvh.trace.check.visits import HostTraversal, count_visits
from clbvh.trace.world.top_tree import find_boxes
from clbvh.trace.world.surface_arrays import make_surface_arrays

from ..scene_states import affine, make_state, random_linear

TRIANGLE = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
KNOT = make_shape("knot", triangles=2000)
DOWN = (0.0, 0.0, -1.0)


def open_traversal(state):
    boxes = find_boxes(make_surface_arrays(state.shapes, state.geometry_ids, state.transforms))
    trees = [build_shape(shape) for shape in state.shapes]
    return HostTraversal.of_scene(state, trees, build_top(Boxes.from_arrays(*boxes, "boxes")))


def counts_of(visits):
    return [visits.node_steps, visits.instance_visits, visits.leaf_visits, visits.triangle_tests]


def cast_down(traversal, *at):
    visits = traversal.count_visits([[x, y, 10.0] for x, y in at], [DOWN])
    return np.column_stack([*counts_of(visits), visits.instance_id, visits.prim_id]).tolist()


def test_two_triangles_one_above_the_other():
    """The root of the tree over both, and that of each instance, are a step each; behind a hit no leaf is visited."""
    traversal = open_traversal(make_state([TRIANGLE], (0, affine()), (0, affine(offset=(0, 0, 2)))))
    hit, beside_both, past = [3, 2, 1, 1, 1, 0], [3, 2, 2, 2, -1, -1], [1, 0, 0, 0, -1, -1]
    assert cast_down(traversal, (0.25, 0.25), (0.75, 0.75), (3.0, 3.0)) == [hit, beside_both, past]


def test_instances_that_nothing_sees_are_not_entered():
    state = make_state([TRIANGLE], (0, affine()), (0, affine(offset=(0, 0, 2)), 0))
    assert cast_down(open_traversal(state), (0.25, 0.25)) == [[2, 1, 1, 1, 0, 0]]


def test_the_tree_of_an_instance_is_that_of_its_mesh():
    """Behind the only instance's box, the steps are those through the mesh, and one over the instance."""
    traversal = open_traversal(make_state([KNOT], (0, affine((2, 2, 2)))))
    generator = np.random.default_rng(3)
    origins, targets = generator.normal(size=(2, 500, 3))
    origins *= 4 / np.linalg.norm(origins, axis=1)[:, None]
    visits = traversal.count_visits(2 * origins, 2 * (targets - origins))
    alone = count_visits(build(KNOT), origins, targets - origins)
    entered = visits.instance_visits == 1
    assert entered.sum() > 300
    np.testing.assert_array_equal(visits.node_steps[entered], 1 + alone.node_steps[entered])
    np.testing.assert_array_equal(visits.triangle_tests[entered], alone.triangle_tests[entered])
    np.testing.assert_array_equal(visits.leaf_visits[entered], alone.leaf_visits[entered])
    np.testing.assert_array_equal(visits.prim_id, alone.prim_id)


@pytest.mark.parametrize("seed", [5])
@pytest.mark.parametrize("far", [0.0, 1e7], ids=["near", "far"])
def test_the_walk_finds_what_the_device_finds(session, seed, far):
    generator = np.random.default_rng(seed)
    balls = Spheres(generator.uniform(-1, 1, (300, 3)), generator.uniform(0.05, 0.2, 300))
    state = make_state(
        [KNOT, balls],
        *((number % 2, affine(random_linear(generator), far + generator.uniform(-9, 9, 3))) for number in range(20)),
        (0, affine(), 0),
    )
    origins = far + generator.uniform(-20, 20, (4000, 3))
    directions = far + generator.uniform(-9, 9, (4000, 3)) - origins
    visits = open_traversal(state).count_visits(origins, directions)
    scene = Scene()
    geometries = [scene.add(shape) for shape in state.shapes]
    for geometry, transform, mask in zip(state.geometry_ids, state.transforms, state.masks, strict=True):
        scene.place(geometries[geometry], transform, mask=int(mask))
    with Tracer(scene, layout="bvh2") as tracer:
        hits = tracer.closest_hit(origins, directions)
    assert 1000 < hits.count < 4000
    assert np.mean((visits.instance_id == hits.instance_id) & (visits.prim_id == hits.prim_id)) > 0.999


def test_threads_count_the_same():
    generator = np.random.default_rng(0)
    traversal = open_traversal(make_state([KNOT], *((0, affine(offset=(3 * x, 0, 0))) for x in range(5))))
    rays = generator.normal(size=(2, 20_000, 3))
    with HostThreads() as threads:
        shared = traversal.count_visits(*rays, threads=threads)
    for one, other in zip(counts_of(shared), counts_of(traversal.count_visits(*rays)), strict=True):
        assert (one == other).all()
    assert len(traversal.count_visits(np.empty((0, 3)), np.empty((0, 3))).prim_id) == 0
