"""The work of the ladder's variants in counts: comparisons, boxes, moves and allocations.

For machines whose processor counts nothing for us. The variants' own steps run, compiled, on a source of primitives and
on an index array that count each access. Counts do not depend on the machine, and say nothing of caches.
"""

from __future__ import annotations

import operator
from typing import NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from ..builders.ladder.divide import BOX, Cached, Recomputed, Rule, Scratch, Task, bound_prim, centroid_of, fill_cache
from ..builders.ladder.subtrees import build_rows
from ..builders.ladder.variants import BINS, VARIANTS, Nodes
from ..builders.options import MAX_BINS, BuildOptions
from ..bvh.bvh import find_depths
from ..geometry import Mesh
from ..structs import NODE, NODE_LANES

_DEFAULT_BINS = 8


class LadderWork(NamedTuple):
    """The counted work of one build.

    Attributes
    ----------
    comparisons : int
        Of two primitives along an axis, in sorts and selections.
    bin_lookups : int
        A primitive's bin is found this often.
    boxes : int
        A primitive's box is computed from its corners this often.
    moves : int
        Primitive numbers written: in sorts, selections and partitions, into lists of a node's own, and into leaves.
    allocations : int
        Blocks of memory for nodes and for lists of a node's own.
    """

    comparisons: int
    bin_lookups: int
    boxes: int
    moves: int
    allocations: int


class _CountedPrims(NamedTuple):
    """A source of primitives, and how often it gave a box and a coordinate of a centroid."""

    prims: Cached | Recomputed
    counts: NDArray[np.int64]


class _CountedIds(NamedTuple):
    """An index array, and how often it was written to."""

    ids: NDArray[np.int32]
    writes: NDArray[np.int64]


@overload(bound_prim)
def _bound_counted(prims, prim):
    if getattr(prims, "instance_class", None) is not _CountedPrims:
        return None

    def bound(prims, prim):
        prims.counts[0] += 1
        return bound_prim(prims.prims, prim)

    return bound


@overload(centroid_of)
def _centroid_counted(prims, prim, axis):
    if getattr(prims, "instance_class", None) is not _CountedPrims:
        return None

    def centroid(prims, prim, axis):
        prims.counts[1] += 1
        return centroid_of(prims.prims, prim, axis)

    return centroid


@overload(operator.getitem)
def _get_counted(ids, index):
    if getattr(ids, "instance_class", None) is not _CountedIds:
        return None

    def get(ids, index):
        return ids.ids[index]

    return get


@overload(operator.setitem)
def _set_counted(ids, index, value):
    if getattr(ids, "instance_class", None) is not _CountedIds:
        return None

    def put(ids, index, value):
        ids.ids[index] = value
        ids.writes[0] += 1

    return put


def count_ladder_work(mesh: Mesh, name: str, options: BuildOptions | None = None) -> LadderWork:
    """Count the work of one variant on one mesh.

    Parameters
    ----------
    mesh : Mesh
    name : str
        A key of `VARIANTS`.
    options : BuildOptions, optional

    Returns
    -------
    LadderWork
        Of a build by one worker. All workers together do the same, but for the atomic counter.
    """
    options = options or BuildOptions()
    variant = VARIANTS[name]
    rule = Rule(variant.how, options.bins or _DEFAULT_BINS, variant.leaf_size(options), variant.copies)
    count = mesh.face_count
    source: Cached | Recomputed = Recomputed(mesh.local_vertices, mesh.faces)
    if variant.cached:
        aabbs, centroids = np.empty((count, BOX), np.float32), np.empty((count, 3), np.float32)
        fill_cache(mesh.local_vertices, mesh.faces, 0, count, aabbs, centroids)
        source = Cached(aabbs, centroids)

    # The tree is the same as without counting; moves through the scratch memory count as well.
    accesses, writes = np.zeros(2, np.int64), np.zeros(1, np.int64)
    ids = _CountedIds(np.arange(count, dtype=np.int32), writes)
    scratch = Scratch(
        _CountedIds(np.empty(count, np.int32), writes),  # type: ignore[arg-type]
        np.empty((2, BOX), np.float32),
        np.empty(MAX_BINS, np.int64),
    )
    rows = np.empty((2 * count, NODE_LANES), np.float32)
    node_count = int(build_rows(_CountedPrims(source, accesses), Task(0, count, 0), rule, ids, scratch, rows))
    nodes = rows[:node_count].view(NODE).reshape(-1)
    # Each primitive lies in the ranges of its leaf and of all nodes above.
    range_sizes = int((nodes["count"] * (find_depths(nodes["first"], nodes["count"]) + 1)).sum())

    # Each node asks for three coordinates of all its centroids to find its longest axis.
    asked_to_divide = int(accesses[1]) - 3 * range_sizes
    # Each node but the root gets a list.
    copied, lists = (range_sizes - count, node_count - 1) if variant.copies else (0, 0)
    return LadderWork(
        comparisons=0 if variant.how == BINS else asked_to_divide // 2,
        bin_lookups=asked_to_divide if variant.how == BINS else 0,
        boxes=count if variant.cached else int(accesses.sum()),
        moves=int(writes[0]) + copied,
        allocations=lists + (node_count if variant.nodes is Nodes.HEAP else 0),
    )
