"""One range of primitives becomes a subtree, in one compiled loop on one core.

A range [begin, end) writes only to its own records and to prim_ids[begin:end], so ranges that do not overlap need
neither a shared counter nor a lock.

Finished nodes take the place of finished records. The loop works from right to left, and the records of a leaf are
needed no more, in both buffers: 2 rows for each primitive. A tree over n primitives has at most 2n - 1 nodes, and so
have its parts, so there is always room. Nodes come in the reverse of depth-first order: all below the right child,
all below the left child, then the right child and the left child themselves. `node_place` says where the n-th is.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ..simd import LANES, as_node, half_area, load_row, store_row
from .few import FEW, count_left, divide, find_division
from .metadata import PRIM_ID
from .options import MAX_DEPTH
from .partition import bound_halves, partition
from .splits import bin_count_for, fill_bins, find_split, make_bins, unite_sides


@njit(cache=True, nogil=True)
def needs_halving(prim_count, depth):  # type: ignore[no-untyped-def]
    """Say whether only splits by halves still keep `prim_count` primitives above MAX_DEPTH."""
    levels = 0
    while (1 << levels) < prim_count:
        levels += 1
    return levels >= MAX_DEPTH - depth


@njit(cache=True, nogil=True)
def node_place(end, number):  # type: ignore[no-untyped-def]
    """Return (buffer, row) of the n-th finished node of a range that ends at `end`."""
    return number & 1, end - 1 - (number >> 1)


@njit(cache=True, nogil=True)
def finish_node(boxes, box, first, count):  # type: ignore[no-untyped-def]
    """Make a row of `layout.NODE` of the box `boxes[box]`."""
    store_row(boxes, box, as_node(load_row(boxes, box), first, count))


@njit(cache=True, nogil=True)
def emit_node(records, end, number, nodes, node):  # type: ignore[no-untyped-def]
    """Write `nodes[node]` as the n-th finished node of a range that ends at `end`; see `node_place`."""
    buffer, row = node_place(end, number)
    store_row(records[buffer], row, load_row(nodes, node))


@njit(cache=True, nogil=True)
def build_subtree(  # type: ignore[no-untyped-def]
    records,
    record_ints,
    begin,
    end,
    buffer,
    depth,
    bounds,
    bins,
    leaf_size,
    traversal_cost,
    prim_ids,
):
    """Build the subtree over one range.

    Parameters
    ----------
    records, record_ints : (2, n, 8) float32 and int32, the same memory, overwritten
        Two buffers of records; the range is read from buffer `buffer`. Afterwards they hold the nodes, see
        `node_place`: rows of `layout.NODE`, except that an interior node's `first` is its left child's number. The root
        is the last one.
    begin, end, buffer, depth : int
        The range, where it is, and how deep its root lies in the whole tree.
    bounds : (2, 8) float32
        Row 0: the box of the range. Row 1: the box of its centroids.
    bins, leaf_size, traversal_cost
        See `BuildOptions`.
    prim_ids : (n,) int32, written

    Returns
    -------
    int
        Number of nodes.
    """
    node_bins = make_bins(bins)
    right_costs = np.empty(3 * bins, np.float64)
    children = np.empty((2, LANES), np.float32)
    child_bounds = np.empty((2, LANES), np.float32)
    current = np.empty((2, LANES), np.float32)  # box and centroid bounds of the node at hand

    # The nodes above the one at hand, one per level, and their children: row 2 * level is the left one. A left child
    # waits until all below the right one is finished.
    levels = MAX_DEPTH + 1
    boxes = np.empty((2 * levels, LANES), np.float32)
    waiting = np.empty((levels, 3), np.int64)  # begin, end, buffer of the left child; end is 0 once it is taken
    waiting_bounds = np.empty((levels, LANES), np.float32)
    level = 0

    range_end = end
    node_count = 0
    store_row(current, 0, load_row(bounds, 0))
    store_row(current, 1, load_row(bounds, 1))
    while True:
        prim_count = end - begin
        source = records[buffer]

        # Find the cheapest split, unless there is nothing to split or no level left to be choosy.
        cost = np.inf
        axis, last_left_bin, left_count, left = 0, 0, 0, 0
        bin_count = bin_count_for(prim_count, bins)
        if prim_count > 1 and not needs_halving(prim_count, depth + level):
            if prim_count <= FEW:
                cost, left = find_division(source, begin, prim_count)
            else:
                fill_bins(source, begin, end, current, 1, bin_count, node_bins)
                cost, axis, last_left_bin, left_count = find_split(node_bins, bin_count, right_costs)

        # A leaf, if that is allowed and no split is cheaper.
        area = half_area(load_row(current, 0))
        if prim_count <= leaf_size and not traversal_cost * area + cost < prim_count * area:
            source_ids = record_ints[buffer]
            for record in range(begin, end):
                prim_ids[record] = source_ids[record, PRIM_ID]
            first, count = begin, prim_count

            # It may have been the last one below the node above, and that one below its own.
            while level > 0 and waiting[level - 1, 1] == 0:
                level -= 1
                finish_node(boxes, 2 * level, first, count)
                emit_node(records, range_end, node_count, boxes, 2 * level + 1)
                emit_node(records, range_end, node_count + 1, boxes, 2 * level)
                first, count = node_count + 1, 0
                node_count += 2
            if level == 0:
                store_row(current, 0, load_row(bounds, 0))
                finish_node(current, 0, first, count)
                emit_node(records, range_end, node_count, current, 0)
                return node_count + 1

            # What is finished is a right child; the left one is next.
            above = level - 1
            finish_node(boxes, 2 * above + 1, first, count)
            begin, end, buffer = waiting[above, 0], waiting[above, 1], waiting[above, 2]
            waiting[above, 1] = 0
            store_row(current, 0, load_row(boxes, 2 * above))
            store_row(current, 1, load_row(waiting_bounds, above))
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

        # The left child waits, the right one is next.
        waiting[level, 0], waiting[level, 1], waiting[level, 2] = begin, middle, buffer
        store_row(waiting_bounds, level, load_row(child_bounds, 0))
        store_row(boxes, 2 * level, load_row(children, 0))
        store_row(boxes, 2 * level + 1, load_row(children, 1))
        store_row(current, 0, load_row(children, 1))
        store_row(current, 1, load_row(child_bounds, 1))
        begin = middle
        level += 1
