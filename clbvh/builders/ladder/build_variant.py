"""A mesh becomes a tree by one variant of the ladder.

Owns the order of the phases, and the top of the tree: a range larger than the task threshold is divided by one worker,
its two halves by two; the ranges at the bottom are the subtrees, one task each. The root is divided by one worker alone
while all others wait: that is what the report measured, and `clbvh.builders.sah.top` does better.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...errors import PoolError
from ...geometry.spheres import Bounded
from ...structs import BOX_LANES, NODE, NODE_LANES
from ...support.host_threads import cut_range
from ...support.stopwatch import Stopwatch
from ..executor import Executor
from ..invariants import TopNode, place_top, write_top
from ..options import BuildOptions
from . import steps
from .steps import COUNTER_WORDS, LINKED_NODE, Rule, Task
from .variants import Nodes, Variant


@dataclass
class Range(TopNode):
    """A range of primitives.

    Attributes
    ----------
    ids : (m,) int32 or None
        Its own list of primitives, in variants whose nodes have one.
    reference : int
        To it, or to its subtree's root, where a counter hands out nodes.
    """

    ids: NDArray[np.int32] | None
    reference: int = -1

    @property
    def task(self) -> Task:
        """Its range and its depth."""
        return Task(self.begin, self.end, self.depth)


def divide_top(executor: Executor, root: Range, rule: Rule, threshold: int) -> None:
    """Divide the root, and all ranges below it, until none has more than `threshold` primitives."""
    level = [root]
    while level := [node for node in level if len(node) > max(threshold, rule.leaf_size)]:
        halves = executor.map(steps.divide_range, [(node.task, node.ids, rule) for node in level])
        for node, (box, middle, lists, reference) in zip(level, halves, strict=True):
            node.box, node.reference, node.ids = box, reference, None
            node.children = (
                Range(node.begin, middle, node.depth + 1, lists[0]),
                Range(middle, node.end, node.depth + 1, lists[1]),
            )
        level = [child for node in level for child in node.children]


# The report's number of bins.
DEFAULT_BINS = 8

# Tasks per worker, when the task threshold is chosen here: enough to even out unequal subtrees.
_TASKS_PER_WORKER = 8


def build_variant(variant: Variant, shape: Bounded, executor: Executor, options: BuildOptions) -> Bvh:
    """Build a tree by one variant of the ladder.

    Parameters
    ----------
    variant : Variant
    shape : Mesh, Spheres or Boxes
    executor : Executor
        The workers of a pool, as in the report, or threads; one thread for a variant that is not parallel.
    options : BuildOptions
        Of these `bins`, `leaf_size`, `task_threshold` and `frontier` are heeded, where the variant has them.

    Returns
    -------
    Bvh
        The same bytes for any executor and any threshold. No leaf lies deeper than 64. Its phases: "share" (the
        corners for the workers), "metadata", "top" (tasks that divide one range each), "subtrees", and "flatten" or
        "convert" (linked nodes are flattened) or "compact" (nodes move to their indices in the tree).

    Raises
    ------
    PoolError
        A worker failed or died, or there is not enough memory to share.

    Notes
    -----
    O(n log n) in the number of primitives, from `median` on; O(n log² n) for the variants that sort.
    """
    watch = Stopwatch()
    count = shape.prim_count
    rule = Rule(variant.how, options.bins or DEFAULT_BINS, variant.leaf_size(options), variant.copies)
    for name, array in zip(("vertices", "faces"), shape.find_corners(), strict=True):
        executor.share(name, array)
    prim_ids = executor.create("prim_ids", (count,), np.int32)
    prim_ids[:] = np.arange(count)
    watch.lap("share")

    # Boxes and centroids, once.
    if variant.cached:
        executor.create("boxes", (count, BOX_LANES), np.float32)
        executor.create("centroids", (count, 3), np.float32)
        executor.map(steps.cache_slice, cut_range(0, count, executor.workers))
        executor.discard("vertices", "faces")
        watch.lap("metadata")

    # The top, one task per node.
    if variant.nodes is Nodes.COUNTER:
        executor.create("blocks", (2 * count,), LINKED_NODE)
        executor.create("counter", (COUNTER_WORDS,), np.int64)[:] = 0
    root = Range(0, count, 0, np.arange(count, dtype=np.int32) if variant.copies else None)
    divide_top(executor, root, rule, _choose_threshold(variant, executor, count, options))
    watch.lap("top")

    # The subtrees, one task each, and the flat tree.
    finish = {Nodes.HEAP: _finish_linked, Nodes.COUNTER: _finish_counted, Nodes.ROWS: _finish_rows}[variant.nodes]
    nodes = finish(variant, executor, root, rule, watch)
    return Bvh(nodes.view(NODE).reshape(-1), prim_ids, shape, watch.laps_ms)


def _choose_threshold(variant: Variant, executor: Executor, count: int, options: BuildOptions) -> int:
    """Return the largest number of primitives of a range that is one task."""
    if not variant.parallel:
        return count
    if options.task_threshold is not None:
        return options.task_threshold
    return count if executor.workers == 1 else count // (executor.workers * _TASKS_PER_WORKER)


def _finish_linked(
    variant: Variant, executor: Executor, root: Range, rule: Rule, watch: Stopwatch
) -> NDArray[np.float32]:
    """Build linked subtrees; each worker keeps its own, and flattens them when all are built."""
    subtrees = _subtrees(root)
    try:
        node_counts = _build_all(executor, steps.build_and_hold, subtrees, rule)
        for node, node_count in zip(subtrees, node_counts, strict=True):
            node.node_count = node_count
        watch.lap("subtrees")

        nodes, finished = _place(executor, root, subtrees)
        executor.run_on_each(steps.flatten_held, finished)
        watch.lap("flatten" if variant.flattens else "convert")
    finally:
        with suppress(PoolError):  # of workers that are gone, and their nodes with them
            executor.run_on_each(steps.free_held)
    return nodes


def _finish_counted(
    variant: Variant, executor: Executor, root: Range, rule: Rule, watch: Stopwatch
) -> NDArray[np.float32]:
    """Build subtrees from the counter's nodes, link the top to them, and flatten the whole."""
    subtrees = _subtrees(root)
    for node, reference in zip(subtrees, _build_all(executor, steps.build_counted, subtrees, rule), strict=True):
        node.reference = reference
    watch.lap("subtrees")

    top = [
        (node.reference, node.box, [child.reference for child in node.children])
        for node in root.walk()
        if node.children
    ]
    (node_count,) = executor.map(steps.link_counted, [(top,)])
    nodes = executor.create("nodes", (node_count, NODE_LANES), np.float32)
    executor.map(steps.flatten_counted, [(root.reference,)])
    watch.lap("convert")
    return nodes


