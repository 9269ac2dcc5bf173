"""The layouts `bvh4` and `bvh8`: up to four or eight children per node, and leaves that fill a block of triangles.

Owns the nodes and the lists of the triangles in the blocks; `leaf_blocks.py` gathers the corners.

The nodes are the cheapest ones that the binary tree contains, by dynamic programming over the whole tree, bottom-up
(Wald, Benthin and Boulos, "Getting rid of packets", 2008; Ylitie, Karras and Laine, "Efficient incoherent ray traversal
on GPUs through compressed wide BVHs", 2017). A block costs the same however many triangles it holds, so whole subtrees
become one leaf, whatever leaf size the binary tree was built with. Leaves with more triangles than a block holds become
subtrees whose leaves fill blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..bvh.bvh import Bvh
from ..geometry.corners import Bounded, find_corners
from ..structs import NO_PRIM, NODE_COUNT, NODE_FIRST, NODE_LANES, NODE_MAX, WIDE_NODES
from ..support.compiled import compiled


@dataclass(frozen=True, eq=False)
class WideTree:
    """The nodes of a wide tree, and the triangles in each of its leaves.

    Attributes
    ----------
    nodes : (N,) `structs.WIDE_NODES[width]`
        Node 0 is the root; children stand behind their parent, siblings together.
    blocks : (G, width) int32
        Faces of the mesh in each leaf's block, `NO_PRIM` in the lanes that are left over.
    stack_size : int
        Most entries on the stack of a traversal.
    """

    nodes: NDArray[np.void]
    blocks: NDArray[np.int32]
    stack_size: int


def widen(bvh: Bvh, width: int) -> WideTree:
    """Return the wide tree that a ray traverses fastest, of those that the binary tree contains.

    Parameters
    ----------
    bvh : Bvh
        With leaves of any size.
    width : int
        Most children of a node, and most triangles of a leaf: 4 or 8.

    Notes
    -----
    O(nodes), on one core. The same tree gives the same bytes.
    """
    nodes, prim_ids = split_leaves(bvh, width), bvh.prim_ids
    node_ints = nodes.view(np.int32)
    splits = np.zeros((len(nodes), width + 1), np.int8)
    choose_children(nodes, node_ints, width, block_price(bvh.shape), splits)
    wide_nodes = np.empty(max(1, len(nodes) // 2), WIDE_NODES[width])
    blocks = np.full((len(nodes) // 2 + 1, width), NO_PRIM, np.int32)
    lanes = wide_nodes.view(np.float32).reshape(len(wide_nodes), -1)
    node_count, block_count, stack_size = _write_nodes(
        nodes, node_ints, prim_ids, width, splits, lanes, lanes.view(np.int32), blocks
    )
    return WideTree(wide_nodes[:node_count], blocks[:block_count], stack_size)


@compiled
def _write_nodes(nodes, node_ints, prim_ids, width, splits, wide_nodes, wide_ints, blocks):
    """Write the chosen nodes and blocks; return their numbers, and the stack size of a traversal."""
    greatest = np.finfo(np.float32).max
    # Lanes: three coordinates of the minimum, three of the maximum, then the children.
    first_max, first_child = 3 * width, 6 * width
    pending = np.empty((len(wide_nodes), 2), np.int32)  # binary nodes and the wide nodes they become
    parents = np.empty(len(wide_nodes), np.int32)
    stack_sizes = np.zeros(len(wide_nodes), np.int32)
    children = np.empty(width, np.int32)
    stack = np.empty((width + 1, 2), np.int32)
    pending[0, 0] = pending[0, 1] = 0
    pending_count = 1
    node_count = 1
    block_count = 0
    while pending_count > 0:
        pending_count -= 1
        source, target = pending[pending_count, 0], pending[pending_count, 1]
        child_count = list_children(node_ints, splits, source, width, stack, children)
        stack_sizes[target] = child_count - 1
        for slot in range(width):
            # A missing child has an inverted box.
            for axis in range(3):
                wide_nodes[target, axis * width + slot] = greatest
                wide_nodes[target, first_max + axis * width + slot] = -greatest
            wide_ints[target, first_child + slot] = 0
            if slot >= child_count:
                continue
            child = children[slot]
            for axis in range(3):
                wide_nodes[target, axis * width + slot] = nodes[child, axis]
                wide_nodes[target, first_max + axis * width + slot] = nodes[child, NODE_MAX + axis]
            if splits[child, 1] == 0:
                wide_ints[target, first_child + slot] = ~block_count
                _list_prims(node_ints, prim_ids, child, stack, blocks[block_count])
                block_count += 1
            else:
                wide_ints[target, first_child + slot] = node_count
                parents[node_count] = target
                pending[pending_count, 0], pending[pending_count, 1] = child, node_count
                pending_count += 1
                node_count += 1

    # While a child is visited, its siblings and those of all its ancestors are on the stack.
    for node in range(node_count - 1, 0, -1):
        parent = parents[node]
        child_count = 0
        for slot in range(width):
            child_count += wide_nodes[parent, slot] <= wide_nodes[parent, first_max + slot]
        stack_sizes[parent] = max(stack_sizes[parent], child_count - 1 + stack_sizes[node])
    return node_count, block_count, stack_sizes[0]


@compiled
def _list_prims(node_ints, prim_ids, top, stack, prims):
    """Write the primitives of a small subtree in the tree's order."""
    stack[0, 0] = top
    stack_size = 1
    count = 0
    while stack_size > 0:
        stack_size -= 1
        node = stack[stack_size, 0]
        first = node_ints[node, NODE_FIRST]
        if node_ints[node, NODE_COUNT] == 0:
            stack[stack_size, 0], stack[stack_size + 1, 0] = first + 1, first
            stack_size += 2
        else:
            for index in range(first, first + node_ints[node, NODE_COUNT]):
                prims[count] = prim_ids[index]
                count += 1


