"""The default builder: binned surface area heuristic, parallel from the root.

Owns the order of the steps, and the arrays that they share, for n primitives:

    prim_refs  (2, n, 8) float32   two buffers of primitive references; in the end they hold the nodes
    prim_ids   (n,) int32          result

The tree is the same, byte for byte, for any number of workers and any task threshold.
"""

from __future__ import annotations

import numpy as np

from ...bvh import Bvh
from ...geometry.corners import Corners
from ...geometry.spheres import Bounded
from ...structs import BOX_LANES, MAX_EXHAUSTIVE
from ...support.host_threads import cut_range
from ...support.stopwatch import Stopwatch
from ..executor import Executor
from ..options import BuildOptions
from ..prim_refs import Bounds, fill_slice
from .subtree import DEFAULT_BINS, Rule, build_one, compact, make_rule
from .top import Range, split_top

# Ranges per worker, when the task threshold is chosen here: enough to even out unequal subtrees. Each doubling costs
# the threads one more level of the top.
_RANGES_PER_WORKER = 16
_SMALLEST_RANGE = 10_000


def build_sah(shape: Bounded, executor: Executor, options: BuildOptions) -> Bvh:
    """Build with the surface area heuristic; see `clbvh.build` for the options.

    Returns
    -------
    Bvh
        Its phases: "metadata", "top", "subtrees", "compact".

    Notes
    -----
    O(n log n) in the number of primitives. Besides the shape and the result it needs 64 bytes per primitive.
    """
    watch = Stopwatch()
    count = shape.prim_count
    executor.create("prim_refs", (2, count, BOX_LANES), np.float32)
    prim_ids = executor.create("prim_ids", (count,), np.int32)

    # One primitive reference per primitive.
    root = Range(0, count, 0, 0, _fill_prim_refs(shape.find_corners(), executor))
    watch.lap("metadata")

    # All threads together, until there are enough subtrees for all workers.
    split_top(executor, root, _choose_threshold(executor, count, options), options.bins or DEFAULT_BINS)
    watch.lap("top")

    # Each worker on its own.
    _build_subtrees(executor, root, make_rule(options))
    watch.lap("subtrees")

    # Into depth-first order, without gaps.
    nodes = compact(executor, root)
    watch.lap("compact")
    return Bvh(nodes, prim_ids, shape, watch.laps_ms)


def _fill_prim_refs(corners: Corners, executor: Executor) -> Bounds:
    """Write all primitive references into the first buffer; return their bounds."""
    refs = executor.arrays["prim_refs"][0]
    slices = cut_range(0, len(corners.ids), executor.workers)
    bounds: Bounds = np.minimum.reduce(executor.threads.run(fill_slice, [(corners, *part, refs) for part in slices]))
    return bounds


def _choose_threshold(executor: Executor, count: int, options: BuildOptions) -> int:
    """Return the largest number of primitives of a range that is one worker's task."""
    threshold = options.task_threshold
    if threshold is None:
        fair_share = count // (executor.workers * _RANGES_PER_WORKER)
        threshold = count if executor.workers == 1 else max(fair_share, _SMALLEST_RANGE)
    # Of fewer primitives every division is tried: no work for all threads.
    return max(threshold, options.leaf_size, MAX_EXHAUSTIVE)


def _build_subtrees(executor: Executor, root: Range, rule: Rule) -> None:
    """Build the subtree of every range at the bottom of the top, largest first, and note its number of nodes."""
    ranges = sorted(root.leaves(), key=len, reverse=True)
    tasks = [(node.begin, node.end, node.buffer, node.depth, node.bounds, rule) for node in ranges]
    for node, node_count in zip(ranges, executor.map(build_one, tasks), strict=True):
        node.node_count = node_count
