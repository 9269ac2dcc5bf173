"""The quality `high`: the default tree, rearranged until rays find less to test.

Owns the order of the steps and the division of the tree among threads. The tree is the same, byte for byte, for any
number of workers: the subtrees that threads rearrange follow from the tree, and each is the work of one thread.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh, sah_cost
from ...geometry.corners import Bounded, find_corners
from ...structs import BOX_LANES, EXPANDED_FIRST, NODE
from ...support.stopwatch import Stopwatch
from ..executor import Executor
from ..options import DEFAULT_QUALITY, MAX_DEPTH, BuildOptions
from ..prim_refs import fill_slice
from ..sah.build_sah import build_sah
from .expanded_tree import ROOT, ExpandedTree, choose_leaves, collapse, count_prims, expand_leaves, list_descendants
from .reinsert import reinsert_below

# More bins than the default give a better start on scans, and sometimes a worse one elsewhere: both trees are built,
# and the one of the lower cost is rearranged. docs/internals/decisions.md has the shares.
_FINER_BINS = 64

# A node stays within the same eighth of the triangles. With the whole tree to choose from, the SAH cost falls by
# another percent, but rays test no less: docs/internals/decisions.md. And eighths are work for eight threads.
_PARTS = 8
_SMALLEST_PART = 4096  # a few milliseconds: nothing to share

# The first pass saves about three quarters of the total; four passes more than these save less than 0.2 %, on scans
# and in buildings.
_PASSES = 4


def build_high(shape: Bounded, executor: Executor, options: BuildOptions) -> Bvh:
    """Build the default tree and optimise it; see `clbvh.build` for the parameters.

    Returns
    -------
    Bvh
        Never of a higher SAH cost than the default tree, at the traversal cost of the options.

    Notes
    -----
    Rearranges in threads of this process, as many as there are workers. Besides the shape and two trees it takes about
    110 bytes per primitive.
    """
    start = _build_start(shape, executor, options)
    watch = Stopwatch()
    tree = _expand(start)
    watch.lap("expand_leaves")

    order = np.empty(2 * shape.prim_count, np.int32)
    parts = _choose_parts(tree.links, _list_nodes(tree.links, order))
    executor.threads.run(_rearrange, [(tree, *part) for part in parts])
    watch.lap("reinsert")

    better = _collapse(tree, _list_nodes(tree.links, order), shape, options)
    cheapest = start if better is None else _cheapest((start, better), options)
    watch.lap("collapse")
    return replace(cheapest, timings_ms={**start.timings_ms, **watch.laps_ms})


def _build_start(shape: Bounded, executor: Executor, options: BuildOptions) -> Bvh:
    """Return the cheaper one of two finished trees."""
    plain = replace(options, quality=DEFAULT_QUALITY)
    start = build_sah(shape, executor, plain)
    if options.bins is not None:
        return start
    watch = Stopwatch()
    finer = build_sah(shape, executor, replace(plain, bins=_FINER_BINS))
    cheapest = _cheapest((start, finer), options)
    watch.lap("finer bins")
    return replace(cheapest, timings_ms={**start.timings_ms, **watch.laps_ms})


def _cheapest(trees: Iterable[Bvh], options: BuildOptions) -> Bvh:
    """Return the tree of the lowest SAH cost, the first one of equals."""
    return min(trees, key=lambda tree: sah_cost(tree, traversal_cost=options.traversal_cost))


def _expand(bvh: Bvh) -> ExpandedTree:
    """Return the tree with every primitive as a leaf of its own."""
    count = bvh.shape.prim_count
    prim_refs = np.empty((count, BOX_LANES), np.float32)
    fill_slice(find_corners(bvh.shape), 0, count, prim_refs)
    nodes = np.ascontiguousarray(bvh.nodes).view(np.float32).reshape(-1, BOX_LANES)
    boxes = np.zeros((2 * count, BOX_LANES), np.float32)
    tree = ExpandedTree(boxes, boxes.view(np.int32), np.zeros(count, np.int32))
    expand_leaves(nodes, nodes.view(np.int32), bvh.prim_ids, prim_refs, tree)
    return tree


def _collapse(tree: ExpandedTree, order: NDArray[np.int32], shape: Bounded, options: BuildOptions) -> Bvh | None:
    """Return the finished tree, None if it would be too deep."""
    is_leaf = np.empty(len(tree.boxes), np.bool_)
    if choose_leaves(tree, options.leaf_size, options.traversal_cost, order, is_leaf) > MAX_DEPTH:
        return None
    nodes = np.empty_like(tree.boxes)
    prim_ids = np.empty(shape.prim_count, np.int32)
    node_count = collapse(tree, is_leaf, nodes, nodes.view(np.int32), prim_ids)
    return Bvh(nodes[:node_count].copy().view(NODE).reshape(-1), prim_ids, shape)


def _list_nodes(links: NDArray[np.int32], order: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return all nodes, parents first, in the memory of `order`."""
    order[0] = ROOT
    return order[: 1 + list_descendants(links, ROOT, order[1:])]


def _choose_parts(links: NDArray[np.int32], order: NDArray[np.int32]) -> list[tuple[int, int]]:
    """Return disjoint subtrees, each the work of one thread: their roots and primitive counts, the largest first."""
    prim_counts = count_prims(links, order)
    most_prims = max(prim_counts[ROOT] // _PARTS, _SMALLEST_PART)
    parts = []
    stack = [ROOT]
    while stack:
        node = stack.pop()
        if prim_counts[node] <= most_prims:
            parts.append((node, int(prim_counts[node])))
        else:
            child = int(links[node, EXPANDED_FIRST])
            stack += [child + 1, child]
    return sorted(parts, key=lambda part: -part[1])


def _rearrange(tree: ExpandedTree, top: int, prim_count: int) -> None:
    """Reinsert the nodes of one subtree, pass by pass, until none moves."""
    order = np.empty(2 * prim_count, np.int32)
    for _ in range(_PASSES):
        if reinsert_below(tree, top, order[: list_descendants(tree.links, top, order)]) == 0:
            return
