"""Merged meshes: their corners, their numbers, and instances that leave them."""

import numpy as np
import pytest

import clbvh
from clbvh import Mesh
from clbvh.builders.build import build
from clbvh.trace.hits.scene_arrays import make_scene_arrays
from clbvh.trace.scene.merging import MergedMesh, Merging

from ..scene_states import affine, flatten, make_state, random_linear

BALL = clbvh.make_shape("icosphere", triangles=80)
TRIANGLE = Mesh.from_arrays(np.eye(3), [[0, 1, 2]])
SPREAD = [affine(offset=(3 * index, 0, 0)) for index in range(4)]


def merge(state, ids=None):
    arrays = make_scene_arrays(state.shapes, state.geometry_ids, state.transforms)
    ids = np.arange(state.instance_count) if ids is None else np.array(ids)
    return MergedMesh.build(state, arrays, ids, build)


def find(state):
    arrays = make_scene_arrays(state.shapes, state.geometry_ids, state.transforms)
    return arrays, Merging.find(state, arrays, build)


@pytest.mark.parametrize("far", [0.0, 1e7, 1e12])
@pytest.mark.parametrize("seed", [0, 1], ids=lambda seed: f"seed{seed}")
def test_the_mesh_is_that_of_the_scene(seed, far):
    generator = np.random.default_rng(seed)
    shapes = [BALL, TRIANGLE, clbvh.make_shape("knot", triangles=200)]
    side = -1 if seed else 1
    linear = [random_linear(generator) for _ in range(3)]
    linear = [matrix * side * np.sign(np.linalg.det(matrix)) for matrix in linear]
    placed = [(index, affine(linear[index], generator.uniform(-3, 3, 3) + far)) for index in range(3)]
    merged = merge(make_state(shapes, *placed))
    # Far away, float64 has the differences only if each matrix is moved first.
    near = [(index, affine(matrix[:3, :3], matrix[:3, 3] - far)) for index, matrix in placed]
    vertices, faces, ids = flatten(make_state(shapes, *near))
    assert merged.transform[0, 0] == side
    found = merged.mesh.vertices * [side, 1, 1] + (merged.transform[:3, 3] - far)
    np.testing.assert_allclose(found, vertices, atol=1e-13 + 1e-15 * far)
    np.testing.assert_array_equal(merged.mesh.faces, faces)
    numbers = merged.face_numbers().numbers
    np.testing.assert_array_equal(numbers >> merged.prim_bits, ids[:, 0])
    np.testing.assert_array_equal(numbers & ((1 << merged.prim_bits) - 1), ids[:, 1])


def test_numbers_count_from_the_first_instance():
    merged = merge(make_state([TRIANGLE, BALL, TRIANGLE], (0, SPREAD[0]), (1, SPREAD[1]), (2, SPREAD[2])), [1, 2])
    numbers = merged.face_numbers().numbers
    assert merged.first_id == 1
    assert (np.diff(numbers) > 0).all()
    assert numbers[0] == 0
    assert numbers[-1] == 1 << merged.prim_bits


def test_one_triangle_each_takes_no_bits():
    merged = merge(make_state([TRIANGLE] * 3, *enumerate(SPREAD[:3])))
    assert merged.prim_bits == 0
    assert merged.face_numbers().numbers.tolist() == [0, 1, 2]


def test_what_is_degenerate_in_its_own_mesh_stays_so():
    """Turned, the corners of a line are no longer exactly on one."""
    line = Mesh.from_arrays([[0, 0, 0], [1, 1, 1], [3, 3, 3], [0, 1, 0]], [[0, 1, 2], [0, 1, 3]])
    linear = [random_linear(np.random.default_rng(index)) for index in range(8)]
    turned = [affine(matrix * np.sign(np.linalg.det(matrix))) for matrix in linear]
    merged = merge(make_state([line] * 8, *enumerate(turned)))
    assert not merged.mesh.degenerate_faces.all()
    np.testing.assert_array_equal(merged.is_degenerate, [True, False] * 8)


def test_a_mesh_that_would_lose_triangles_is_left_out():
    """A triangle of 1e-9 of its mesh, and so smaller than float32 tells in the merged one."""
    small, large = [[0, 0, 0], [1e-9, 0, 0], [0, 1e-9, 0]], [[0.5, 0.5, 0.5], [-0.5, -0.5, -0.5], [0.5, 0, 0]]
    fine = Mesh.from_arrays(np.vstack((small, large)), [[0, 1, 2], [3, 4, 5]])
    assert not fine.degenerate_faces.any()
    merged = merge(make_state([fine, BALL, BALL], *enumerate(SPREAD[:3])))
    assert merged.instance_ids.tolist() == [1, 2]
    assert merge(make_state([fine, BALL], *enumerate(SPREAD[:2]))) is None


def test_instances_leave_one_by_one():
    state = make_state([BALL] * 4, *enumerate(SPREAD))
    arrays, merging = find(state)
    assert merging.instance_ids.tolist() == [0, 1, 2, 3]
    assert merging.without(np.array([7]), state, arrays, build) is merging
    left = merging.without(np.array([1]), state, arrays, build)
    assert left.instance_ids.tolist() == [0, 2, 3]
    assert left.meshes[0].bvh is merging.meshes[0].bvh
    hidden = left.meshes[0].face_numbers().is_degenerate
    np.testing.assert_array_equal(hidden, np.repeat([False, True, False, False], BALL.face_count))
    assert left.without(np.array([1]), state, arrays, build) is left


def test_a_worn_tree_is_built_anew():
    large = clbvh.make_shape("icosphere", triangles=1280)
    state = make_state([large, BALL, BALL, BALL], *enumerate(SPREAD))
    arrays, merging = find(state)
    left = merging.without(np.array([0]), state, arrays, build)
    assert left.instance_ids.tolist() == [1, 2, 3]
    assert left.meshes[0].mesh.face_count == 3 * BALL.face_count


def test_the_last_one_is_not_merged():
    state = make_state([BALL] * 4, *enumerate(SPREAD))
    arrays, merging = find(state)
    assert merging.without(np.array([0, 1, 3]), state, arrays, build).meshes == ()
    assert merging.without(np.arange(4), state, arrays, build).meshes == ()
