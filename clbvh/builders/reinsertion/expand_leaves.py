"""The first step: a finished tree becomes an `ExpandedTree`, its leaves split down to single triangles."""

from __future__ import annotations

import numpy as np

from ...geometry.boxes import empty_box, half_area, load_box, store_box, unite
from ...structs import BOX_NEGATED_MAX, EXPANDED_FIRST, EXPANDED_PRIM_ID, NODE_COUNT, NODE_FIRST, NODE_MAX
from ...support.compiled import compiled
from ..options import MAX_DEPTH, MAX_LEAF_SIZE
from .expanded_tree import ROOT


@compiled
def expand_leaves(nodes, node_ints, prim_ids, prim_refs, tree):
    """Write the expanded tree.

    Parameters
    ----------
    nodes, node_ints : (N, 8) float32 and int32, the same memory
        Lanes of `structs.NODE`.
    prim_ids : (n,) int32
    prim_refs : (n, 8) float32
        Of all triangles, see `prim_refs`.
    tree : ExpandedTree, written
    """
    boxes, links, parents = tree
    order = np.empty((3, MAX_LEAF_SIZE), np.int32)
    right_costs = np.empty(MAX_LEAF_SIZE, np.float64)
    stack = np.empty((MAX_DEPTH + 1, 2), np.int32)  # nodes of the finished tree, and of the expanded one
    stack[0, 0], stack[0, 1] = 0, ROOT
    stack_size = 1
    parents[0] = 0
    next_pair = 2
    while stack_size > 0:
        stack_size -= 1
        source, target = stack[stack_size, 0], stack[stack_size, 1]
        first, count = node_ints[source, NODE_FIRST], node_ints[source, NODE_COUNT]
        if count > 0:
            prims = prim_ids[first : first + count].copy()
            next_pair = _split_leaf(prims, prim_refs, target, next_pair, order, right_costs, tree)
            continue
        for axis in range(3):
            boxes[target, axis] = nodes[source, axis]
            boxes[target, BOX_NEGATED_MAX + axis] = np.float32(0.0) - nodes[source, NODE_MAX + axis]
        links[target, EXPANDED_FIRST], links[target, EXPANDED_PRIM_ID] = next_pair, 0
        parents[next_pair >> 1] = target
        stack[stack_size, 0], stack[stack_size, 1] = first + 1, next_pair + 1
        stack[stack_size + 1, 0], stack[stack_size + 1, 1] = first, next_pair
        stack_size += 2
        next_pair += 2


@compiled
def _split_leaf(prims, prim_refs, node, next_pair, order, right_costs, tree):
    """Split a leaf at the lowest cost until every triangle is alone; return the next free pair of nodes."""
    boxes, links, parents = tree
    stack = [(0, len(prims), node)]  # ranges of `prims`, and their nodes
    while len(stack) > 0:
        begin, end, node = stack.pop()
        if end - begin == 1:
            store_box(boxes, node, load_box(prim_refs, prims[begin]))
            links[node, EXPANDED_FIRST], links[node, EXPANDED_PRIM_ID] = 0, prims[begin]
            continue
        box = empty_box()
        for index in range(begin, end):
            box = unite(load_box(prim_refs, prims[index]), box)
        store_box(boxes, node, box)
        middle = begin + sweep(prims[begin:end], prim_refs, order, right_costs)
        links[node, EXPANDED_FIRST], links[node, EXPANDED_PRIM_ID] = next_pair, 0
        parents[next_pair >> 1] = node
        stack.append((middle, end, next_pair + 1))
        stack.append((begin, middle, next_pair))
        next_pair += 2
    return next_pair


@compiled
def sweep(prims, prim_refs, order, right_costs):
    """Sort the triangles of a leaf along the axis of the cheapest split; return the number left of the split.

    Parameters
    ----------
    prims : (k,) int32, sorted
        At least two.
    prim_refs : (n, 8) float32
    order : (3, >= k) int32, scratch
    right_costs : (>= k,) float64, scratch

    Notes
    -----
    O(k^2): for leaves. Of equal costs the more even split is taken, then the lowest axis.
    """
    count = len(prims)
    best_cost, best_axis, best_left, best_evenness = np.inf, 0, count // 2, -1
    for axis in range(3):
        # By the doubled centroid; the insertion sort is stable.
        for index in range(count):
            prim = prims[index]
            key = prim_refs[prim, axis] - prim_refs[prim, BOX_NEGATED_MAX + axis]
            slot = index
            while slot > 0:
                before = order[axis, slot - 1]
                if not prim_refs[before, axis] - prim_refs[before, BOX_NEGATED_MAX + axis] > key:
                    break
                order[axis, slot] = before
                slot -= 1
            order[axis, slot] = prim

        box = empty_box()
        for left_count in range(count - 1, 0, -1):
            box = unite(load_box(prim_refs, order[axis, left_count]), box)
            right_costs[left_count] = half_area(box) * (count - left_count)
        box = empty_box()
        for left_count in range(1, count):
            box = unite(load_box(prim_refs, order[axis, left_count - 1]), box)
            cost = half_area(box) * left_count + right_costs[left_count]
            evenness = min(left_count, count - left_count)
            if cost < best_cost or (cost == best_cost and evenness > best_evenness):
                best_cost, best_axis, best_left, best_evenness = cost, axis, left_count, evenness
    for index in range(count):
        prims[index] = order[best_axis, index]
    return best_left
