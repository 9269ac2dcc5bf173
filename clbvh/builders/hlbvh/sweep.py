"""A cluster becomes the lowest part of a tree: cut where along the Morton curve the surface area cost is lowest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...geometry.boxes import as_node, empty_box, half_area, load_box, store_box, unite
from ...structs import BOX_LANES, PRIM_REF_ID
from ...support.compiled import compiled
from ..halving import middle_of, needs_halving
from ..leaf_prims import insert_prim
from ..options import MAX_DEPTH
from .clusters import CLUSTER_SIZE


class Cluster(NamedTuple):
    """A cluster, and where its subtree goes.

    Attributes
    ----------
    first_ref, ref_count : int
        Its primitive references, in Morton order.
    depth : int
        Depth of its root in the whole tree.
    root, below : int
        Index of its root, and of the first node below.
    first_prim : int
        Where in `prim_ids` its primitives begin.
    """

    first_ref: int
    ref_count: int
    depth: int
    root: int
    below: int
    first_prim: int


class SweepScratch(NamedTuple):
    """Memory for the current node [begin, end) of a cluster, and a stack.

    A left child keeps the values "up to" of its parent, a right child those "from".

    Attributes
    ----------
    boxes_up_to, boxes_from : (CLUSTER_SIZE, 8) float32
        The box from `begin` up to and with each reference, and from each reference up to `end`.
    areas_up_to, areas_from : (CLUSTER_SIZE,) float64
        Half their areas.
    stack : (CLUSTER_SIZE, 3) int64
        Index, end and depth of right children; each begins where the subtree before it ends.
    """

    boxes_up_to: NDArray[np.float32]
    areas_up_to: NDArray[np.float64]
    boxes_from: NDArray[np.float32]
    areas_from: NDArray[np.float64]
    stack: NDArray[np.int64]


@compiled
def make_sweep_scratch():
    """Return the scratch memory of `sweep_cluster`."""
    return SweepScratch(
        np.empty((CLUSTER_SIZE, BOX_LANES), np.float32),
        np.empty(CLUSTER_SIZE, np.float64),
        np.empty((CLUSTER_SIZE, BOX_LANES), np.float32),
        np.empty(CLUSTER_SIZE, np.float64),
        np.empty((CLUSTER_SIZE, 3), np.int64),
    )


@compiled
def sweep_cluster(refs, cluster, rule, nodes, prim_ids, scratch):
    """Build the tree over a cluster, in depth-first order.

    Parameters
    ----------
    refs : (n, 8) float32
    cluster : Cluster
    rule : Rule
    nodes : (N, 8) float32, rows of `structs.NODE`, written
    prim_ids : (m,) int32, written
    scratch : SweepScratch

    Returns
    -------
    int
        Index of the next free node.
    """
    boxes_up_to, areas_up_to, boxes_from, areas_from, stack = scratch
    leaf_size, traversal_cost = rule.leaf_size, rule.traversal_cost
    ref_ints = refs.view(np.int32)
    first_ref, end, depth, index, next_index, first_prim = cluster
    stack_size, begin = 0, 0
    _unite_up_to(refs, first_ref, begin, end, boxes_up_to, areas_up_to)
    _unite_from(refs, first_ref, begin, end, boxes_from, areas_from)
    while True:
        # Find the cheapest cut; in this loop, because a call that takes arrays costs more than most of the cuts.
        size, area = end - begin, areas_from[begin]
        best_cost, middle = np.inf, begin
        for cut in range(begin + 1, end):
            cost = areas_up_to[cut - 1] * (cut - begin) + areas_from[cut] * (end - cut)
            if cost < best_cost:
                best_cost, middle = cost, cut

        # A leaf, if that is allowed and no cut is cheaper; then the node on the stack, which begins where it ends.
        if size <= leaf_size and not traversal_cost * area + best_cost < size * area:
            store_box(nodes, index, as_node(load_box(boxes_from, begin), first_prim + begin, size))
            for offset in range(begin, end):
                prim = ref_ints[first_ref + offset, PRIM_REF_ID]
                insert_prim(prim_ids, first_prim + begin, first_prim + offset, prim)
            if stack_size == 0:
                return next_index
            stack_size -= 1
            begin = end
            index, end, depth = stack[stack_size, 0], stack[stack_size, 1], stack[stack_size, 2]
            _unite_up_to(refs, first_ref, begin, end, boxes_up_to, areas_up_to)
            continue

        # Too few levels left for another cut than halves.
        if size > MAX_DEPTH - depth and needs_halving(size, depth):
            middle = middle_of(begin, end)

        # An interior node; its right child goes on the stack, the left one is next.
        store_box(nodes, index, as_node(load_box(boxes_from, begin), next_index, 0))
        depth += 1
        stack[stack_size, 0], stack[stack_size, 1], stack[stack_size, 2] = next_index + 1, end, depth
        stack_size += 1
        index, end = next_index, middle
        next_index += 2
        _unite_from(refs, first_ref, begin, end, boxes_from, areas_from)


@compiled
def _unite_up_to(refs, first_ref, begin, end, boxes, areas):
    box = empty_box()
    for offset in range(begin, end):
        box = unite(load_box(refs, first_ref + offset), box)
        store_box(boxes, offset, box)
        areas[offset] = half_area(box)


@compiled
def _unite_from(refs, first_ref, begin, end, boxes, areas):
    box = empty_box()
    for offset in range(end - 1, begin - 1, -1):
        box = unite(load_box(refs, first_ref + offset), box)
        store_box(boxes, offset, box)
        areas[offset] = half_area(box)
