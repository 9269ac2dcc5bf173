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

from ..structs import BOX_LANES, BOX_NEGATED_MAX


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
    box : (8,) float32, a row of `structs.BOX`
        Known when it has children.
    """

    begin: int
    end: int
    depth: int
    children: tuple[Self, ...] = field(default=(), init=False)
    node_count: int = field(default=0, init=False)
    placement: Placement = field(default=WHOLE_TREE, init=False)
    box: NDArray[np.float32] = field(default_factory=lambda: np.empty(BOX_LANES, np.float32), init=False)

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


def write_top(root: TopNode, nodes: NDArray[np.void]) -> None:
    """Write the nodes of a placed top, (N,) `structs.NODE`."""
    for node in root.walk():
        if node.children:
            index, first_child = node.placement
            # Subtracted from 0 instead of negated, which could make -0.0.
            nodes[index] = node.box[:3], first_child, 0 - node.box[BOX_NEGATED_MAX : BOX_NEGATED_MAX + 3], 0
