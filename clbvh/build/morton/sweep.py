"""A cluster becomes the lowest part of a tree: cut where along the Morton curve the surface area cost is lowest."""

from __future__ import annotations

import numpy as np
from numba import njit

from ...simd import LANES, as_node, empty_box, half_area, load_row, store_row, unite
from ..metadata import PRIM_ID
from ..options import MAX_DEPTH
from ..subtree import needs_halving
from .clusters import CLUSTER_SIZE


@njit(cache=True, nogil=True)
def make_sweep_scratch():  # type: ignore[no-untyped-def]
    """Return what `sweep_cluster` needs: boxes and areas up to and from each record, and nodes that wait."""
    return (
        np.empty((CLUSTER_SIZE, LANES), np.float32),
        np.empty(CLUSTER_SIZE, np.float64),
        np.empty((CLUSTER_SIZE, LANES), np.float32),
        np.empty(CLUSTER_SIZE, np.float64),
        np.empty((CLUSTER_SIZE, 3), np.int64),
    )


@njit(cache=True, nogil=True)
def sweep_cluster(  # type: ignore[no-untyped-def]
    records,
    record_ids,
    first_record,
    count,
    depth,
    leaf_size,
    traversal_cost,
    row,
    next_row,
    nodes,
    first_prim,
    prim_ids,
    scratch,
):
    """Build the tree over a cluster, in depth-first order.

    Parameters
    ----------
    records, record_ids : (n, 8) float32 and int32, the same memory
        In Morton order.
    first_record, count, depth : int
        The cluster, and how deep its root lies.
    leaf_size, traversal_cost
        See `BuildOptions`.
    row, next_row : int
        The root's row, and the first row for what lies below.
    nodes : (N, 8) float32, rows of `layout.NODE`, written
    first_prim : int
        Where in `prim_ids` the cluster's primitives go.
    prim_ids : (m,) int32, written
    scratch
        From `make_sweep_scratch`.

    Returns
    -------
    int
        The next free row.
    """
    # Of the node at hand, [begin, end): the box from its begin up to each record, and from each record up to its end.
    # A left child keeps the former of its parent, a right one the latter.
    boxes_up_to, areas_up_to, boxes_from, areas_from, waiting = scratch
    waiting_count, begin, end = 0, 0, count
    _unite_up_to(records, first_record, begin, end, boxes_up_to, areas_up_to)
    _unite_from(records, first_record, begin, end, boxes_from, areas_from)
    while True:
        # Find the cheapest cut.
        size = end - begin
        best_cost, middle = np.inf, begin
        for cut in range(begin + 1, end):
            cost = areas_up_to[cut - 1] * (cut - begin) + areas_from[cut] * (end - cut)
            if cost < best_cost:
                best_cost, middle = cost, cut

        # A leaf, if that is allowed and no cut is cheaper; then the node that waits: it begins where this one ends.
        area = areas_from[begin]
        if size <= leaf_size and not traversal_cost * area + best_cost < size * area:
            store_row(nodes, row, as_node(load_row(boxes_from, begin), first_prim + begin, size))
            _list_leaf(record_ids, first_record + begin, size, first_prim + begin, prim_ids)
            if waiting_count == 0:
                return next_row
            waiting_count -= 1
            begin = end
            row, end, depth = waiting[waiting_count, 0], waiting[waiting_count, 1], waiting[waiting_count, 2]
            _unite_up_to(records, first_record, begin, end, boxes_up_to, areas_up_to)
            continue

        # Too few levels left to be choosy: a cut in the middle.
        if size > MAX_DEPTH - depth and needs_halving(size, depth):
            middle = begin + size // 2

        # Two rows for the children; the right one waits, the left one is next.
        store_row(nodes, row, as_node(load_row(boxes_from, begin), next_row, 0))
        depth += 1
        waiting[waiting_count, 0], waiting[waiting_count, 1], waiting[waiting_count, 2] = next_row + 1, end, depth
        waiting_count += 1
        row, end = next_row, middle
        next_row += 2
        _unite_from(records, first_record, begin, end, boxes_from, areas_from)


@njit(cache=True, nogil=True)
def _unite_up_to(records, first_record, begin, end, boxes, areas):  # type: ignore[no-untyped-def]
    box = empty_box()
    for index in range(begin, end):
        box = unite(load_row(records, first_record + index), box)
        store_row(boxes, index, box)
        areas[index] = half_area(box)


@njit(cache=True, nogil=True)
def _unite_from(records, first_record, begin, end, boxes, areas):  # type: ignore[no-untyped-def]
    box = empty_box()
    for index in range(end - 1, begin - 1, -1):
        box = unite(load_row(records, first_record + index), box)
        store_row(boxes, index, box)
        areas[index] = half_area(box)


@njit(cache=True, nogil=True)
def _list_leaf(record_ids, first_record, count, first_prim, prim_ids):  # type: ignore[no-untyped-def]
    """List the primitives of a leaf, ascending."""
    for index in range(count):
        prim = record_ids[first_record + index, PRIM_ID]
        place = first_prim + index
        while place > first_prim and prim_ids[place - 1] > prim:
            prim_ids[place] = prim_ids[place - 1]
            place -= 1
        prim_ids[place] = prim
