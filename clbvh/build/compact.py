"""Finished subtrees move to their final rows: depth-first order, without gaps.

In it, siblings lie side by side, then come the left child's descendants, then the right one's. So a subtree is one
block of rows, apart from its root.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..layout import NODE_COUNT, NODE_FIRST
from ..simd import load_row, store_row
from .ranges import Range
from .subtree import finish_node, node_place


@dataclass(frozen=True)
class Placement:
    """Where a finished subtree goes.

    Attributes
    ----------
    end, node_count : int
        End of its range, and how many nodes it has: `subtree.node_place` tells where they are.
    root_row, first_row : int
        The final row of its root, and of the first of its descendants.
    """

    end: int
    node_count: int
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
            plan.subtrees.append(Placement(node.end, node.node_count, row, plan.row_count))
            plan.row_count += node.node_count - 1
        else:
            left, right = node.children
            plan.interior.append((row, plan.row_count, node))
            waiting += [(right, plan.row_count + 1), (left, plan.row_count)]
            plan.row_count += 2
    return plan


def write_top(plan: Plan, nodes: NDArray[np.float32]) -> None:
    """Write the nodes of the top into the final rows, (N, 8) float32."""
    for row, first_child, node in plan.interior:
        nodes[row] = node.bounds[0]
        finish_node(nodes, row, first_child, 0)


@njit(cache=True, nogil=True)
def place_subtree(records, end, node_count, nodes, node_ints, root_row, first_row):  # type: ignore[no-untyped-def]
    """Copy a subtree to its final rows, and let its nodes name their children by these.

    Parameters
    ----------
    records : (2, n, 8) float32
        Where `subtree.build_subtree` left the nodes of a range that ends at `end`.
    end, node_count, root_row, first_row : int
        See `Placement`.
    nodes, node_ints : (N, 8) float32 and int32, the same memory, written
    """
    for index in range(node_count):
        row = root_row if index == 0 else first_row + index - 1
        buffer, source = node_place(end, node_count - 1 - index)
        store_row(nodes, row, load_row(records[buffer], source))
        if node_ints[row, NODE_COUNT] == 0:
            left_index = node_count - 1 - node_ints[row, NODE_FIRST]
            node_ints[row, NODE_FIRST] = first_row + left_index - 1


def place_subtrees(records: NDArray[np.float32], placements: Sequence[Placement], nodes: NDArray[np.float32]) -> None:
    """Do so for several subtrees."""
    node_ints = nodes.view(np.int32)
    for place in placements:
        place_subtree(records, place.end, place.node_count, nodes, node_ints, place.root_row, place.first_row)
