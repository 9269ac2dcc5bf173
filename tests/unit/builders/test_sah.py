"""The default builder, against a plain one that makes the same tree, and steps that a whole tree shows too rarely."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import build
from clbvh.builders.sah import top
from clbvh.device.host.loops import Loops
from clbvh.structs import BOX_LANES

from ...soup import make_soup
from .reference import bins_of, build_sah, make_prim_refs
from .shapes import MESHES


@pytest.mark.parametrize(("bins", "leaf_size", "traversal_cost"), [(16, 4, 1.0), (3, 1, 0.3), (64, 20, 4.0)])
def test_the_tree_is_that_of_the_plain_builder(bins, leaf_size, traversal_cost):
    for name, make in MESHES.items():
        mesh = make()
        nodes, prim_ids = build_sah(mesh, bins, leaf_size, traversal_cost)
        bvh = build(mesh, bins=bins, leaf_size=leaf_size, traversal_cost=traversal_cost)
        assert bvh.nodes.tobytes() == nodes.tobytes(), name
        assert bvh.prim_ids.tobytes() == prim_ids.tobytes(), name


def test_a_partition_keeps_the_order_on_both_sides_and_bounds_their_centroids():
    prim_refs, bounds = make_prim_refs(make_soup(100, seed=1, grid=20, copies=0.2))
    buffers, gap = np.zeros((2, 130, BOX_LANES), np.float32), np.zeros((30, BOX_LANES), np.float32)
    rows = buffers[0, :100] = prim_refs[0]
    goes_left = bins_of(rows, 8)[:, 1] <= 3
    # One node in one slice, split behind the fourth of eight bins along y.
    left_count, centroid_boxes = int(goes_left.sum()), np.zeros((2, BOX_LANES), np.float32)
    node, split = np.array([[0, 100, 0]]), np.array([[1, 3, left_count, 8]], np.int32)
    targets = np.array([[0, left_count + 30]])
    Loops("builders/top").partition_slices(130, buffers, node, bounds, split, 1, 0, targets, centroid_boxes)
    assert buffers[1].tobytes() == np.concatenate([rows[goes_left], gap, rows[~goes_left]]).tobytes()
    for box, side in zip(centroid_boxes, (rows[goes_left], rows[~goes_left]), strict=True):
        centroids = side[:, :3] - side[:, 4:7]
        assert (box[:3] == centroids.min(axis=0)).all()
        assert (box[4:7] == -centroids.max(axis=0)).all()


def test_a_level_is_split_some_nodes_at_a_time(mesh, monkeypatch):
    whole = build(mesh, task_threshold=20)
    monkeypatch.setattr(top, "_NODES_AT_ONCE", 5)
    assert build(mesh, task_threshold=20).nodes.tobytes() == whole.nodes.tobytes()
