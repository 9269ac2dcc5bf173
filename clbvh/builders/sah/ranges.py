"""Ranges of primitive references: the nodes of the top of the tree."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ..depth_first import WHOLE_TREE, Placement
from ..prim_refs import Bounds


@dataclass
class Range:
    """A node of the top: a range of primitive references, and either its two halves or a worker's subtree.

    Attributes
    ----------
    begin, end, buffer, depth : int
        The range, which of the two buffers holds it, and its depth.
    bounds : (2, 8) float32
    children : tuple of Range
        Two, or none.
    node_count : int
        Nodes of its subtree, when that is built.
    placement : Placement
        Its place in the finished tree, when all subtrees are built.
    """

    begin: int
    end: int
    buffer: int
    depth: int
    bounds: Bounds
    children: tuple[Range, ...] = ()
    node_count: int = 0
    placement: Placement = WHOLE_TREE

    def __len__(self) -> int:
        return self.end - self.begin

    def walk(self) -> Iterator[Range]:
        """Yield this range and all below it, parents first, from left to right."""
        yield self
        for child in self.children:
            yield from child.walk()

    def leaves(self) -> Iterator[Range]:
        """Yield the ranges without children, from left to right."""
        return (node for node in self.walk() if not node.children)
