"""A treelet of primitives becomes a subtree, on one core.

Its primitives are sorted along the Morton curve and cut into clusters; the surface area heuristic decides about the
tree over the clusters, and where the clusters are cut. Treelet [begin, end) has the slots 2 * begin to 2 * end - 1:
first its primitive references lie there, then its subtree, which has fewer nodes than slots.
"""

from __future__ import annotations

import numpy as np

from ...geometry.boxes import centroid_of, empty_box, load_box, store_box, unite
from ...structs import BOX_LANES, NODE_COUNT, NODE_FIRST, PRIM_REF_ID
from ...support.compiled import compiled
from ..invariants import Placement
from ..options import MAX_DEPTH
from ..prim_refs import BOUNDS_BOX, BOUNDS_CENTROIDS
from ..sah.subtree import Rule, SubtreeTask, build_subtree, place_finished
from .clusters import Cluster, bound_clusters, cut_clusters, make_sweep_scratch, sort_prim_refs, sweep_cluster


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


# No treelet's root lies deeper than the first, no cluster's than the second, so that the levels that are left suffice
# for halves: 32,768 treelets need 15 levels, 2 ** 31 primitives in one treelet 31 to become clusters, a cluster 5.
TREELET_DEPTH = 20
CLUSTER_DEPTH = 52


@compiled
def grow_treelets(slots, treelets, rule, prim_ids, boxes, node_counts):
    """Build the subtrees of some treelets, each in depth-first order.

    Parameters
    ----------
    slots : (2F, 8) float32
        The primitive references of treelet [begin, end) from slot 2 * begin on; overwritten with its nodes: rows of
        `structs.NODE` that name their children by slots, and indices of `prim_ids`.
    treelets : (k, 2) int64
        Begin and end of each.
    rule : Rule
    prim_ids : (F,) int32, written
        At `begin` to `end`, in the order of the leaves.
    boxes : (k, 8) float32, written
        The box of each treelet.
    node_counts : (k,) int64, written
    """
    # Memory for the largest treelet.
    size = 0
    for index in range(len(treelets)):
        size = max(size, treelets[index, 1] - treelets[index, 0])
    refs = np.empty((size, BOX_LANES), np.float32)
    codes = np.empty(size, np.int32)
    keys = np.empty((2, size), np.int64)
    begins = np.empty(size + 1, np.int32)
    cluster_boxes = np.empty((size, BOX_LANES), np.float32)
    sweep_scratch = make_sweep_scratch()
    stack = np.empty((MAX_DEPTH + 1, 3), np.int64)
    slot_ints = slots.view(np.int32)

    for index in range(len(treelets)):
        begin, end = treelets[index, 0], treelets[index, 1]
        sort_prim_refs(slots, 2 * begin, end - begin, refs, codes, keys[0], keys[1])
        cluster_count = cut_clusters(codes, end - begin, begins)

        # The tree over the clusters, each of which is a leaf.
        bound_clusters(refs, begins, cluster_count, cluster_boxes, boxes, index)
        depth = TREELET_DEPTH + MAX_DEPTH - CLUSTER_DEPTH
        nodes, order = build_box_tree(cluster_boxes, cluster_count, depth, rule.bins)
        node_ints = nodes.view(np.int32)

        # Its nodes go to their slots, and the trees of the clusters below them; the stack has node, slot and depth.
        next_slot, first_prim = 2 * begin + 1, begin
        stack[0, 0], stack[0, 1], stack[0, 2] = 0, 2 * begin, TREELET_DEPTH
        stack_size = 1
        while stack_size > 0:
            stack_size -= 1
            node, slot, depth = stack[stack_size, 0], stack[stack_size, 1], stack[stack_size, 2]
            first = node_ints[node, NODE_FIRST]
            if node_ints[node, NODE_COUNT] > 0:
                first_ref = np.int64(begins[order[first]])
                count = np.int64(begins[order[first] + 1]) - first_ref
                cluster = Cluster(first_ref, count, depth, slot, next_slot, first_prim)
                next_slot = sweep_cluster(refs, cluster, rule, slots, prim_ids, sweep_scratch)
                first_prim += count
                continue
            store_box(slots, slot, load_box(nodes, node))
            slot_ints[slot, NODE_FIRST] = next_slot
            for side in (1, 0):  # the left child is next
                stack[stack_size, 0] = first + side
                stack[stack_size, 1] = next_slot + side
                stack[stack_size, 2] = depth + 1
                stack_size += 1
            next_slot += 2
        node_counts[index] = next_slot - 2 * begin
