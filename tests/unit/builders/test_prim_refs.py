"""One reference per primitive: its box, its id, and the bounds of a slice."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from clbvh.builders.prim_refs import fill_slice
from clbvh.geometry.corners import find_corners
from clbvh.structs import BOX_LANES, BOX_TALLY

from ...soup import make_soup
from .prim_refs import boxes_of, make_prim_refs


def test_a_reference_is_the_box_and_the_id_of_its_triangle():
    mesh = make_soup(100, seed=1, degenerate=0.2)
    prim_refs, _ = make_prim_refs(mesh)
    corners = mesh.local_vertices[mesh.faces]
    lower, upper = boxes_of(prim_refs[0])
    assert (lower == corners.min(axis=1)).all()
    assert (upper == corners.max(axis=1)).all()
    assert prim_refs[0].view(np.int32)[:, 3].tolist() == list(range(100))
    assert (prim_refs[0].view(np.int32)[:, 7] == 0).all()


def test_bounds_hold_all_boxes_and_all_centroids():
    mesh = make_soup(100, seed=2)
    prim_refs, bounds = make_prim_refs(mesh)
    lower, upper = boxes_of(prim_refs[0])
    assert bounds[0, :3].tolist() == lower.min(axis=0).tolist()
    assert bounds[0, 4:7].tolist() == (-upper.max(axis=0)).tolist()
    assert bounds[1, :3].tolist() == (lower + upper).min(axis=0).tolist()
    assert bounds[1, 4:7].tolist() == (-(lower + upper).max(axis=0)).tolist()


@pytest.mark.parametrize("cuts", [[0, 100], [0, 1, 100], [0, 0, 50, 99, 100, 100]])
def test_slices_together_give_what_one_gives(cuts):
    mesh = make_soup(100, seed=3)
    prim_refs, bounds = make_prim_refs(mesh)
    sliced = np.zeros_like(prim_refs)
    parts = [fill_slice(find_corners(mesh), begin, end, sliced[0]) for begin, end in itertools.pairwise(cuts)]
    assert np.minimum.reduce(parts).tobytes() == bounds.tobytes()
    assert sliced.tobytes() == prim_refs.tobytes()


def test_an_empty_slice_has_empty_bounds():
    mesh = make_soup(5, seed=4)
    assert (fill_slice(find_corners(mesh), 3, 3, np.zeros((5, BOX_LANES), np.float32))[:, :BOX_TALLY] == np.inf).all()


def test_no_lane_holds_a_negative_zero():
    mesh = make_soup(50, seed=5)
    mesh.local_vertices[:] = np.random.default_rng(5).choice(
        np.array([-0.0, 0.0], np.float32), mesh.local_vertices.shape
    )
    prim_refs, bounds = make_prim_refs(mesh)
    boxes = np.concatenate([prim_refs[0], bounds])[:, [0, 1, 2, 4, 5, 6]]
    assert (boxes == 0).all()
    assert not np.signbit(boxes).any()
