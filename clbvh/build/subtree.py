"""One range of primitives becomes a subtree, in one compiled loop on one core.

A range [begin, end) writes only to node rows 2 * begin to 2 * end - 1 and to prim_ids[begin:end]. A tree over n
primitives has at most 2n - 1 nodes, so ranges that do not overlap own rows that do not overlap, before anyone
starts: no shared counter, no lock.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ..layout import NODE_COUNT, NODE_FIRST, NODE_MAX
from .few import FEW, count_left, divide, find_division
from .metadata import NEGATED_MAX, PRIM_ID
from .options import MAX_DEPTH
from .partition import bound_halves, partition
from .simd import LANES, half_area, load_row, store_row
from .splits import bin_count_for, fill_bins, find_split, make_bins, unite_sides


@njit(cache=True, nogil=True)
def needs_halving(prim_count, depth):  # type: ignore[no-untyped-def]
    """Say whether only splits by halves still keep `prim_count` primitives above MAX_DEPTH."""
    levels = 0
    while (1 << levels) < prim_count:
        levels += 1
    return levels >= MAX_DEPTH - depth


@njit(cache=True, nogil=True)
def write_box(nodes, row, boxes, box):  # type: ignore[no-untyped-def]
    """Write a box of the builder as the aabb of a node."""
    for axis in range(3):
        nodes[row, axis] = boxes[box, axis]
        nodes[row, NODE_MAX + axis] = np.float32(0.0) - boxes[box, NEGATED_MAX + axis]


@njit(cache=True, nogil=True)
def emit_leaf(node_ints, row, begin, end, record_ids, prim_ids):  # type: ignore[no-untyped-def]
    """Make a node a leaf over [begin, end) and list its primitives."""
    node_ints[row, NODE_FIRST] = begin
    node_ints[row, NODE_COUNT] = end - begin
    for record in range(begin, end):
        prim_ids[record] = record_ids[record, PRIM_ID]


@njit(cache=True, nogil=True)
def build_subtree(  # type: ignore[no-untyped-def]
    records,
    record_ids,
    begin,
    end,
    buffer,
    depth,
    bounds,
    bins,
    leaf_size,
    traversal_cost,
    nodes,
    node_ints,
    prim_ids,
):
    """Build the subtree over one range, in depth-first order and without gaps.

    Parameters
    ----------
    records, record_ids : (2, n, 8) float32 and int32, the same memory, overwritten
        Two buffers of records; the range is read from buffer `buffer`.
    begin, end, buffer, depth : int
        The range, where it is, and how deep its root lies in the whole tree.
    bounds : (2, 8) float32
        Row 0: the box of the range. Row 1: the box of its centroids.
    bins, leaf_size, traversal_cost
        See `BuildOptions`.
    nodes, node_ints : (2n, 8) float32 and int32, the same memory, rows of `layout.NODE`, written
    prim_ids : (n,) int32, written

    Returns
    -------
    int
        Number of rows used, from 2 * begin on. Interior nodes name their children by these rows.
    """
    node_bins = make_bins(bins)
    right_costs = np.empty(3 * bins, np.float64)
    children = np.empty((2, LANES), np.float32)
    child_bounds = np.empty((2, LANES), np.float32)
    current = np.empty((2, LANES), np.float32)  # box and centroid bounds of the node at hand

    # Nodes that wait for their turn: at most one per level, because the left child is taken at once.
    waiting = np.empty((MAX_DEPTH + 1, 5), np.int64)
    waiting_bounds = np.empty((2 * (MAX_DEPTH + 1), LANES), np.float32)
    waiting_count = 0

    row = first_row = 2 * begin
    next_row = row + 1
    store_row(current, 0, load_row(bounds, 0))
    store_row(current, 1, load_row(bounds, 1))
    write_box(nodes, row, current, 0)
    while True:
        prim_count = end - begin
        source = records[buffer]

        # Find the cheapest split, unless there is nothing to split or no level left to be choosy.
        cost = np.inf
        axis, last_left_bin, left_count, left = 0, 0, 0, 0
        bin_count = bin_count_for(prim_count, bins)
        if prim_count > 1 and not needs_halving(prim_count, depth):
            if prim_count <= FEW:
                cost, left = find_division(source, begin, prim_count)
            else:
                fill_bins(source, begin, end, current, 1, bin_count, node_bins)
                cost, axis, last_left_bin, left_count = find_split(node_bins, bin_count, right_costs)

        # A leaf, if that is allowed and no split is cheaper; then the next node that waits.
        area = half_area(load_row(current, 0))
        if prim_count <= leaf_size and not traversal_cost * area + cost < prim_count * area:
            emit_leaf(node_ints, row, begin, end, record_ids[buffer], prim_ids)
            if waiting_count == 0:
                return next_row - first_row
            waiting_count -= 1
            row, begin, end, buffer, depth = (
                waiting[waiting_count, 0], waiting[waiting_count, 1], waiting[waiting_count, 2],
                waiting[waiting_count, 3], waiting[waiting_count, 4],
            )  # fmt: skip
            store_row(current, 0, load_row(waiting_bounds, 2 * waiting_count))
            store_row(current, 1, load_row(waiting_bounds, 2 * waiting_count + 1))
            continue

        # Move the records to their sides, into the other buffer; halves stay where they are.
        if not cost < np.inf:
            middle = begin + prim_count // 2
            bound_halves(source, begin, middle, end, children, child_bounds)
        elif prim_count <= FEW:
            middle = begin + count_left(left)
            divide(source, begin, prim_count, left, records[1 - buffer], children)
            buffer = 1 - buffer
        else:
            middle = begin + left_count
            unite_sides(node_bins, bin_count, axis, last_left_bin, children)
            partition(
                source, begin, end, current, 1, bin_count, axis, last_left_bin,
                records[1 - buffer], begin, middle, child_bounds,
            )  # fmt: skip
            buffer = 1 - buffer

        # Two rows for the children; the right one waits, the left one is next.
        node_ints[row, NODE_FIRST] = next_row
        node_ints[row, NODE_COUNT] = 0
        write_box(nodes, next_row, children, 0)
        write_box(nodes, next_row + 1, children, 1)
        depth += 1
        waiting[waiting_count, 0] = next_row + 1
        waiting[waiting_count, 1] = middle
        waiting[waiting_count, 2] = end
        waiting[waiting_count, 3] = buffer
        waiting[waiting_count, 4] = depth
        store_row(waiting_bounds, 2 * waiting_count, load_row(children, 1))
        store_row(waiting_bounds, 2 * waiting_count + 1, load_row(child_bounds, 1))
        waiting_count += 1
        store_row(current, 0, load_row(children, 0))
        store_row(current, 1, load_row(child_bounds, 0))
        row, end = next_row, middle
        next_row += 2
