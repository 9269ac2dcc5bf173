"""A mesh becomes a tree by one rung of the ladder.

Owns the order of the phases. What differs between rungs is asked of the `Rung`, once per phase.
"""

from __future__ import annotations

from functools import cache, partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InternalError
from ...geometry import Mesh
from ...layout import NODE, NODE_LANES
from ...stopwatch import Stopwatch
from ...tree import Bvh
from ..options import BuildOptions
from ..pool import SubtreePool
from . import steps
from .crew import Caller, Crew, Workers, run_on_each
from .divide import Rule
from .heap import COUNTER_WORDS, WORDS
from .prims import BOX
from .rungs import RUNGS, Nodes, Rung
from .top import TopNode, assign_rows, divide_top, write_top

# The report's number of bins.
DEFAULT_BINS = 8

# Tasks per worker, when the task threshold is chosen here: enough to even out unequal subtrees.
_TASKS_PER_WORKER = 8


def build_rung(rung: Rung, mesh: Mesh, pool: SubtreePool | None, options: BuildOptions) -> Bvh:
    """Build a tree by one rung of the ladder.

    Parameters
    ----------
    rung : Rung
    mesh : Mesh
    pool : SubtreePool or None
        Worker processes for a parallel rung. Without one, the calling process builds.
    options : BuildOptions
        Of these `bins`, `leaf_size`, `task_threshold` and `frontier` are heeded, where the rung has them.

    Returns
    -------
    Bvh
        The same bytes for any pool and any threshold. No leaf lies deeper than 64. Its phases: "share" (the mesh
        for the workers), "metadata", "top" (tasks that divide one range each), "subtrees", and "flatten" or
        "convert" (linked nodes become rows) or "compact" (rows move to their final places).

    Raises
    ------
    PoolError
        A worker failed or died, or there is not enough memory to share.

    Notes
    -----
    O(n log n) in the number of triangles, from `median` on; O(n log² n) for the rungs that sort.
    """
    # Compiled code is loaded before time is taken.
    _rehearse(rung.name)
    crew = Caller() if pool is None or not rung.parallel else Workers(pool)
    with crew:
        run_on_each(crew, rehearse, rung.name)
        return _build(rung, mesh, crew, options)


LADDER = {name: partial(build_rung, rung) for name, rung in RUNGS.items()}


def rehearse(arrays: steps.Arrays, name: str) -> None:
    """Load all compiled code of a rung into this process, and free what an interrupted build left; a step."""
    _rehearse(name)
    steps.free_held(arrays)


@cache
def _rehearse(name: str) -> None:
    """Build a tree of four triangles, with a top."""
    corners = np.arange(12, dtype=np.float32).reshape(4, 3)
    faces = np.array([[0, 1, 2], [1, 2, 3], [0, 2, 3], [0, 1, 3]], np.int32)
    options = BuildOptions(leaf_size=1, task_threshold=2)
    _build(RUNGS[name], Mesh(corners, faces, np.zeros(3)), Caller(), options)