def _finish_rows(
    variant: Variant, executor: Executor, root: Range, rule: Rule, watch: Stopwatch
) -> NDArray[np.float32]:
    """Build flat subtrees, each in rows of its own, and move them together."""
    executor.create("rows", (2 * root.end, NODE_LANES), np.float32)
    subtrees = _subtrees(root)
    for node, node_count in zip(subtrees, _build_all(executor, steps.build_flat, subtrees, rule), strict=True):
        node.node_count = node_count
    watch.lap("subtrees")

    nodes, finished = _place(executor, root, subtrees)
    executor.map(steps.place_subtrees, [(finished[number :: executor.workers],) for number in range(executor.workers)])
    watch.lap("compact")
    return nodes


def _subtrees(root: Range) -> list[Range]:
    """Return the ranges at the bottom of the top, one task each, largest first."""
    return sorted(root.leaves(), key=len, reverse=True)


def _build_all(executor: Executor, step: Any, subtrees: list[Range], rule: Rule) -> list[int]:
    """Build all subtrees; return the results of the step, the number of nodes or a reference to the root."""
    return executor.map(step, [(node.task, node.ids, rule) for node in subtrees])


def _place(executor: Executor, root: Range, subtrees: list[Range]) -> tuple[NDArray[np.float32], list[steps.Finished]]:
    """Create the nodes of the whole tree and write the top; return them, and the place of each subtree."""
    nodes = executor.create("nodes", (place_top(root), NODE_LANES), np.float32)
    write_top(root, nodes.view(NODE)[:, 0])
    return nodes, [steps.Finished(node.begin, node.node_count, node.placement) for node in subtrees]
