"""Steps by which every builder keeps its promises: the depth limit, ascending leaves, depth-first order.

**Depth.** A split into halves by position needs ``ceil(log2(n))`` levels for n primitives, whatever their boxes. As
soon as that many levels are all that is left, a builder takes no other split.

**Depth-first order.** The root has index 0. Siblings stand side by side; then come all descendants of the left child,
then all of the right one. So the nodes of a subtree are one block, apart from its root, and no index is left out.
Builders make a tree in parts: a top, and below each leaf of the top a subtree whose nodes have numbers of their own, 0
for its root, 1 and 2 for the root's children, and so on in the same order. Once the size of every subtree is known,
`order_top` finds the indices of the top, and `index_of` turns a number within a subtree into an index.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np

from ..geometry.boxes import load_box, store_box
from ..structs import NODE_COUNT, NODE_FIRST
from ..support.compiled import compiled
from .options import MAX_DEPTH


@compiled
def needs_halving(prim_count, depth):
    """Say whether only splits by halves still keep `prim_count` primitives, at `depth`, above `MAX_DEPTH`."""
    levels = 0
    while (1 << levels) < prim_count:
        levels += 1
    return levels >= MAX_DEPTH - depth


@compiled
def middle_of(begin, end):
    """Return where the right half of a range begins."""
    return begin + (end - begin) // 2


@compiled
def insert_prim(prim_ids, begin, end, prim):
    """Insert a primitive into the ascending list `prim_ids[begin:end]`, which then ends one later.

    One step of an insertion sort: O(1) when primitives arrive in ascending order, and no memory besides the list.

    Parameters
    ----------
    prim_ids : (n,) int32, changed in place
        `prim_ids[end]` is overwritten.
    begin, end : int
    prim : int
    """
    slot = end
    while slot > begin and prim_ids[slot - 1] > prim:
        prim_ids[slot] = prim_ids[slot - 1]
        slot -= 1
    prim_ids[slot] = prim


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


@dataclass
class TopNode:
    """A range of primitives at the top of a tree, and either its two halves or a worker's subtree.

    Attributes
    ----------
    begin, end, depth : int
    children : tuple of TopNode
        Two, or none.
    node_count : int
        Nodes of its subtree, when that is built.
    placement : Placement
        Its place in the finished tree, when all subtrees are built.
    """

    begin: int
    end: int
    depth: int
    children: tuple[Self, ...] = field(default=(), init=False)
    node_count: int = field(default=0, init=False)
    placement: Placement = field(default=WHOLE_TREE, init=False)

    def __len__(self) -> int:
        return self.end - self.begin

    def walk(self) -> Iterator[Self]:
        """Yield this node and all below it, parents first, from left to right."""
        yield self
        for child in self.children:
            yield from child.walk()

    def leaves(self) -> Iterator[Self]:
        """Yield the ranges without children, from left to right."""
        return (node for node in self.walk() if not node.children)


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
