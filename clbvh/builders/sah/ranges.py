"""Ranges of records: the nodes of the top of the tree, and the slices that workers share."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

# (2, 8) float32: rows of `simd`.
Boxes = NDArray[np.float32]


@dataclass
class Range:
    """A node of the top: a range of records, and either its two halves or a worker's subtree.

    Attributes
    ----------
    begin, end, buffer, depth : int
        The range, which of the two buffers holds it, and its depth.
    bounds : (2, 8) float32
        Row 0: its box. Row 1: the box of its centroids.
    children : pair of Range, or None
    node_count : int
        Nodes of its subtree, when that is built.
    """

    begin: int
    end: int
    buffer: int
    depth: int
    bounds: Boxes
    children: tuple[Range, Range] | None = None
    node_count: int = 0

    def __len__(self) -> int:
        return self.end - self.begin

    def leaves(self) -> Iterator[Range]:
        """Yield the ranges without children, from left to right."""
        if self.children is None:
            yield self
        else:
            for child in self.children:
                yield from child.leaves()


def cut_slices(begin: int, end: int, count: int) -> list[tuple[int, int]]:
    """Cut a range into `count` slices of nearly equal size; some are empty when it is short."""
    size = end - begin
    cuts = [begin + size * number // count for number in range(count + 1)]
    return list(pairwise(cuts))
