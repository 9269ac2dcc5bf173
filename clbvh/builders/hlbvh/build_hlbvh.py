"""The build of `quality="fast"`: triangles in Morton order, so that most of the tree needs no choice.

After Lauterbach et al., "Fast BVH construction on GPUs" (2009), and Pantaleoni and Luebke, "HLBVH: hierarchical LBVH
construction for real-time ray tracing of dynamic geometry" (2010).

Owns the order of the steps, and the arrays that they share, for n primitives:

    prim_refs  (2, n, 8) float32   as (2n, 8): the primitive references of each treelet, then its nodes
    prim_ids   (n,) int32          primitives in the order of each treelet's leaves
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...geometry.corners import Bounded, Corners, find_corners
from ...structs import BOX_LANES, NODE, NODE_COUNT, NODE_FIRST
from ...support.compiled import compiled
from ...support.host_threads import cut_range
from ...support.stopwatch import Stopwatch
from ..executor import Arrays, Executor
from ..invariants import Placement, order_top, place_subtree
from ..options import MAX_DEPTH, BuildOptions
from ..prim_refs import BOUNDS_CENTROIDS, PrimSlice
from ..sah.subtree import Rule, make_rule
from .grow import TREELET_DEPTH, build_box_tree, grow_treelets
from .treelets import bound_points, count_cells, cut_treelets, fill_treelets, make_grid

# The grid that treelets are made of, and its number of cells.
_AXIS_BITS = 5
_CELL_COUNT = 1 << 3 * _AXIS_BITS

# Most primitives in a treelet that is more than one cell.
_TREELET_SIZE = 1024

# Tasks per worker: enough to even out unequal subtrees.
_TASKS_PER_WORKER = 8


def build_hlbvh(shape: Bounded, executor: Executor, options: BuildOptions) -> Bvh:
    """Build in as few milliseconds as possible; see `clbvh.build` for the options.

    Returns
    -------
    Bvh
        Its phases: "treelets", "subtrees", "compact".

    Notes
    -----
    O(n log n) in the number of primitives. Besides the shape and the result it needs 70 bytes per primitive.
    """
    watch = Stopwatch()
    rule = make_rule(options)
    executor.create("prim_refs", (2, shape.prim_count, BOX_LANES), np.float32)
    executor.create("prim_ids", (shape.prim_count,), np.int32)

    # One primitive reference per primitive, those of neighbours in one treelet.
    treelets = _fill_treelets(find_corners(shape), executor)
    watch.lap("treelets")

    # Each treelet becomes a subtree.
    boxes, node_counts = _grow_subtrees(executor, treelets, rule, options.task_threshold)
    watch.lap("subtrees")

    # The tree over the treelets, and all of it in depth-first order.
    top = build_box_tree(boxes, len(boxes), MAX_DEPTH - TREELET_DEPTH, rule.bins)
    nodes, prim_ids = join_treelets(executor, top, treelets, node_counts)
    watch.lap("compact")
    return Bvh(nodes.view(NODE).reshape(-1), prim_ids, shape, watch.laps_ms)


def _fill_treelets(corners: Corners, executor: Executor) -> NDArray[np.int64]:
    """Write all primitive references into their treelets; return begin and end of each, (k, 2)."""
    run, workers, count = executor.threads.run, executor.workers, len(corners.ids)
    slices = [PrimSlice(*corners, *cut) for cut in cut_range(0, count, workers)]
    grid = _make_shape_grid(corners.points, executor)

    # Primitives in each cell, for each slice.
    cells = np.empty(count, np.uint16)
    counts = np.zeros((workers, _CELL_COUNT), np.int32)
    run(count_cells, [(part, grid, cells, counts[number]) for number, part in enumerate(slices)])
    treelet_of_cell = np.zeros(_CELL_COUNT, np.int32)
    first_cells = np.empty(_CELL_COUNT, np.int64)
    treelet_count = cut_treelets(counts.sum(axis=0), _TREELET_SIZE, treelet_of_cell, first_cells)

    # The slots of a treelet's references follow from how many of them each slice has.
    slice_counts = np.add.reduceat(counts, first_cells[:treelet_count], axis=1, dtype=np.int64)
    ends = slice_counts.sum(axis=0).cumsum()
    begins = ends - slice_counts.sum(axis=0)
    next_slots = 2 * begins + slice_counts.cumsum(axis=0) - slice_counts
    slots = executor.arrays["prim_refs"].reshape(-1, BOX_LANES)
    tasks = [(part, cells, treelet_of_cell, next_slots[number], slots) for number, part in enumerate(slices)]
    run(fill_treelets, tasks)
    return np.stack([begins, ends], axis=1)


def _make_shape_grid(points: NDArray[np.float32], executor: Executor) -> NDArray[np.float32]:
    """Return the grid over the centroids of all primitives, given their corners; see `make_grid`."""
    parts = cut_range(0, len(points), executor.workers)
    bounds = np.empty((executor.workers, 2, BOX_LANES), np.float32)
    executor.threads.run(bound_points, [(points, *cut, bounds[part]) for part, cut in enumerate(parts)])
    whole = np.minimum.reduce(bounds)
    grid: NDArray[np.float32] = make_grid(whole, BOUNDS_CENTROIDS, _AXIS_BITS)
    return grid


def _grow_subtrees(
    executor: Executor, treelets: NDArray[np.int64], rule: Rule, task_threshold: int | None
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Build the subtrees of all treelets; return their boxes, (k, 8), and numbers of nodes, (k,)."""
    # Neighbours travel together, until a task has its size.
    size = task_threshold or max(1, int(treelets[-1, 1]) // (executor.workers * _TASKS_PER_WORKER))
    cuts = np.flatnonzero(np.diff(treelets[:, 0] // size)) + 1
    parts = np.split(treelets, cuts)
    # The largest first.
    order = sorted(range(len(parts)), key=lambda part: int(parts[part][0, 0] - parts[part][-1, 1]))
    results = executor.map(grow_subtrees, [(parts[part], rule) for part in order])
    grown = [result for _, result in sorted(zip(order, results, strict=True), key=lambda pair: pair[0])]
    return np.concatenate([boxes for boxes, _ in grown]), np.concatenate([counts for _, counts in grown])


def grow_subtrees(
    arrays: Arrays, treelets: NDArray[np.int64], rule: Rule
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Build the subtrees of some treelets, (k, 2); return their boxes, (k, 8), and how many nodes each has."""
    boxes, node_counts = np.empty((len(treelets), BOX_LANES), np.float32), np.empty(len(treelets), np.int64)
    slots = arrays["prim_refs"].reshape(-1, BOX_LANES)
    grow_treelets(slots, treelets, rule, arrays["prim_ids"], boxes, node_counts)
    return boxes, node_counts


def join_treelets(
    executor: Executor,
    top: tuple[NDArray[np.float32], NDArray[np.int32]],
    treelets: NDArray[np.int64],
    node_counts: NDArray[np.int64],
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return the nodes of the whole tree, (N, 8) float32, and its prim_ids.

    The arguments are those of `build_box_tree`, `_fill_treelets` and `_grow_subtrees`.
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
