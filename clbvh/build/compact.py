"""Finished subtrees move to their final rows: depth-first order, without gaps.

The final tree has the rows that `subtree.build_subtree` would have used for the whole mesh: siblings side by side,
then the left child's descendants, then the right one's. So a subtree is one block of rows, apart from its root.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..layout import NODE_COUNT, NODE_FIRST, NODE_LANES
from .ranges import Range
from .subtree import write_box


@dataclass(frozen=True)
class Placement:
    """Where a finished subtree goes.

    Attributes
    ----------
    source, row_count : int
        Its rows in the scratch nodes; the first one is its root.
    root_row, first_row : int
        The final row of its root, and of the first of its descendants.
    """

    source: int
    row_count: int
    root_row: int
    first_row: int


@dataclass
class Plan:
    """The final rows of a whole tree.

    Attributes
    ----------
    interior : list of (row, first child's row, range)
        The nodes of the top.
    subtrees : list of Placement
    row_count : int
        Rows of the final tree.
    """

    interior: list[tuple[int, int, Range]] = field(default_factory=list)
    subtrees: list[Placement] = field(default_factory=list)
    row_count: int = 1


def plan_rows(root: Range) -> Plan:
    """Give every node a row, once all subtrees are built."""
    plan = Plan()
    waiting = [(root, 0)]
    while waiting:
        node, row = waiting.pop()
        if node.children is None:
            plan.subtrees.append(Placement(2 * node.begin, node.row_count, row, plan.row_count))
            plan.row_count += node.row_count - 1
        else:
            left, right = node.children
            plan.interior.append((row, plan.row_count, node))
            waiting += [(right, plan.row_count + 1), (left, plan.row_count)]
            plan.row_count += 2
    return plan


def write_top(plan: Plan, nodes: NDArray[np.float32]) -> None:
    """Write the nodes of the top into the final rows, (N, 8) float32."""
    node_ints = nodes.view(np.int32)
    for row, first_child, node in plan.interior:
        write_box(nodes, row, node.bounds, 0)
        node_ints[row, NODE_FIRST] = first_child
        node_ints[row, NODE_COUNT] = 0


@njit(cache=True, nogil=True)
def place_rows(scratch, source, row_count, nodes, root_row, first_row):  # type: ignore[no-untyped-def]
    """Copy a subtree from the scratch rows to its final ones, and point its nodes at each other again.

    Parameters
    ----------
    scratch : (2n, 8) int32
        Rows of `layout.NODE`.
    source, row_count, root_row, first_row : int
        See `Placement`.
    nodes : (N, 8) int32, written
    """
    shift = np.int32(first_row - (source + 1))
    for index in range(row_count):
        row = root_row if index == 0 else first_row + index - 1
        for lane in range(NODE_LANES):
            nodes[row, lane] = scratch[source + index, lane]
        if nodes[row, NODE_COUNT] == 0:
            nodes[row, NODE_FIRST] += shift
