"""A tree over boxes, each of which is a leaf: the upper part of a tree whose lower parts are made otherwise."""

from __future__ import annotations

import numpy as np

from ...geometry.boxes import centroid_of, empty_box, load_box, store_box, unite
from ...structs import BOX_LANES, PRIM_REF_ID
from ...support.compiled import compiled
from ..depth_first import Placement
from ..prim_refs import BOUNDS_BOX, BOUNDS_CENTROIDS
from ..sah.compact import place_finished
from ..sah.rule import Rule
from ..sah.subtree import SubtreeTask, build_subtree


@compiled
def build_box_tree(boxes, count, depth, bins):
    """Build a tree by the surface area heuristic; see `subtree.build_subtree`.

    Parameters
    ----------
    boxes : (>= count, 8) float32
    count, depth, bins : int
        No leaf lies deeper than ``MAX_DEPTH - depth``.

    Returns
    -------
    nodes : (2 * count - 1, 8) float32
        Rows of `structs.NODE`, in depth-first order.
    order : (count,) int32
        The i-th leaf from the left, [i, i + 1), is box ``order[i]``.
    """
    prim_refs = np.empty((2, count, BOX_LANES), np.float32)
    ref_ints = prim_refs.view(np.int32)
    bounds = np.empty((2, BOX_LANES), np.float32)
    whole, centroid_box = empty_box(), empty_box()
    for index in range(count):
        box = load_box(boxes, index)
        store_box(prim_refs[0], index, box)
        ref_ints[0, index, PRIM_REF_ID] = index
        whole = unite(box, whole)
        centroid_box = unite(centroid_of(box), centroid_box)
    store_box(bounds, BOUNDS_BOX, whole)
    store_box(bounds, BOUNDS_CENTROIDS, centroid_box)
    order = np.empty(count, np.int32)
    # As int64, or numba would compile everything once more for literal numbers.
    zero, one = np.int64(0), np.int64(1)
    task = SubtreeTask(zero, np.int64(count), zero, np.int64(depth), bounds)
    node_count = build_subtree(prim_refs, task, Rule(np.int64(bins), one, 1.0), order)
    nodes = np.empty((node_count, BOX_LANES), np.float32)
    place_finished(prim_refs, count, node_count, Placement(zero, one), nodes)
    return nodes, order