def _build(rung: Rung, mesh: Mesh, crew: Crew, options: BuildOptions) -> Bvh:
    watch = Stopwatch()
    count = mesh.face_count
    rule = Rule(rung.how, options.bins or DEFAULT_BINS, rung.leaf_size(options), rung.copies)
    crew.share("vertices", mesh.vertices)
    crew.share("faces", mesh.faces)
    prim_ids = crew.create("prim_ids", (count,), np.int32)
    prim_ids[:] = np.arange(count)
    watch.lap("share")

    # Boxes and centroids, once.
    if rung.cached:
        crew.create("aabbs", (count, BOX), np.float32)
        crew.create("centroids", (count, 3), np.float32)
        cuts = [count * number // crew.workers for number in range(crew.workers + 1)]
        crew.map(steps.cache_slice, list(pairwise(cuts)))
        crew.discard("vertices", "faces")
        watch.lap("metadata")

    # The top, one task per node.
    if rung.nodes is Nodes.COUNTER:
        crew.create("blocks", (2 * count, WORDS), np.int64)
        crew.create("counter", (COUNTER_WORDS,), np.int64)
    root = TopNode(0, count, 0, np.arange(count, dtype=np.int32) if rung.copies else None)
    divide_top(crew, root, rule, _choose_threshold(rung, crew, count, options))
    watch.lap("top")

    # The subtrees, one task each, and all of it as rows.
    finish = {Nodes.HEAP: _finish_linked, Nodes.COUNTER: _finish_counted, Nodes.ROWS: _finish_rows}[rung.nodes]
    nodes = finish(rung, crew, root, rule, watch)
    return Bvh(nodes.view(NODE).reshape(-1), prim_ids, mesh, watch.laps_ms)


def _choose_threshold(rung: Rung, crew: Crew, count: int, options: BuildOptions) -> int:
    """Return up to how many primitives a range is one task."""
    if not rung.parallel:
        return count
    if options.task_threshold is not None:
        return options.task_threshold
    return count if crew.workers == 1 else count // (crew.workers * _TASKS_PER_WORKER)


def _finish_linked(rung: Rung, crew: Crew, root: TopNode, rule: Rule, watch: Stopwatch) -> NDArray[np.float32]:
    """Build linked subtrees; each worker keeps its own, and makes rows of them when all are done."""
    subtrees = _subtrees(root)
    for node, row_count in zip(subtrees, _build_all(crew, steps.build_and_hold, subtrees, rule), strict=True):
        node.row_count = row_count
    watch.lap("subtrees")

    nodes, placements = _place(crew, root, subtrees)
    written = sum(run_on_each(crew, steps.flatten_held, placements))
    if written != len(subtrees):
        raise InternalError(f"{len(subtrees)} subtrees were built, but {written} became rows")
    watch.lap("flatten" if rung.flattens else "convert")
    run_on_each(crew, steps.free_held)
    return nodes


def _finish_counted(rung: Rung, crew: Crew, root: TopNode, rule: Rule, watch: Stopwatch) -> NDArray[np.float32]:
    """Build subtrees whose nodes have numbers, link the top by them, and make rows of the whole."""
    subtrees = _subtrees(root)
    for node, block in zip(subtrees, _build_all(crew, steps.build_counted, subtrees, rule), strict=True):
        node.block = block
    watch.lap("subtrees")

    top = [(node.block, node.box, [child.block for child in node.children]) for node in root.walk() if node.children]
    (node_count,) = crew.map(steps.link_counted, [(top,)])
    nodes = crew.create("nodes", (node_count, NODE_LANES), np.float32)
    crew.map(steps.flatten_counted, [(root.block,)])
    watch.lap("convert")
    return nodes


def _finish_rows(rung: Rung, crew: Crew, root: TopNode, rule: Rule, watch: Stopwatch) -> NDArray[np.float32]:
    """Build subtrees as rows, each in rows of its own, and move them together."""
    crew.create("rows", (2 * root.end, NODE_LANES), np.float32)
    subtrees = _subtrees(root)
    for node, row_count in zip(subtrees, _build_all(crew, steps.build_flat, subtrees, rule), strict=True):
        node.row_count = row_count
    watch.lap("subtrees")

    nodes, placements = _place(crew, root, subtrees)
    crew.map(steps.place_subtrees, [(placements[number :: crew.workers],) for number in range(crew.workers)])
    watch.lap("compact")
    return nodes


def _subtrees(root: TopNode) -> list[TopNode]:
    """Return the ranges that are left for one task each, largest first."""
    return sorted((node for node in root.walk() if not node.children), key=len, reverse=True)


def _build_all(crew: Crew, step: Any, subtrees: list[TopNode], rule: Rule) -> list[int]:
    """Return what a step says of each subtree: its number of nodes, or its root's number."""
    return crew.map(step, [(node.begin, node.end, node.depth, node.ids, rule) for node in subtrees])


def _place(crew: Crew, root: TopNode, subtrees: list[TopNode]) -> tuple[NDArray[np.float32], list[steps.Placement]]:
    """Create the final rows and write the top; return them, and where each subtree goes."""
    nodes = crew.create("nodes", (assign_rows(root), NODE_LANES), np.float32)
    write_top(root, nodes)
    return nodes, [steps.Placement(node.begin, node.row_count, node.row, node.first_row) for node in subtrees]
