"""The subtrees of the buckets become one tree: depth-first rows, without gaps."""

from __future__ import annotations

import numpy as np
from numba import njit

from ...layout import NODE_COUNT, NODE_FIRST
from ...simd import load_row, store_row
from ..options import MAX_DEPTH

# Columns of a plan's placements, a row for each bucket: the final row of its root, and of the first of its descendants,
# and the final place of its first primitive.
PLACEMENT_COLUMNS = 3


@njit(cache=True, nogil=True)
def plan_rows(nodes, order, buckets, row_counts, placements, top_rows):  # type: ignore[no-untyped-def]
    """Give every node a row, once all subtrees are built.

    Parameters
    ----------
    nodes, order
        See `build_box_tree`; the nodes as int32.
    buckets : (k, 2) int64
        Begin and end of each bucket.
    row_counts : (k,) int64
        Rows of each bucket's subtree.
    placements : (k, 3) int64, written
        See `PLACEMENT_COLUMNS`.
    top_rows : (k - 1, 3) int64, written
        Of each interior node: its row in `nodes`, its final row, the final row of its left child.

    Returns
    -------
    int
        Rows of the final tree.
    """
    waiting = np.empty((MAX_DEPTH + 1, 2), np.int64)
    waiting[0, 0], waiting[0, 1] = 0, 0
    waiting_count, next_row, next_prim, interior_count = 1, 1, 0, 0
    while waiting_count > 0:
        waiting_count -= 1
        node, row = waiting[waiting_count, 0], waiting[waiting_count, 1]
        first = nodes[node, NODE_FIRST]
        if nodes[node, NODE_COUNT] > 0:
            bucket = order[first]
            placements[bucket, 0], placements[bucket, 1], placements[bucket, 2] = row, next_row, next_prim
            next_row += row_counts[bucket] - 1
            next_prim += buckets[bucket, 1] - buckets[bucket, 0]
            continue
        top_rows[interior_count, 0], top_rows[interior_count, 1], top_rows[interior_count, 2] = node, row, next_row
        interior_count += 1
        for side in (1, 0):  # the left one is next
            waiting[waiting_count, 0] = first + side
            waiting[waiting_count, 1] = next_row + side
            waiting_count += 1
        next_row += 2
    return next_row


@njit(cache=True, nogil=True)
def write_top(top_nodes, top_rows, nodes, node_ints):  # type: ignore[no-untyped-def]
    """Write the nodes above the buckets into their final rows."""
    for index in range(len(top_rows)):
        row = top_rows[index, 1]
        store_row(nodes, row, load_row(top_nodes, top_rows[index, 0]))
        node_ints[row, NODE_FIRST] = top_rows[index, 2]


@njit(cache=True, nogil=True)
def place_buckets(  # type: ignore[no-untyped-def]
    buckets, row_counts, placements, rows, bucket_prims, nodes, node_ints, prim_ids
):
    """Copy finished subtrees and their primitives to where they stay.

    Parameters
    ----------
    buckets : (k, 2) int64
    row_counts : (k,) int64
    placements : (k, 3) int64
        See `PLACEMENT_COLUMNS`.
    rows : (2F, 8) float32
    bucket_prims : (F,) int32
        As `grow_buckets` leaves them.
    nodes, node_ints : (N, 8) float32 and int32, the same memory, written
    prim_ids : (F,) int32, written
    """
    for index in range(len(buckets)):
        begin, end = buckets[index, 0], buckets[index, 1]
        root_row, first_row, first_prim = placements[index, 0], placements[index, 1], placements[index, 2]
        row_shift, prim_shift = first_row - (2 * begin + 1), first_prim - begin
        for number in range(row_counts[index]):
            row = root_row if number == 0 else first_row + number - 1
            store_row(nodes, row, load_row(rows, 2 * begin + number))
            node_ints[row, NODE_FIRST] += row_shift if node_ints[row, NODE_COUNT] == 0 else prim_shift
        for place in range(begin, end):
            prim_ids[place + prim_shift] = bucket_prims[place]
