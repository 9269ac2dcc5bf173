"""The default builder: binned surface area heuristic, parallel from the root.

Owns the order of the steps and the arrays they share. The tree is the same, byte for byte, for any number of workers
and any task threshold.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..errors import MeshError
from ..geometry import Mesh
from ..layout import NODE
from ..simd import LANES
from ..stopwatch import Stopwatch
from ..tree import Bvh
from . import steps
from .compact import place_subtrees, plan_rows, write_top
from .crew import Crew, gather
from .few import FEW
from .metadata import NEGATED_MAX, record_slice
from .options import BuildOptions
from .pool import SubtreePool
from .ranges import Boxes, Range, cut_slices
from .top import split_top

# Below this many primitives the calling process is faster than handing over.
SMALL_MESH = 20_000

# Ranges per worker, when the task threshold is chosen here: enough to even out unequal subtrees. Smaller ranges would
# cost more messages than they even out.
_RANGES_PER_WORKER = 8
_SMALLEST_RANGE = 10_000

DEFAULT_BINS = 16

# Enough for a top of one node.
_WARM_UP_TRIANGLES = FEW + 1


def build_sah(mesh: Mesh, pool: SubtreePool | None, options: BuildOptions) -> Bvh:
    """Build with the surface area heuristic; see `clbvh.build` for the parameters.

    Notes
    -----
    O(n log n) in the number of triangles. Besides the mesh and the result it needs 68 bytes per triangle; a pool keeps
    up to 1 GiB of them for the next build.
    """
    count = mesh.face_count
    if count < SMALL_MESH and options.task_threshold is None:
        pool = None
    if pool is not None:
        _warm_up()
        pool.wait_ready()
    watch = Stopwatch()
    with gather(pool, count) as crew:
        # One record per primitive.
        records = crew.arrays["records"]
        slices = [(mesh, *cut, records[0]) for cut in cut_slices(0, count, crew.workers)]
        root = Range(0, count, 0, 0, np.minimum.reduce(crew.threads.run(record_slice, slices)))
        check_width(mesh, root.bounds)
        watch.lap("metadata")

        # All threads together, until there are enough subtrees for all workers.
        split_top(crew, root, _choose_threshold(crew, count, options), options.bins or DEFAULT_BINS)
        watch.lap("top")

        # Each worker on its own: subtrees, largest first.
        _build_subtrees(crew, root, options)
        watch.lap("subtrees")

        # Into depth-first order, without gaps.
        plan = plan_rows(root)
        nodes = np.empty((plan.row_count, LANES), np.float32)
        write_top(plan, nodes)
        shares = [plan.subtrees[number :: crew.workers] for number in range(crew.workers)]
        crew.threads.run(place_subtrees, [(records, share, nodes) for share in shares])
        prim_ids = crew.arrays["prim_ids"]
        # A pool's arrays are lent.
        prim_ids = prim_ids if pool is None else prim_ids.copy()
        watch.lap("compact")
    return Bvh(_as_nodes(nodes), prim_ids, mesh, watch.laps_ms)


@cache
def _warm_up() -> None:
    """Load the compiled code of this process, while it would otherwise wait for its workers to start."""
    corners = np.arange(9 * _WARM_UP_TRIANGLES, dtype=np.float32).reshape(-1, 3)
    faces = np.arange(3 * _WARM_UP_TRIANGLES, dtype=np.int32).reshape(-1, 3)
    build_sah(Mesh(corners, faces, np.zeros(3)), None, BuildOptions(task_threshold=1))


def _choose_threshold(crew: Crew, count: int, options: BuildOptions) -> int:
    """Return up to how many primitives a range is one worker's task."""
    threshold = options.task_threshold
    if threshold is None:
        fair_share = count // (crew.workers * _RANGES_PER_WORKER)
        threshold = count if crew.workers == 1 else max(fair_share, _SMALLEST_RANGE)
    return max(threshold, options.leaf_size, FEW)


def check_width(mesh: Mesh, bounds: Boxes) -> None:
    """Refuse a mesh in which the distance of two doubled centroids overflows: it has no bin."""
    with np.errstate(over="ignore", invalid="ignore"):  # what does not fit is refused
        extents = -bounds[1, NEGATED_MAX : NEGATED_MAX + 3] - bounds[1, :3]
    if not np.isfinite(extents).all():
        raise MeshError(f"{mesh.name}: the mesh is too wide for distances in float32: give it in a larger unit")


def _build_subtrees(crew: Crew, root: Range, options: BuildOptions) -> None:
    """Build the subtree of every range that the top left, and note its number of nodes."""
    ranges = sorted(root.leaves(), key=len, reverse=True)
    # Many small ranges travel together, so that messages do not outweigh the work.
    smallest_batch = len(root) // (crew.workers * _RANGES_PER_WORKER)
    batches: list[list[Range]] = []
    batch_size = smallest_batch
    for node in ranges:
        if batch_size >= smallest_batch:
            batches.append([])
            batch_size = 0
        batches[-1].append(node)
        batch_size += len(node)

    how = (options.bins or DEFAULT_BINS, options.leaf_size, options.traversal_cost)
    tasks = [
        ([(node.begin, node.end, node.buffer, node.depth, node.bounds) for node in batch], *how) for batch in batches
    ]
    for batch, node_counts in zip(batches, crew.map(steps.build_subtrees, tasks), strict=True):
        for node, node_count in zip(batch, node_counts, strict=True):
            node.node_count = node_count


def _as_nodes(rows: NDArray[np.float32]) -> NDArray[np.void]:
    """Return (N, 8) lanes as (N,) records of `layout.NODE`, the same memory."""
    return rows.view(NODE).reshape(-1)
