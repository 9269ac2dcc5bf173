"""The quality `high`: the default tree, rearranged until rays find less to test.

Owns the order of the steps, and what threads share. The tree is the same, byte for byte, for any number of workers:
the subtrees that are rearranged follow from the tree, and each is the work of one thread.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh
from ..host_threads import HostThreads
from ..layout import NODE
from ..simd import LANES
from ..stopwatch import Stopwatch
from ..tree import Bvh, sah_cost
from .fold import choose_leaves, fold
from .metadata import record_slice
from .options import DEFAULT_QUALITY, MAX_DEPTH, BuildOptions
from .pool import SubtreePool
from .reinsertion import count_prims, list_rows, reinsert_below
from .sah import build_sah
from .unfold import LINK, ROOT, unfold

# More bins than the default ones give a better start on scans, and now and then a worse one elsewhere: both are built,
# and the tree of the lower cost is rearranged. docs/decisions.md has the shares.
_FINER_BINS = 64

# A subtree stays within the same eighth of the triangles. With the whole tree to choose from, the SAH cost falls by
# another percent, but not what rays test: docs/decisions.md. And eighths are work for eight threads.
_PARTS = 8
_SMALLEST_PART = 4096  # a few milliseconds: no work to share

# The first pass does about three quarters of what there is to do; four more than these gain less than 0.2 %, on scans
# and in buildings.
_PASSES = 4


def build_high(mesh: Mesh, pool: SubtreePool | None, options: BuildOptions) -> Bvh:
    """Build the default tree and optimise it; see `clbvh.build` for the parameters.

    Returns
    -------
    Bvh
        Never of a higher SAH cost than the default one, at the traversal cost of the options.

    Notes
    -----
    As many threads of this process as the pool has workers. Besides the mesh and two trees it takes about 110 bytes
    per triangle.
    """
    start = _build_start(mesh, pool, options)
    watch = Stopwatch()
    count = mesh.face_count
    records = np.empty((count, LANES), np.float32)
    record_slice(mesh, 0, count, records)
    nodes = np.ascontiguousarray(start.nodes).view(np.float32).reshape(-1, LANES)
    rows = np.zeros((2 * count, LANES), np.float32)
    links, parents = rows.view(np.int32), np.zeros(count, np.int32)
    unfold(nodes, nodes.view(np.int32), start.prim_ids, records, rows, links, parents)
    del records
    watch.lap("unfold")

    order = np.empty(2 * count, np.int32)
    order[0] = ROOT
    tops = _choose_tops(links, _list_all(links, order), max(count // _PARTS, _SMALLEST_PART))
    threads = HostThreads(1) if pool is None else pool.threads
    threads.run(_optimise, [(rows, links, parents, *part) for part in tops])
    watch.lap("reinsert")

    is_leaf = np.empty(2 * count, np.bool_)
    depth = choose_leaves(rows, links, options.leaf_size, options.traversal_cost, _list_all(links, order), is_leaf)
    better = start
    if depth <= MAX_DEPTH:
        folded = np.empty((2 * count, LANES), np.float32)
        prim_ids = np.empty(count, np.int32)
        row_count = fold(rows, links, is_leaf, folded, folded.view(np.int32), prim_ids)
        better = Bvh(folded[:row_count].copy().view(NODE).reshape(-1), prim_ids, mesh)
    cheapest = _cheapest((start, better), options)
    watch.lap("fold")
    return replace(cheapest, timings_ms={**start.timings_ms, **watch.laps_ms})


def _build_start(mesh: Mesh, pool: SubtreePool | None, options: BuildOptions) -> Bvh:
    """Return the better one of two finished trees."""
    plain = replace(options, quality=DEFAULT_QUALITY)
    start = build_sah(mesh, pool, plain)
    if options.bins is not None:
        return start
    watch = Stopwatch()
    finer = build_sah(mesh, pool, replace(plain, bins=_FINER_BINS))
    cheapest = _cheapest((start, finer), options)
    watch.lap("finer bins")
    return replace(cheapest, timings_ms={**start.timings_ms, **watch.laps_ms})


def _cheapest(trees: Iterable[Bvh], options: BuildOptions) -> Bvh:
    """Return the tree of the lowest SAH cost, the first one of several."""
    return min(trees, key=lambda tree: sah_cost(tree, traversal_cost=options.traversal_cost))


def _list_all(links: NDArray[np.int32], order: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return all rows, parents first; `order` is where they are put, behind the root."""
    return order[: 1 + list_rows(links, ROOT, order[1:])]


def _choose_tops(links: NDArray[np.int32], order: NDArray[np.int32], largest: int) -> list[tuple[int, int]]:
    """Return the largest subtrees of at most so many triangles: their roots and sizes, the largest first."""
    sizes = count_prims(links, order)
    tops = []
    waiting = [ROOT]
    while waiting:
        row = waiting.pop()
        if sizes[row] <= largest:
            tops.append((row, int(sizes[row])))
        else:
            child = int(links[row, LINK])
            waiting += [child + 1, child]
    return sorted(tops, key=lambda top: -top[1])


def _optimise(
    rows: NDArray[np.float32], links: NDArray[np.int32], parents: NDArray[np.int32], top: int, size: int
) -> None:
    """Rearrange one subtree."""
    below = np.empty(2 * size, np.int32)
    for _ in range(_PASSES):
        if reinsert_below(rows, links, parents, top, below[: list_rows(links, top, below)]) == 0:
            return
