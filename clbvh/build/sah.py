"""The default builder: binned surface area heuristic, parallel from the root.

Owns the order of the steps and the arrays they share. The tree is the same, byte for byte, for any number of workers
and any task threshold.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import MeshError
from ..geometry import Mesh
from ..layout import NODE
from ..stopwatch import Stopwatch
from ..tree import Bvh
from . import steps
from .arena import Arena
from .compact import plan_rows, write_top
from .few import FEW
from .metadata import NEGATED_MAX
from .options import BuildOptions
from .pool import SubtreePool
from .ranges import Boxes, Range, cut_slices
from .simd import LANES
from .top import split_top, warm_up

# Below this many primitives the calling process is faster than handing over.
SMALL_MESH = 20_000

# Ranges per worker, when the task threshold is chosen here: enough to even out unequal subtrees.
_RANGES_PER_WORKER = 8

DEFAULT_BINS = 16


def build_sah(mesh: Mesh, pool: SubtreePool | None, options: BuildOptions) -> Bvh:
    """Build with the surface area heuristic; see `clbvh.build` for the parameters.

    Notes
    -----
    O(n log n) in the number of triangles. Besides the mesh and the result it sets aside 128 bytes per triangle, of
    which it touches about 100; with a pool, it needs a copy of the mesh at first.
    """
    if pool is None or (mesh.face_count < SMALL_MESH and options.task_threshold is None):
        return _build_here(mesh, options)
    return _build_in_pool(mesh, pool, options)


def _build_here(mesh: Mesh, options: BuildOptions) -> Bvh:
    """Build in the calling process: the whole tree is one subtree."""
    watch = Stopwatch()
    count = mesh.face_count
    arrays: dict[str, NDArray[Any]] = {
        "vertices": mesh.vertices,
        "faces": mesh.faces,
        "records": np.empty((2, count, LANES), np.float32),
        "scratch_nodes": np.empty((2 * count, LANES), np.float32),
        "prim_ids": np.empty(count, np.int32),
    }
    bounds = steps.record_slice(arrays, 0, count)
    _check_width(mesh, bounds)
    watch.lap("metadata")

    whole = (0, count, 0, 0, bounds)
    (row_count,) = steps.build_subtrees(arrays, [whole], *_subtree_options(options))
    watch.lap("subtrees")

    nodes = arrays["scratch_nodes"][:row_count].copy()
    watch.lap("compact")
    return Bvh(_as_nodes(nodes), arrays["prim_ids"], mesh, watch.laps_ms)


def _build_in_pool(mesh: Mesh, pool: SubtreePool, options: BuildOptions) -> Bvh:
    """Build with all workers of a pool."""
    warm_up()
    pool.wait_ready()
    watch = Stopwatch()
    count = mesh.face_count
    with Arena() as arena:
        # Share the mesh, and the memory that workers write to.
        shared = {"vertices": arena.share(mesh.vertices), "faces": arena.share(mesh.faces)}
        shared["records"], records = arena.create((2, count, LANES), np.float32)
        shared["scratch_nodes"] = arena.create((2 * count, LANES), np.float32)[0]
        shared["prim_ids"], prim_ids = arena.create((count,), np.int32)
        pool.attach(shared)
        watch.lap("share")

        # One record per primitive; the workers need the mesh no longer.
        bounds = pool.map(steps.record_slice, cut_slices(0, count, pool.workers))
        root = Range(0, count, 0, 0, np.minimum.reduce(bounds))
        _check_width(mesh, root.bounds)
        arena.free(shared.pop("vertices"))
        arena.free(shared.pop("faces"))
        pool.attach(shared)
        watch.lap("metadata")

        # All workers together, until there are enough subtrees for all.
        threshold = options.task_threshold or max(1, count // (pool.workers * _RANGES_PER_WORKER))
        split_top(pool, root, records, max(threshold, options.leaf_size, FEW), options.bins or DEFAULT_BINS)
        watch.lap("top")

        # Each worker on its own: subtrees, largest first.
        _build_subtrees(pool, root, options)
        del records
        arena.free(shared.pop("records"))
        watch.lap("subtrees")

        # Into depth-first order, without gaps.
        plan = plan_rows(root)
        shared["nodes"], nodes = arena.create((plan.row_count, LANES), np.float32)
        pool.attach(shared)
        write_top(plan, nodes)
        shares = [plan.subtrees[number :: pool.workers] for number in range(pool.workers)]
        pool.map(steps.place_subtrees, [(share,) for share in shares])
        pool.attach({})
        watch.lap("compact")
    return Bvh(_as_nodes(nodes), prim_ids, mesh, watch.laps_ms)


def _check_width(mesh: Mesh, bounds: Boxes) -> None:
    """Refuse a mesh in which the distance of two doubled centroids overflows: it has no bin."""
    with np.errstate(over="ignore", invalid="ignore"):  # what does not fit is refused
        extents = -bounds[1, NEGATED_MAX : NEGATED_MAX + 3] - bounds[1, :3]
    if not np.isfinite(extents).all():
        raise MeshError(f"{mesh.name}: the mesh is too wide for distances in float32: give it in a larger unit")


def _build_subtrees(pool: SubtreePool, root: Range, options: BuildOptions) -> None:
    """Build the subtree of every range that the top left, and note its row count."""
    ranges = sorted(root.leaves(), key=len, reverse=True)
    # Many small ranges travel together, so that messages do not outweigh the work.
    smallest_batch = len(root) // (pool.workers * _RANGES_PER_WORKER)
    batches: list[list[Range]] = []
    batch_size = smallest_batch
    for node in ranges:
        if batch_size >= smallest_batch:
            batches.append([])
            batch_size = 0
        batches[-1].append(node)
        batch_size += len(node)

    tasks = [
        (
            [(node.begin, node.end, node.buffer, node.depth, node.bounds) for node in batch],
            *_subtree_options(options),
        )
        for batch in batches
    ]
    for batch, row_counts in zip(batches, pool.map(steps.build_subtrees, tasks), strict=True):
        for node, row_count in zip(batch, row_counts, strict=True):
            node.row_count = row_count


def _subtree_options(options: BuildOptions) -> tuple[int, int, float]:
    """Return what a subtree's builder needs to know of the options."""
    return options.bins or DEFAULT_BINS, options.leaf_size, options.traversal_cost


def _as_nodes(rows: NDArray[np.float32]) -> NDArray[np.void]:
    """Return (N, 8) lanes as (N,) records of `layout.NODE`, the same memory."""
    return rows.view(NODE).reshape(-1)
