"""The subtrees of the treelets become one tree in depth-first order, see `depth_first`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...structs import BOX_LANES, NODE_COUNT, NODE_FIRST
from ...support.compiled import compiled
from ...support.host_threads import cut_range
from ..depth_first import Placement, order_top, place_subtree
from ..executor import Executor


def join_treelets(
    executor: Executor,
    top: tuple[NDArray[np.float32], NDArray[np.int32]],
    treelets: NDArray[np.int64],
    node_counts: NDArray[np.int64],
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return the nodes of the whole tree, (N, 8) float32, and its prim_ids.

    Parameters
    ----------
    executor : Executor
        Its arrays are as `grow_treelets` leaves them.
    top : tuple of nodes and order
        The tree over the treelets, see `build_box_tree`.
    treelets : (k, 2) int64
        Begin and end of each treelet.
    node_counts : (k,) int64
        Nodes of each treelet's subtree.
    """
    top_nodes, order = top
    top_ints = top_nodes.view(np.int32)
    is_leaf, first = top_ints[:, NODE_COUNT] > 0, top_ints[:, NODE_FIRST]
    treelet_of_leaf = order[first[is_leaf]]
    below = np.zeros(len(top_nodes), np.int64)
    below[is_leaf] = node_counts[treelet_of_leaf]
    top_placements, node_count = order_top(np.where(is_leaf, 0, first).astype(np.int64), below)
    nodes = np.empty((node_count, BOX_LANES), np.float32)

    # The nodes above the treelets.
    indices = top_placements[~is_leaf, 0]
    nodes[indices] = top_nodes[~is_leaf]
    nodes.view(np.int32)[indices, NODE_FIRST] = top_placements[~is_leaf, 1]

    # The treelets. Leaves of the top come from left to right, and so do their primitives.
    placements = np.empty((len(treelets), 2), np.int64)
    placements[treelet_of_leaf] = top_placements[is_leaf]
    sizes = treelets[order, 1] - treelets[order, 0]
    first_prims = np.empty(len(treelets), np.int64)
    first_prims[order] = sizes.cumsum() - sizes
    prim_ids = np.empty(int(sizes.sum()), np.int32)
    slots, treelet_prims = executor.arrays["prim_refs"].reshape(-1, BOX_LANES), executor.arrays["prim_ids"]
    tasks = [
        (treelets[part], node_counts[part], placements[part], first_prims[part], slots, treelet_prims, nodes, prim_ids)
        for part in (slice(*cut) for cut in cut_range(0, len(treelets), executor.workers))
    ]
    executor.threads.run(place_treelets, tasks)
    return nodes, prim_ids


@compiled
def place_treelets(treelets, node_counts, placements, first_prims, slots, treelet_prims, nodes, prim_ids):
    """Copy finished subtrees to their indices, and their primitives.

    Parameters
    ----------
    treelets : (k, 2) int64
    node_counts : (k,) int64
    placements : (k, 2) int64
        See `Placement`.
    first_prims : (k,) int64
        Where in `prim_ids` each treelet's primitives begin.
    slots : (2F, 8) float32
    treelet_prims : (F,) int32
        As `grow_treelets` leaves them.
    nodes : (N, 8) float32, rows of `structs.NODE`, written
    prim_ids : (F,) int32, written
    """
    for index in range(len(treelets)):
        begin, end = treelets[index, 0], treelets[index, 1]
        prim_shift = first_prims[index] - begin
        placement = Placement(placements[index, 0], placements[index, 1])
        place_subtree(slots, 2 * begin, node_counts[index], prim_shift, placement, nodes)
        for slot in range(begin, end):
            prim_ids[slot + prim_shift] = treelet_prims[slot]
