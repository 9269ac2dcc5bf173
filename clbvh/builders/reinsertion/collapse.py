"""The last step: a rearranged tree becomes a finished one, with the cheapest leaves, in depth-first order.

The opposite of `expand_leaves`.
"""

from __future__ import annotations

import numpy as np

from ...geometry.boxes import half_area, load_box
from ...structs import BOX_NEGATED_MAX, EXPANDED_FIRST, EXPANDED_PRIM_ID, NODE_COUNT, NODE_FIRST, NODE_MAX
from ...support.compiled import compiled
from ..leaf_prims import insert_prim
from ..options import MAX_DEPTH, MAX_LEAF_SIZE
from .expanded_tree import ROOT


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
