"""Steps by which every builder keeps its promises: the depth limit, ascending leaves, depth-first order.

**Depth.** A split into halves by position needs ``ceil(log2(n))`` levels for n primitives, whatever their boxes. As
soon as that many levels are all that is left, a builder takes no other split.

**Depth-first order.** The root has index 0. Siblings stand side by side; then come all descendants of the left child,
then all of the right one. So the nodes of a subtree are one block, apart from its root, and no index is left out.
Builders make a tree in parts: a top, and below each leaf of the top a subtree whose nodes have numbers of their own, 0
for its root, 1 and 2 for the root's children, and so on in the same order. Once the size of every subtree is known,
`place_top` finds the indices of the top, and those within a subtree follow from where it is placed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ..structs import NODE_COUNT, NODE_FIRST


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
    root.placement, next_index = WHOLE_TREE, 1
    stack = [root]
    while stack:
        node = stack.pop()
        node.placement = node.placement._replace(below=next_index)
        for number, child in enumerate(node.children):
            child.placement = Placement(next_index + number, 0)
        next_index += len(node.children) or node.node_count - 1
        stack += node.children[::-1]
    return next_index


def place_subtree(
    source: NDArray[np.float32],
    begin: int,
    node_count: int,
    prim_shift: int,
    placement: Placement,
    nodes: NDArray[np.float32],
) -> None:
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
    child_shift = placement.below - (begin + 1)
    for first, end, index in ((begin, begin + 1, placement.root), (begin + 1, begin + node_count, placement.below)):
        placed = nodes[index : index + end - first]
        placed[:] = source[first:end]
        lanes = placed.view(np.int32)
        lanes[:, NODE_FIRST] += np.where(lanes[:, NODE_COUNT] == 0, np.int32(child_shift), np.int32(prim_shift))
