"""A tree over boxes, each of which is a leaf: the upper part of a tree whose lower parts are made otherwise."""

from __future__ import annotations

import numpy as np
from numba import njit

from ...simd import LANES, centroid_of, empty_box, load_row, store_row, unite
from ..compact import place_subtree
from ..metadata import PRIM_ID
from ..subtree import build_subtree


@njit(cache=True, nogil=True)
def build_box_tree(boxes, count, depth, bins):  # type: ignore[no-untyped-def]
    """Build a tree by the surface area heuristic; see `subtree.build_subtree`.

    Parameters
    ----------
    boxes : (>= count, 8) float32
    count, depth, bins : int
        No leaf lies deeper than ``MAX_DEPTH - depth``.

    Returns
    -------
    nodes : (2 * count - 1, 8) float32
        Rows of `layout.NODE`, in depth-first order.
    order : (count,) int32
        Leaf [i, i + 1) is box ``order[i]``.
    """
    records = np.empty((2, count, LANES), np.float32)
    record_ints = records.view(np.int32)
    bounds = np.empty((2, LANES), np.float32)
    whole, centroid_box = empty_box(), empty_box()
    for index in range(count):
        box = load_row(boxes, index)
        store_row(records[0], index, box)
        record_ints[0, index, PRIM_ID] = index
        whole = unite(box, whole)
        centroid_box = unite(centroid_of(box), centroid_box)
    store_row(bounds, 0, whole)
    store_row(bounds, 1, centroid_box)
    order = np.empty(count, np.int32)
    node_count = build_subtree(records, record_ints, 0, count, 0, depth, bounds, bins, 1, 1.0, order)
    nodes = np.empty((node_count, LANES), np.float32)
    place_subtree(records, count, node_count, nodes, nodes.view(np.int32), 0, 1)
    return nodes, order