# The price of a block's memory besides its test, which costs as much as a node step: as the area of this many average
# nodes, if a tree had one for each primitive. Blocks of spheres are as fast with four times the price, and with a
# quarter.
_BLOCK_PRICE = 20.0


def block_price(shape: Bounded) -> np.float32:
    """Return what a block costs besides its area, in units of that: for trees over this shape."""
    lower, upper = shape.local_box.astype(np.float64)
    x, y, z = upper - lower
    return np.float32(_BLOCK_PRICE * (x * y + y * z + z * x) / shape.prim_count)


@compiled
def choose_children(nodes, node_ints, width, block_price, splits):
    """Find the cheapest way to represent each subtree by 1, 2, ... children of a wide node.

    Parameters
    ----------
    nodes, node_ints : (N, 8) float32 and int32, the same memory
        Lanes of `structs.NODE`, children behind their parents.
    width : int
        Most children of a node, and most triangles of a leaf.
    block_price : float32
        See `block_price`.
    splits : (N, width + 1) int8, zero, written
        ``splits[node, i]`` is the left child's share where the subtree becomes at most i children; 0 where i - 1
        children are as cheap. ``splits[node, 1]`` is the left child's share of the wide node's own children; 0 for a
        leaf.
    """
    # In float32, as a device computes that builds trees, see cl/tree/choose.cl.
    costs = np.empty((len(nodes), width + 1), np.float32)
    prim_counts = np.empty(len(nodes), np.int32)
    for node in range(len(nodes) - 1, -1, -1):
        area = _half_area(nodes, node)
        leaf_cost = area + block_price
        prim_counts[node] = node_ints[node, NODE_COUNT]
        if prim_counts[node] > 0:
            costs[node, 1:] = leaf_cost
            continue
        left = node_ints[node, NODE_FIRST]
        right = left + 1
        prim_counts[node] = prim_counts[left] + prim_counts[right]
        for children in range(2, width + 1):
            cheapest = np.float32(np.inf)
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
    return x * y + y * z + z * x


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


def split_leaves(bvh: Bvh, leaf_size: int) -> NDArray[np.float32]:
    """Return the nodes of a tree whose leaves have at most `leaf_size` triangles.

    Parameters
    ----------
    bvh : Bvh
        The order of its primitives is kept: all but the last new leaf of each old one are full.
    leaf_size : int

    Returns
    -------
    (N, 8) float32
        Lanes of `structs.NODE`. Siblings are neighbours and lie behind their parent; the order is not depth-first.
    """
    nodes = np.ascontiguousarray(bvh.nodes).view(np.float32).reshape(-1, NODE_LANES)
    counts = bvh.nodes["count"]
    leaf_counts = -(-counts[counts > leaf_size].astype(np.int64) // leaf_size)
    if len(leaf_counts) == 0:
        return nodes
    grown = np.empty((len(nodes) + int((2 * (leaf_counts - 1)).sum()), NODE_LANES), np.float32)
    grown[: len(nodes)] = nodes
    _split_leaves(grown, grown.view(np.int32), len(nodes), leaf_size, bvh.prim_ids, *find_corners(bvh.shape))
    return grown


@compiled
def _split_leaves(nodes, node_ints, node_count, leaf_size, prim_ids, points, ids):
    node = 0
    while node < node_count:
        count = node_ints[node, NODE_COUNT]
        if count > leaf_size:
            # The left child gets whole blocks. Both children are split further when the loop reaches them.
            first = node_ints[node, NODE_FIRST]
            left_count = (count // leaf_size + (count % leaf_size > 0) + 1) // 2 * leaf_size
            right_first, right_count = first + left_count, count - left_count
            _write_leaf(nodes, node_ints, node_count, first, left_count, prim_ids, points, ids)
            _write_leaf(nodes, node_ints, node_count + 1, right_first, right_count, prim_ids, points, ids)
            node_ints[node, NODE_FIRST] = node_count
            node_ints[node, NODE_COUNT] = 0
            node_count += 2
        node += 1


@compiled
def _write_leaf(nodes, node_ints, node, first, count, prim_ids, points, ids):
    node_ints[node, NODE_FIRST] = first
    node_ints[node, NODE_COUNT] = count
    for axis in range(3):
        least, most = np.inf, -np.inf
        for index in range(first, first + count):
            for corner in range(3):
                coordinate = points[ids[prim_ids[index], corner], axis]
                least, most = min(least, coordinate), max(most, coordinate)
        nodes[node, axis], nodes[node, NODE_MAX + axis] = least, most
