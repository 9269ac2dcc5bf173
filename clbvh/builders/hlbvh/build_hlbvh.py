"""The build of `quality="fast"`: triangles in Morton order, so that most of the tree needs no choice.

Owns the order of the steps. The tree is the same, byte for byte, for any number of workers and any task threshold.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ...layout import NODE
from ...simd import LANES
from ...stopwatch import Stopwatch
from ...tree import Bvh
from ..crew import Crew, gather
from ..options import MAX_DEPTH, BuildOptions
from ..pool import SubtreePool
from ..ranges import cut_slices
from ..sah import DEFAULT_BINS, SMALL_MESH, check_width
from . import steps
from .box_tree import build_box_tree
from .buckets import cut_buckets, fill_buckets
from .codes import bound_vertices, count_cells, make_grid
from .grow import BUCKET_DEPTH
from .join import PLACEMENT_COLUMNS, place_buckets, plan_rows, write_top

# The grid that buckets are made of, and its number of cells.
_AXIS_BITS = 5
_CELL_COUNT = 1 << 3 * _AXIS_BITS

# Most primitives in a bucket that is more than one cell.
_BUCKET_SIZE = 1024

# Tasks per worker: enough to even out unequal subtrees.
_TASKS_PER_WORKER = 8


def build_fast(mesh: Mesh, pool: SubtreePool | None, options: BuildOptions) -> Bvh:
    """Build in as few milliseconds as possible; see `clbvh.build` for the parameters.

    Returns
    -------
    Bvh
        Its phases: "buckets", "subtrees", "compact".

    Notes
    -----
    O(n log n) in the number of triangles. Besides the mesh and the result it needs 70 bytes per triangle; a pool keeps
    up to 1 GiB of them for the next build.
    """
    # Compiled code is loaded before time is taken.
    _warm_up()
    if mesh.face_count < SMALL_MESH and options.task_threshold is None:
        pool = None
    if pool is not None:
        pool.map(steps.warm_up, [()] * pool.workers)
    return _build(mesh, pool, options)


@cache
def _warm_up() -> None:
    """Build a small tree."""
    corners = np.arange(12, dtype=np.float32).reshape(4, 3)
    faces = np.array([[0, 1, 2], [1, 2, 3], [0, 2, 3], [0, 1, 3]], np.int32)
    _build(Mesh(corners, faces, np.zeros(3)), None, BuildOptions())


def _build(mesh: Mesh, pool: SubtreePool | None, options: BuildOptions) -> Bvh:
    watch = Stopwatch()
    count = mesh.face_count
    bins = options.bins or DEFAULT_BINS
    with gather(pool, count) as crew:
        # One record per primitive, those of neighbours in one bucket.
        rows = crew.arrays["records"].reshape(-1, LANES)
        buckets = _fill_buckets(mesh, crew, rows)
        watch.lap("buckets")

        # Each bucket becomes a subtree.
        boxes, row_counts = _grow_subtrees(crew, buckets, bins, options)
        watch.lap("subtrees")

        # The tree over the buckets, and all of it in depth-first order.
        top_nodes, order = build_box_tree(boxes, len(boxes), MAX_DEPTH - BUCKET_DEPTH, bins)
        placements = np.empty((len(buckets), PLACEMENT_COLUMNS), np.int64)
        top_rows = np.empty((len(buckets) - 1, 3), np.int64)
        row_count = plan_rows(top_nodes.view(np.int32), order, buckets, row_counts, placements, top_rows)
        nodes, prim_ids = np.empty((row_count, LANES), np.float32), np.empty(count, np.int32)
        node_ints = nodes.view(np.int32)
        write_top(top_nodes, top_rows, nodes, node_ints)
        result = nodes, node_ints, prim_ids
        tasks = [
            (buckets[part], row_counts[part], placements[part], rows, crew.arrays["prim_ids"], *result)
            for part in (slice(*cut) for cut in cut_slices(0, len(buckets), crew.workers))
        ]
        crew.threads.run(place_buckets, tasks)
        watch.lap("compact")
    return Bvh(nodes.view(NODE).reshape(-1), prim_ids, mesh, watch.laps_ms)


def _fill_buckets(mesh: Mesh, crew: Crew, rows: NDArray[np.float32]) -> NDArray[np.int64]:
    """Write all records into their buckets; return begin and end of each, (k, 2)."""
    workers = crew.workers
    # A grid over the mesh.
    bounds = np.empty((workers, 2, LANES), np.float32)
    parts = cut_slices(0, len(mesh.vertices), workers)
    crew.threads.run(bound_vertices, [(mesh.vertices, *cut, bounds[part]) for part, cut in enumerate(parts)])
    whole = np.minimum.reduce(bounds)
    check_width(mesh, whole)
    grid = make_grid(whole, 1, _AXIS_BITS)

    # How many primitives there are in each cell, for each slice of the mesh.
    slices = cut_slices(0, mesh.face_count, workers)
    cells = np.empty(mesh.face_count, np.uint16)
    counts = np.zeros((workers, _CELL_COUNT), np.int32)
    tasks = [(mesh.vertices, mesh.faces, *cut, grid, cells, counts[part]) for part, cut in enumerate(slices)]
    crew.threads.run(count_cells, tasks)
    bucket_of_cell = np.zeros(_CELL_COUNT, np.int32)
    first_cells = np.empty(_CELL_COUNT, np.int64)
    bucket_count = cut_buckets(counts.sum(axis=0), _BUCKET_SIZE, bucket_of_cell, first_cells)

    # What each slice has in each bucket says where its records go.
    slice_counts = np.add.reduceat(counts, first_cells[:bucket_count], axis=1, dtype=np.int64)
    ends = slice_counts.sum(axis=0).cumsum()
    begins = ends - slice_counts.sum(axis=0)
    next_rows = 2 * begins + slice_counts.cumsum(axis=0) - slice_counts
    crew.threads.run(
        fill_buckets,
        [
            (mesh.vertices, mesh.faces, *cut, cells, bucket_of_cell, next_rows[part], rows, rows.view(np.int32))
            for part, cut in enumerate(slices)
        ],
    )
    return np.stack([begins, ends], axis=1)


def _grow_subtrees(
    crew: Crew, buckets: NDArray[np.int64], bins: int, options: BuildOptions
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Build the subtrees of all buckets; return their boxes, (k, 8), and numbers of rows, (k,)."""
    # Neighbours travel together, until a task has its size.
    size = options.task_threshold or max(1, int(buckets[-1, 1]) // (crew.workers * _TASKS_PER_WORKER))
    cuts = np.flatnonzero(np.diff(buckets[:, 0] // size)) + 1
    tasks = np.split(buckets, cuts)
    # The largest first.
    order = sorted(range(len(tasks)), key=lambda task: int(tasks[task][0, 0] - tasks[task][-1, 1]))
    how = (bins, options.leaf_size, options.traversal_cost)
    grown = dict(zip(order, crew.map(steps.grow_subtrees, [(tasks[task], *how) for task in order]), strict=True))
    results = [grown[task] for task in range(len(tasks))]
    return np.concatenate([boxes for boxes, _ in results]), np.concatenate([counts for _, counts in results])
