"""The top of a rung's tree: one task per node, as the report's builder has it, and the rows that it ends in.

A range larger than the task threshold is divided by one worker, its two halves by two; what is left below are the
subtrees, one task each. The root is divided by one worker alone while all others wait: that is what the report
measured, and what `clbvh.build.top` does better.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...layout import NODE_COUNT, NODE_FIRST, NODE_MAX
from . import steps
from .crew import Crew
from .divide import Rule
from .prims import BOX


@dataclass
class TopNode:
    """A range of primitives, and either its two halves or a task's subtree.

    Attributes
    ----------
    begin, end, depth : int
    ids : (m,) int32 or None
        Its own list of primitives, where nodes have such.
    box : (6,) float32
        Known when it has children.
    children : tuple of TopNode
        None or two.
    block : int
        Its number, or that of its subtree's root, where a counter numbers nodes.
    row_count, row, first_row : int
        Number of nodes of its subtree, when it has no children here; the final rows of the node and of its first
        descendant.
    """

    begin: int
    end: int
    depth: int
    ids: NDArray[np.int32] | None
    box: NDArray[np.float32] = field(default_factory=lambda: np.empty(BOX, np.float32))
    children: tuple[TopNode, ...] = ()
    block: int = -1
    row_count: int = 0
    row: int = 0
    first_row: int = 1

    def __len__(self) -> int:
        return self.end - self.begin

    def walk(self) -> Iterator[TopNode]:
        """Yield this node and all below it, parents first."""
        waiting = [self]
        while waiting:
            node = waiting.pop()
            yield node
            waiting += reversed(node.children)


def divide_top(crew: Crew, root: TopNode, rule: Rule, threshold: int) -> None:
    """Divide the root, and all ranges below it, until none has more than `threshold` primitives."""
    level = [root]
    while level := [node for node in level if len(node) > max(threshold, rule.leaf_size)]:
        halves = crew.map(steps.divide_range, [(node.begin, node.end, node.depth, node.ids, rule) for node in level])
        for node, (box, middle, lists, block) in zip(level, halves, strict=True):
            node.box, node.block, node.ids = box, block, None
            node.children = (
                TopNode(node.begin, middle, node.depth + 1, lists[0]),
                TopNode(middle, node.end, node.depth + 1, lists[1]),
            )
        level = [child for node in level for child in node.children]


def assign_rows(root: TopNode) -> int:
    """Give every node its rows in the depth-first order of the whole tree; return how many rows there are."""
    next_row = 1
    for node in root.walk():
        node.first_row = next_row
        if node.children:
            node.children[0].row, node.children[1].row = next_row, next_row + 1
            next_row += 2
        else:
            next_row += node.row_count - 1
    return next_row


def write_top(root: TopNode, nodes: NDArray[np.float32]) -> None:
    """Write the nodes that have children here to their rows."""
    node_ints = nodes.view(np.int32)
    for node in root.walk():
        if node.children:
            nodes[node.row, :3] = node.box[:3]
            nodes[node.row, NODE_MAX : NODE_MAX + 3] = node.box[3:]
            node_ints[node.row, NODE_FIRST] = node.first_row
            node_ints[node.row, NODE_COUNT] = 0
