"""Depth-first order: the indices of the nodes of a finished tree.

The root has index 0. Siblings stand side by side; then come all descendants of the left child, then all of the right
one. So the nodes of a subtree are one block, apart from its root, and no index is left out.

Builders make a tree in parts: a top, and below each leaf of the top a subtree whose nodes have numbers of their own,
0 for its root, 1 and 2 for the root's children, and so on in the same order. Once the size of every subtree is known,
`order_top` finds the indices of the top, and `index_of` turns a number within a subtree into an index.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from ..geometry.boxes import load_box, store_box
from ..structs import NODE_COUNT, NODE_FIRST
from ..support.compiled import compiled
from .options import MAX_DEPTH


class Placement(NamedTuple):
    """The place of a subtree in the finished tree.

    Attributes
    ----------
    root : int
        Index of its root.
    below : int
        Index of the first of the root's descendants: of its left child.
    """

    root: int
    below: int


# The place of a tree that is whole.
WHOLE_TREE = Placement(0, 1)


class TopNode(Protocol):
    """A node of the top, as `place_top` needs it."""

    @property
    def children(self) -> Sequence[TopNode]:
        """Its two children; none in a leaf of the top."""

    node_count: int  # nodes of the subtree below a leaf of the top, the leaf's own included
    placement: Placement


def place_top(root: TopNode) -> int:
    """Give every node of a top its placement, once all subtrees are built; return the node count of the whole tree."""
    # Breadth first, so that siblings stand side by side; the list grows while it is walked.
    nodes, first_children = [root], []
    for node in nodes:
        first_children.append(len(nodes) if node.children else 0)
        nodes += node.children
    node_counts = [node.node_count for node in nodes]
    placements, node_count = order_top(np.array(first_children), np.array(node_counts))
    for node, placement in zip(nodes, placements.tolist(), strict=True):
        node.placement = Placement(*placement)
    return int(node_count)


@compiled
def order_top(first_children, node_counts):
    """Find the indices of the nodes of a top.

    Parameters
    ----------
    first_children : (k,) int64
        For each node of the top the number of its left child, which the right one follows; 0 in a leaf of the top.
    node_counts : (k,) int64
        For a leaf of the top, how many nodes its subtree has.

    Returns
    -------
    placements : (k, 2) int64
        See `Placement`.
    node_count : int
        Nodes of the whole tree.
    """
    placements = np.empty((len(first_children), 2), np.int64)
    stack = np.empty(MAX_DEPTH + 1, np.int64)
    stack[0] = placements[0, 0] = 0
    stack_size, next_index = 1, 1
    while stack_size > 0:
        stack_size -= 1
        node = stack[stack_size]
        placements[node, 1] = next_index
        left = first_children[node]
        if left == 0:
            next_index += node_counts[node] - 1
            continue
        placements[left, 0], placements[left + 1, 0] = next_index, next_index + 1
        next_index += 2
        stack[stack_size], stack[stack_size + 1] = left + 1, left
        stack_size += 2
    return placements, next_index


@compiled
def index_of(number, placement):
    """Return the index of the node with this number in a subtree."""
    return placement.root if number == 0 else placement.below + number - 1


@compiled
def place_subtree(source, begin, node_count, prim_shift, placement, nodes):
    """Copy a subtree to its indices in the finished tree.

    Parameters
    ----------
    source : (k, 8) float32, rows of `structs.NODE`
        The subtree is ``source[begin : begin + node_count]`` in depth-first order. Its interior nodes name their
        children by rows of `source`.
    begin, node_count : int
    prim_shift : int
        Added to where a leaf's primitives begin.
    placement : Placement
    nodes : (N, 8) float32, rows of `structs.NODE`, written
    """
    node_ints = nodes.view(np.int32)
    child_shift = placement.below - (begin + 1)
    for number in range(node_count):
        index = index_of(number, placement)
        store_box(nodes, index, load_box(source, begin + number))
        node_ints[index, NODE_FIRST] += child_shift if node_ints[index, NODE_COUNT] == 0 else prim_shift
