"""The choice of the nodes of a wide tree: the cheapest one that the binary tree contains.

Dynamic programming over the whole tree, bottom-up (Wald, Benthin and Boulos, "Getting rid of packets", 2008; Ylitie,
Karras and Laine, "Efficient incoherent ray traversal on GPUs through compressed wide BVHs", 2017). A block costs the
same however many triangles it holds, so whole subtrees become one leaf, whatever leaf size the binary tree was built
with.
"""

from __future__ import annotations

import numpy as np

from ..structs import NODE_COUNT, NODE_FIRST, NODE_MAX
from ..support.compiled import compiled

# The cost of a block's test in node steps, and the price of its memory besides, as the area of that many average nodes.
# Blocks of spheres are as fast with four times the price, and with a quarter.
BLOCK_COST = 1.0
BLOCK_PRICE = 16.0


@compiled
def choose_children(nodes, node_ints, width, block_cost, block_price, splits):
    """Find the cheapest way to represent each subtree by 1, 2, ... children of a wide node.

    Parameters
    ----------
    nodes, node_ints : (N, 8) float32 and int32, the same memory
        Lanes of `structs.NODE`, children behind their parents.
    width : int
        Most children of a node, and most triangles of a leaf.
    block_cost, block_price : float
        See `BLOCK_COST` and `BLOCK_PRICE`.
    splits : (N, width + 1) int8, zero, written
        ``splits[node, i]`` is the left child's share where the subtree becomes at most i children; 0 where i - 1
        children are as cheap. ``splits[node, 1]`` is the left child's share of the wide node's own children; 0 for a
        leaf.
    """
    costs = np.empty((len(nodes), width + 1), np.float64)
    prim_counts = np.empty(len(nodes), np.int32)
    price = block_price * _half_area(nodes, 0) / len(nodes)
    for node in range(len(nodes) - 1, -1, -1):
        area = _half_area(nodes, node)
        leaf_cost = area * block_cost + price
        prim_counts[node] = node_ints[node, NODE_COUNT]
        if prim_counts[node] > 0:
            costs[node, 1:] = leaf_cost
            continue
        left = node_ints[node, NODE_FIRST]
        right = left + 1
        prim_counts[node] = prim_counts[left] + prim_counts[right]
        for children in range(2, width + 1):
            cheapest = np.inf
            for left_children in range(1, children):
                cost = costs[left, left_children] + costs[right, children - left_children]
                if cost < cheapest:
                    cheapest = cost
                    splits[node, children] = left_children
            costs[node, children] = cheapest

        # As one child: a wide node with the cheapest number of children, or a leaf.
        costs[node, 1] = costs[node, width] + area
        splits[node, 1] = splits[node, width]
        if prim_counts[node] <= width and leaf_cost <= costs[node, 1]:
            costs[node, 1] = leaf_cost
            splits[node, 1] = 0
        for children in range(2, width + 1):
            if costs[node, children - 1] <= costs[node, children]:
                costs[node, children] = costs[node, children - 1]
                splits[node, children] = 0


@compiled
def _half_area(nodes, node):
    x = nodes[node, NODE_MAX] - nodes[node, 0]
    y = nodes[node, NODE_MAX + 1] - nodes[node, 1]
    z = nodes[node, NODE_MAX + 2] - nodes[node, 2]
    return np.float64(x) * y + np.float64(y) * z + np.float64(z) * x


@compiled
def list_children(node_ints, splits, node, width, stack, children):
    """Write the binary nodes that become the children of a wide node, and return their number.

    Parameters
    ----------
    node_ints : (N, 8) int32
    splits : (N, width + 1) int8
        See `choose_children`.
    node : int
        The binary node that the wide node stands for.
    width : int
    stack : (width + 1, 2) int32, scratch
        Nodes and their shares of the children.
    children : (width,) int32, written
    """
    left_children = splits[node, 1]
    if left_children == 0:
        # The whole tree is one leaf.
        children[0] = node
        return 1
    stack[0, 0], stack[0, 1] = node_ints[node, NODE_FIRST] + 1, width - left_children
    stack[1, 0], stack[1, 1] = node_ints[node, NODE_FIRST], left_children
    stack_size = 2
    count = 0
    while stack_size > 0:
        stack_size -= 1
        child, share = stack[stack_size, 0], stack[stack_size, 1]
        while share > 1 and splits[child, share] == 0:
            share -= 1
        if share == 1:
            children[count] = child
            count += 1
        else:
            left_share = splits[child, share]
            stack[stack_size, 0], stack[stack_size, 1] = node_ints[child, NODE_FIRST] + 1, share - left_share
            stack[stack_size + 1, 0], stack[stack_size + 1, 1] = node_ints[child, NODE_FIRST], left_share
            stack_size += 2
    return count
