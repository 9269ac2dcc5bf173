"""Clusters: short runs of primitive references in Morton order; the tree above treats each as one primitive.

References are sorted, cut into clusters, and each cluster becomes the lowest part of a tree, cut where along the Morton
curve the surface area cost is lowest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...geometry.boxes import as_node, centroid_of, empty_box, half_area, load_box, store_box, unite
from ...structs import BOX_LANES, PRIM_REF_ID
from ...support.compiled import compiled
from ..invariants import insert_prim, middle_of, needs_halving
from ..options import MAX_DEPTH
from .treelets import code_of, make_grid

# Bits of a digit of the radix sort: its counters fit the first-level cache.
_DIGIT_BITS = 9
_AXIS_BITS_PER_DIGIT = _DIGIT_BITS // 3

# The grid of a treelet, over its own centroids, has 64 cells along an axis when it holds few primitives, else 512.
_SMALL_TREELET = 4096
_SMALL_DIGITS = 2
_MOST_DIGITS = 3

_DIGIT_VALUES = 1 << _DIGIT_BITS
_INDEX_BITS = 32
_INDEX_MASK = (1 << _INDEX_BITS) - 1


@compiled
def sort_prim_refs(source, first, count, refs, codes, keys, other_keys):
    """Copy primitive references in Morton order; those in one cell keep their order.

    Parameters
    ----------
    source : (k, 8) float32
        The primitive references are `source[first : first + count]`.
    refs : (>= count, 8) float32, written
    codes : (>= count,) int32, written
        The Morton code of each copied reference.
    keys, other_keys : (>= count,) int64, scratch
    """
    bounds = np.empty((1, BOX_LANES), np.float32)
    centroid_box = empty_box()
    for index in range(first, first + count):
        centroid_box = unite(centroid_of(load_box(source, index)), centroid_box)
    store_box(bounds, 0, centroid_box)
    digits = _SMALL_DIGITS if count <= _SMALL_TREELET else _MOST_DIGITS
    grid = make_grid(bounds, 0, _AXIS_BITS_PER_DIGIT * digits)
    lower, scales = load_box(grid, 0), load_box(grid, 1)

    # Keys: the code above, the index below. Counts: how often each digit has each value.
    counts = np.zeros((digits, _DIGIT_VALUES), np.int64)
    for index in range(count):
        code = code_of(load_box(source, first + index), lower, scales)
        keys[index] = code << _INDEX_BITS | index
        for digit in range(digits):
            counts[digit, code >> digit * _DIGIT_BITS & (_DIGIT_VALUES - 1)] += 1

    # Last digit first.
    for digit in range(digits):
        begin = 0
        for value in range(_DIGIT_VALUES):
            begin, counts[digit, value] = begin + counts[digit, value], begin
        shift = _INDEX_BITS + digit * _DIGIT_BITS
        for index in range(count):
            key = keys[index]
            value = key >> shift & (_DIGIT_VALUES - 1)
            other_keys[counts[digit, value]] = key
            counts[digit, value] += 1
        keys, other_keys = other_keys, keys

    for index in range(count):
        codes[index] = keys[index] >> _INDEX_BITS
        store_box(refs, index, load_box(source, first + (keys[index] & _INDEX_MASK)))


# Most primitive references in a cluster. More: less time; fewer: a better tree.
CLUSTER_SIZE = 32

# A cut halves the range or takes one bit of the code: more than there are of both.
_STACK_SIZE = 96


@compiled
def find_cut(codes, begin, end):
    """Return where the highest bit that is not the same in all codes of a range changes; its middle if all are equal.

    After Lauterbach et al., "Fast BVH construction on GPUs" (2009).
    """
    differing = codes[begin] ^ codes[end - 1]
    if differing == 0:
        return middle_of(begin, end)
    while differing & (differing - 1):
        differing &= differing - 1
    first_above = codes[end - 1] & -differing
    lower, upper = begin, end - 1
    while lower < upper:
        middle = (lower + upper) >> 1
        if codes[middle] >= first_above:
            upper = middle
        else:
            lower = middle + 1
    return lower


@compiled
def cut_clusters(codes, count, begins):
    """Cut sorted codes until no run is longer than `CLUSTER_SIZE`.

    Parameters
    ----------
    codes : (>= count,) int32
    begins : (>= count + 1,) int32, written
        Where each cluster begins, and where the last one ends.

    Returns
    -------
    int
        Number of clusters.
    """
    stack = np.empty(_STACK_SIZE, np.int64)  # ends of ranges; each begins where the one above it in the stack ends
    stack_size, cluster_count, begin, end = 0, 0, 0, count
    while True:
        if end - begin > CLUSTER_SIZE:
            stack[stack_size] = end
            stack_size += 1
            end = find_cut(codes, begin, end)
            continue
        begins[cluster_count] = begin
        cluster_count += 1
        begin = end
        if stack_size == 0:
            begins[cluster_count] = count
            return cluster_count
        stack_size -= 1
        end = stack[stack_size]


@compiled
def bound_clusters(refs, begins, cluster_count, boxes, wholes, row):
    """Write the box of each cluster, and the box of all.

    Parameters
    ----------
    refs : (n, 8) float32
        In Morton order.
    begins : (>= cluster_count + 1,) int32
        See `cut_clusters`.
    boxes : (>= cluster_count, 8) float32, written
    wholes : (k, 8) float32, written
        `wholes[row]` becomes the box of all.
    """
    whole = empty_box()
    for cluster in range(cluster_count):
        box = empty_box()
        for index in range(begins[cluster], begins[cluster + 1]):
            box = unite(load_box(refs, index), box)
        store_box(boxes, cluster, box)
        whole = unite(box, whole)
    store_box(wholes, row, whole)


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
