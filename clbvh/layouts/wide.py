"""The layouts `bvh4` and `bvh8`: up to four or eight children per node, and leaves that fill a block of triangles.

Owns the nodes and the lists of the triangles in the blocks. `choose_children.py` decides which binary nodes stay;
`leaf_blocks.py` gathers the corners.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..bvh.bvh import Bvh
from ..structs import NO_PRIM, NODE_COUNT, NODE_FIRST, NODE_MAX, WIDE_NODES
from ..support.compiled import compiled
from .choose_children import BLOCK_COST, BLOCK_PRICE, choose_children, list_children
from .split_leaves import split_leaves


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
    choose_children(nodes, node_ints, width, BLOCK_COST, BLOCK_PRICE, splits)
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
