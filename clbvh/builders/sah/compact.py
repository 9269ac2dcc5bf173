"""Finished subtrees move to their indices in the whole tree: depth-first order, see `depth_first`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...geometry.boxes import load_box, store_box
from ...structs import BOX_LANES, NODE_COUNT, NODE_FIRST
from ...support.compiled import compiled
from ..depth_first import index_of, place_top
from ..executor import Executor
from ..prim_refs import BOUNDS_BOX
from .ranges import Range
from .subtree import finish_node, slot_of


def compact(executor: Executor, root: Range) -> NDArray[np.float32]:
    """Return the nodes of the whole tree, (N, 8) float32, once all subtrees are built."""
    nodes = np.empty((place_top(root), BOX_LANES), np.float32)
    write_top(root, nodes)
    subtrees = list(root.leaves())
    shares = [subtrees[number :: executor.workers] for number in range(executor.workers)]
    executor.threads.run(place_subtrees, [(executor.arrays["prim_refs"], share, nodes) for share in shares])
    return nodes


def write_top(root: Range, nodes: NDArray[np.float32]) -> None:
    """Write the nodes of the top."""
    for node in root.walk():
        if node.children:
            index, first_child = node.placement
            nodes[index] = node.bounds[BOUNDS_BOX]
            finish_node(nodes, index, first_child, 0)


def place_subtrees(prim_refs: NDArray[np.float32], subtrees: Sequence[Range], nodes: NDArray[np.float32]) -> None:
    """Copy some subtrees to their indices."""
    for subtree in subtrees:
        place_finished(prim_refs, subtree.end, subtree.node_count, subtree.placement, nodes)


@compiled
def place_finished(prim_refs, range_end, node_count, placement, nodes):
    """Copy a subtree to its indices, and let its nodes name their children by these.

    Parameters
    ----------
    prim_refs : (2, n, 8) float32
        As `build_subtree` leaves them.
    range_end, node_count : int
        Where the subtree's range ends, and how many nodes it has.
    placement : Placement
    nodes : (N, 8) float32, rows of `structs.NODE`, written
    """
    node_ints = nodes.view(np.int32)
    last = node_count - 1
    for number in range(node_count):
        index = index_of(number, placement)
        # Nodes are finished in the reverse of depth-first order.
        buffer, slot = slot_of(range_end, last - number)
        store_box(nodes, index, load_box(prim_refs[buffer], slot))
        if node_ints[index, NODE_COUNT] == 0:
            node_ints[index, NODE_FIRST] = index_of(last - node_ints[index, NODE_FIRST], placement)
