"""A bucket of primitives becomes a subtree, on one core.

Sorted along the Morton curve, cut into clusters; the surface area heuristic decides about the tree over the clusters,
and where the clusters are cut. Bucket [begin, end) has rows 2 * begin to 2 * end - 1: first its records lie there, then
its subtree, which has at most that many nodes.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ...layout import NODE_COUNT, NODE_FIRST
from ...simd import LANES, load_row, store_row
from ..options import MAX_DEPTH
from .box_tree import build_box_tree
from .clusters import bound_clusters, cut_clusters
from .order import sort_records
from .sweep import make_sweep_scratch, sweep_cluster

# No bucket's root lies deeper than the first, no cluster's than the second, so that the levels that are left suffice
# for halves: 32,768 buckets need 15 levels, 2 ** 31 primitives in one bucket 31 to become clusters, a cluster 5.
BUCKET_DEPTH = 20
CLUSTER_DEPTH = 52


@njit(cache=True, nogil=True)
def grow_buckets(  # type: ignore[no-untyped-def]
    rows, row_ints, buckets, bins, leaf_size, traversal_cost, prim_ids, boxes, row_counts
):
    """Build the subtrees of some buckets, each in depth-first order.

    Parameters
    ----------
    rows, row_ints : (2F, 8) float32 and int32, the same memory
        The records of bucket [begin, end) from row 2 * begin on; overwritten with its nodes: rows of `layout.NODE`,
        which name their children by these rows, and places in `prim_ids`.
    buckets : (k, 2) int64
        Begin and end of each.
    bins, leaf_size, traversal_cost
        See `BuildOptions`.
    prim_ids : (F,) int32, written
        In places `begin` to `end`, in the order of the leaves.
    boxes : (k, 8) float32, written
        The box of each bucket.
    row_counts : (k,) int64, written
        Number of rows that each subtree uses.
    """
    # Room for the largest bucket.
    size = 0
    for index in range(len(buckets)):
        size = max(size, buckets[index, 1] - buckets[index, 0])
    records = np.empty((size, LANES), np.float32)
    record_ids = records.view(np.int32)
    codes = np.empty(size, np.int32)
    keys = np.empty((2, size), np.int64)
    begins = np.empty(size + 1, np.int32)
    cluster_boxes = np.empty((size, LANES), np.float32)
    sweep_scratch = make_sweep_scratch()
    waiting = np.empty((MAX_DEPTH + 1, 3), np.int64)

    for index in range(len(buckets)):
        begin, end = buckets[index, 0], buckets[index, 1]
        sort_records(rows, 2 * begin, end - begin, records, codes, keys[0], keys[1])
        cluster_count = cut_clusters(codes, end - begin, begins)

        # The tree over the clusters, each of which is a leaf.
        bound_clusters(records, begins, cluster_count, cluster_boxes, boxes, index)
        depth = BUCKET_DEPTH + MAX_DEPTH - CLUSTER_DEPTH
        nodes, order = build_box_tree(cluster_boxes, cluster_count, depth, bins)
        node_ints = nodes.view(np.int32)

        # Its nodes in their rows, and the trees of the clusters below them.
        next_row, first_prim = 2 * begin + 1, begin
        waiting_count = 1
        waiting[0, 0], waiting[0, 1], waiting[0, 2] = 0, 2 * begin, BUCKET_DEPTH
        while waiting_count > 0:
            waiting_count -= 1
            node, row, depth = waiting[waiting_count, 0], waiting[waiting_count, 1], waiting[waiting_count, 2]
            first = node_ints[node, NODE_FIRST]
            if node_ints[node, NODE_COUNT] > 0:
                cluster_begin = begins[order[first]]
                cluster_size = begins[order[first] + 1] - cluster_begin
                next_row = sweep_cluster(
                    records, record_ids, cluster_begin, cluster_size, depth, leaf_size, traversal_cost,
                    row, next_row, rows, first_prim, prim_ids, sweep_scratch,
                )  # fmt: skip
                first_prim += cluster_size
                continue
            store_row(rows, row, load_row(nodes, node))
            row_ints[row, NODE_FIRST] = next_row
            for side in (1, 0):  # the left one is next
                waiting[waiting_count, 0] = first + side
                waiting[waiting_count, 1] = next_row + side
                waiting[waiting_count, 2] = depth + 1
                waiting_count += 1
            next_row += 2
        row_counts[index] = next_row - 2 * begin
