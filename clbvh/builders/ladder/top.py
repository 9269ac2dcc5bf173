"""The top of a variant's tree: one task per node, as the report's builder has it.

A range larger than the task threshold is divided by one worker, its two halves by two; the ranges at the bottom are
the subtrees, one task each. The root is divided by one worker alone while all others wait: that is what the report
measured, and `clbvh.builders.sah.top` does better.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...structs import NODE_COUNT, NODE_FIRST, NODE_MAX
from ..depth_first import WHOLE_TREE, Placement
from ..executor import Executor
from . import steps
from .divide import Rule, Task
from .prims import BOX


@dataclass
class TopNode:
    """A range of primitives, and either its two halves or a task's subtree.

    Attributes
    ----------
    begin, end, depth : int
    ids : (m,) int32 or None
        Its own list of primitives, in variants whose nodes have one.
    box : (6,) float32
        Known when it has children.
    children : tuple of TopNode
        Two, or none.
    block : int
        Its number, or that of its subtree's root, where a counter numbers nodes.
    node_count : int
        Nodes of its subtree, when that is built.
    placement : Placement
        Its place in the finished tree, when all subtrees are built.
    """

    begin: int
    end: int
    depth: int
    ids: NDArray[np.int32] | None
    box: NDArray[np.float32] = field(default_factory=lambda: np.empty(BOX, np.float32))
    children: tuple[TopNode, ...] = ()
    block: int = -1
    node_count: int = 0
    placement: Placement = WHOLE_TREE

    def __len__(self) -> int:
        return self.end - self.begin

    @property
    def task(self) -> Task:
        """Its range and its depth."""
        return Task(self.begin, self.end, self.depth)

    def walk(self) -> Iterator[TopNode]:
        """Yield this node and all below it, parents first, from left to right."""
        yield self
        for child in self.children:
            yield from child.walk()


def divide_top(executor: Executor, root: TopNode, rule: Rule, threshold: int) -> None:
    """Divide the root, and all ranges below it, until none has more than `threshold` primitives."""
    level = [root]
    while level := [node for node in level if len(node) > max(threshold, rule.leaf_size)]:
        halves = executor.map(steps.divide_range, [(node.task, node.ids, rule) for node in level])
        for node, (box, middle, lists, block) in zip(level, halves, strict=True):
            node.box, node.block, node.ids = box, block, None
            node.children = (
                TopNode(node.begin, middle, node.depth + 1, lists[0]),
                TopNode(middle, node.end, node.depth + 1, lists[1]),
            )
        level = [child for node in level for child in node.children]


def write_top(root: TopNode, nodes: NDArray[np.float32]) -> None:
    """Write the nodes of the top, (N, 8) float32."""
    node_ints = nodes.view(np.int32)
    for node in root.walk():
        if node.children:
            index, first_child = node.placement
            nodes[index, :3] = node.box[:3]
            nodes[index, NODE_MAX : NODE_MAX + 3] = node.box[3:]
            node_ints[index, NODE_FIRST] = first_child
            node_ints[index, NODE_COUNT] = 0
