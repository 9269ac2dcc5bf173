"""A tree that can be rearranged: how a finished tree becomes one, and how it becomes a finished tree again.

Every triangle is a leaf of its own, and every node knows its parent. Node 1 is the root, node 0 is unused, and siblings
are nodes 2k and 2k + 1: ``node ^ 1`` is a node's sibling, and one entry of `parents` serves both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...geometry.boxes import empty_box, half_area, load_box, store_box, unite
from ...structs import BOX_NEGATED_MAX, EXPANDED_FIRST, EXPANDED_PRIM_ID, NODE_COUNT, NODE_FIRST, NODE_MAX
from ...support.compiled import compiled
from ..invariants import insert_prim
from ..options import MAX_DEPTH, MAX_LEAF_SIZE

ROOT = 1


class ExpandedTree(NamedTuple):
    """The arrays of a tree over n triangles, for compiled loops.

    Attributes
    ----------
    boxes, links : (2n, 8) float32 and int32, the same memory
        Each node's `structs.BOX`. Two of its lanes are integers: `EXPANDED_FIRST`, the first child, 0 for a leaf, and
        `EXPANDED_PRIM_ID`, the leaf's triangle.
    parents : (n,) int32
        ``parents[node >> 1]`` is the parent of a node; 0 for the root.
    """

    boxes: NDArray[np.float32]
    links: NDArray[np.int32]
    parents: NDArray[np.int32]


@compiled
def list_descendants(links, top, descendants):
    """Write the nodes below `top`, level by level, and return their number.

    Parameters
    ----------
    links : (2n, 8) int32
    top : int
    descendants : (>= k,) int32, written
    """
    count = seen = 0
    node = top
    while True:
        child = links[node, EXPANDED_FIRST]
        if child != 0:
            descendants[count], descendants[count + 1] = child, child + 1
            count += 2
        if seen == count:
            return count
        node = descendants[seen]
        seen += 1


@compiled
def count_prims(links, order):
    """Return the number of triangles below each node, (2n,) int32; `order` holds all nodes, parents first."""
    prim_counts = np.empty(len(links), np.int32)
    for index in range(len(order) - 1, -1, -1):
        node = order[index]
        child = links[node, EXPANDED_FIRST]
        prim_counts[node] = 1 if child == 0 else prim_counts[child] + prim_counts[child + 1]
    return prim_counts


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


@compiled
def choose_leaves(tree, leaf_size, traversal_cost, order, is_leaf):
    """Mark the leaves of the tree of the lowest SAH cost, and return the depth of that tree.

    Parameters
    ----------
    tree : ExpandedTree
    leaf_size, traversal_cost
        See `BuildOptions`.
    order : (k,) int32
        All nodes, parents before their children.
    is_leaf : (2n,) bool, written
        Has no meaning for nodes below a leaf.

    Notes
    -----
    Exact: the cheapest form of a subtree does not depend on the rest of the tree. Equal costs make a leaf.
    """
    boxes, links, _ = tree
    costs = np.empty(len(boxes), np.float64)
    prim_counts = np.empty(len(boxes), np.int32)
    heights = np.empty(len(boxes), np.int32)
    for index in range(len(order) - 1, -1, -1):
        node = order[index]
        area = half_area(load_box(boxes, node))
        child = links[node, EXPANDED_FIRST]
        if child == 0:
            costs[node], prim_counts[node], heights[node], is_leaf[node] = area, 1, 0, True
            continue
        count = prim_counts[child] + prim_counts[child + 1]
        split_cost = traversal_cost * area + costs[child] + costs[child + 1]
        prim_counts[node] = count
        is_leaf[node] = count <= leaf_size and count * area <= split_cost
        costs[node] = count * area if is_leaf[node] else split_cost
        heights[node] = 0 if is_leaf[node] else 1 + max(heights[child], heights[child + 1])
    return heights[ROOT]


@compiled
def collapse(tree, is_leaf, nodes, node_ints, prim_ids):
    """Write the nodes in depth-first order and return their number.

    Parameters
    ----------
    tree : ExpandedTree
    is_leaf : (2n,) bool
        Of a tree that is at most `MAX_DEPTH` deep.
    nodes, node_ints : (2n, 8) float32 and int32, the same memory, written
        Lanes of `structs.NODE`.
    prim_ids : (n,) int32, written
    """
    boxes, links, _ = tree
    stack = np.empty((MAX_DEPTH + 1, 2), np.int32)  # nodes of the expanded tree, and of the finished one
    leaf_stack = np.empty(MAX_LEAF_SIZE, np.int32)
    stack[0, 0], stack[0, 1] = ROOT, 0
    stack_size = 1
    node_count, prim_count = 1, 0
    while stack_size > 0:
        stack_size -= 1
        source, target = stack[stack_size, 0], stack[stack_size, 1]
        for axis in range(3):
            nodes[target, axis] = boxes[source, axis]
            nodes[target, NODE_MAX + axis] = np.float32(0.0) - boxes[source, BOX_NEGATED_MAX + axis]
        if is_leaf[source]:
            first = prim_count
            prim_count = _list_prims(links, source, prim_ids, first, leaf_stack)
            node_ints[target, NODE_FIRST], node_ints[target, NODE_COUNT] = first, prim_count - first
            continue
        child = links[source, EXPANDED_FIRST]
        node_ints[target, NODE_FIRST], node_ints[target, NODE_COUNT] = node_count, 0
        stack[stack_size, 0], stack[stack_size, 1] = child + 1, node_count + 1
        stack[stack_size + 1, 0], stack[stack_size + 1, 1] = child, node_count
        stack_size += 2
        node_count += 2
    return node_count


@compiled
def _list_prims(links, top, prim_ids, begin, stack):
    """Write the triangles below a node, ascending, to `prim_ids` from `begin` on, and return the end."""
    end = begin
    stack[0] = top
    stack_size = 1
    while stack_size > 0:
        stack_size -= 1
        node = stack[stack_size]
        child = links[node, EXPANDED_FIRST]
        if child != 0:
            stack[stack_size], stack[stack_size + 1] = child + 1, child
            stack_size += 2
            continue
        insert_prim(prim_ids, begin, end, links[node, EXPANDED_PRIM_ID])
        end += 1
    return end
