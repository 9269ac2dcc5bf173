"""The choice of the instances that are merged."""

import itertools

import numpy as np
import pytest

import clbvh
from clbvh.trace.hits.scene_arrays import make_scene_arrays
from clbvh.trace.scene import merging as merge_rule
from clbvh.trace.scene.merging import LEAST_COUNT, find_groups

from ..scene_states import affine, make_state

BALL = clbvh.make_shape("icosphere", triangles=80)
ONES = [affine(offset=(3 * index, 0, 0)) for index in range(LEAST_COUNT)]


def groups_of(state):
    arrays = make_scene_arrays(state.shapes, state.geometry_ids, state.transforms)
    return sorted(group.tolist() for group in find_groups(state, arrays))


def make_single(*rows):
    """A state in which each row, (transform,) or (transform, mask), is a ball of its own."""
    return make_state([BALL] * len(rows), *((index, *row) for index, row in enumerate(rows)))


def test_meshes_that_are_placed_once_are_merged():
    assert groups_of(make_single(*((one,) for one in ONES))) == [[0, 1, 2, 3]]


def test_fewer_gain_nothing():
    assert groups_of(make_single(*((one,) for one in ONES[1:]))) == []
    assert groups_of(make_state([BALL])) == []


def test_meshes_that_are_placed_twice_and_spheres_are_not():
    shapes = [*[BALL] * 5, clbvh.Spheres([[0, 0, 0]], 1.0), BALL]
    rows = [(0, ONES[0]), (0, ONES[1]), (1, ONES[2]), (5, np.eye(4)), (2, ONES[3]), (3, ONES[0]), (4, ONES[1])]
    assert groups_of(make_state(shapes, *rows)) == [[2, 4, 5, 6]]


def test_masks_are_merged_by_themselves():
    rows = [(one, mask) for one in ONES for mask in (1, 2)]
    assert groups_of(make_single(*rows, (ONES[0], 3))) == [[0, 2, 4, 6], [1, 3, 5, 7]]


def test_mirrored_meshes_are_merged_by_themselves():
    rows = [(one @ affine([side, 1, 1]),) for one in ONES for side in (1, -1)]
    assert groups_of(make_single(*rows)) == [[0, 2, 4, 6], [1, 3, 5, 7]]


@pytest.mark.parametrize("far", [1e3, 1e7])
def test_a_mesh_far_away_is_left_out(far):
    assert groups_of(make_single((affine(offset=(0, far, 0)),), *((one,) for one in ONES))) == [[1, 2, 3, 4]]


def test_nothing_is_merged_that_would_be_refused():
    """Beside one so far away, no instance of the others would do, and one of them may have to become one."""
    assert groups_of(make_single((affine(offset=(0, 1e150, 0)),), *((one,) for one in ONES))) == []


@pytest.mark.parametrize("size", [1e-2, 1e-7, 1e-30])
def test_a_small_mesh_is_left_out(size):
    assert groups_of(make_single((affine([size] * 3),), *((one,) for one in ONES))) == [[1, 2, 3, 4]]


def test_small_meshes_are_merged_with_each_other():
    small = [affine([1e-3] * 3, (5 + 1e-3 * index, 1, 0)) for index in range(LEAST_COUNT)]
    terrain = affine([1000, 1000, 1])
    assert groups_of(make_single(*((one,) for one in (*ONES, terrain, *small)))) == [[0, 1, 2, 3], [5, 6, 7, 8]]


def test_a_long_row_becomes_rows():
    """No group is so long that one of its parts is small in it."""
    row = [affine(offset=(3 * index, 0, 0)) for index in range(1000)]
    groups = groups_of(make_single(*((one,) for one in row)))
    assert sorted(itertools.chain(*groups)) == list(range(1000))
    assert len(groups) == 16


def test_flattened_meshes_are_left_out():
    turned = affine(np.diag([1, 1, 1e-12]) + np.full((3, 3), 0.3))
    flat = affine([[1, 1, 0], [1, 1 + 1e-9, 0], [0, 0, 1]])
    assert groups_of(make_single((flat,), (turned,), *((one,) for one in ONES))) == [[1, 2, 3, 4, 5]]


@pytest.mark.parametrize("axis", range(3))
def test_a_mesh_that_is_flattened_beside_its_group_is_left_out(axis):
    """The group is 21 units long; a ball has a radius of 1."""
    turn = np.linalg.qr(np.random.default_rng(axis).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    for thickness, expected in ((2.0**-11, range(8)), (2.0**-12.5, range(1, 8))):
        scales = np.where(np.arange(3) == axis, thickness, 1.0)
        for linear in (np.diag(scales), turn @ np.diag(scales), turn @ np.diag(scales) @ turn.T):
            rows = [(affine(linear),), *((affine(offset=(3 * index, 0, 0)),) for index in range(1, 8))]
            assert groups_of(make_single(*rows)) == [list(expected)]


def test_flat_meshes_are_merged():
    square = clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [1, 1, 1e-9], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    rows = [(index, affine(turn, (2 * index, 0, 0))) for index in range(LEAST_COUNT)]
    assert groups_of(make_state([square] * LEAST_COUNT, *rows)) == [list(range(LEAST_COUNT))]


def test_flattened_meshes_in_one_place_are_left_out():
    assert groups_of(make_single(*((affine([1, 1, 1e-5]),) for _ in range(10)))) == []


def test_numbers_fit_the_device(monkeypatch):
    """With few bits, a mesh of many triangles stays by itself."""
    large = clbvh.make_shape("icosphere", triangles=5120)
    state = make_state([large, *[BALL] * 4], *((index, one) for index, one in enumerate((*ONES, np.eye(4)))))
    assert groups_of(state) == [[0, 1, 2, 3, 4]]
    monkeypatch.setattr(merge_rule, "ALL_PRIM_BITS", 12)
    assert groups_of(state) == [[1, 2, 3, 4]]
