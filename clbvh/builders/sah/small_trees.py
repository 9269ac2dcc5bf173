"""Trees over many small shapes: one compiled loop builds them all, from common arrays.

To call the steps of `build_sah.py` one by one takes 50 us for each shape, as long as a tree over 200 triangles; here a
tree over 12 triangles takes 8 us. The trees have the same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...bvh import Bvh
from ...geometry.corners import Bounded
from ...geometry.joined_shapes import JoinedCorners
from ...structs import BOX_LANES, NODE
from ...support.compiled import compiled
from ...support.host_threads import HostThreads
from ..invariants import WHOLE_TREE
from ..options import BuildOptions
from ..prim_refs import PrimSlice, fill_prim_refs
from .subtree import SubtreeTask, build_subtree, make_rule, place_finished

# Least shapes of a thread's range: each takes some microseconds.
_LEAST_SHAPES = 64


def build_small(shapes: Sequence[Bounded], options: BuildOptions, workers: int | None = None) -> list[Bvh]:
    """Build a tree over each shape, as `build_sah` does.

    Notes
    -----
    Besides the shapes and the result it needs 130 bytes per primitive of all shapes together.
    """
    joined = JoinedCorners.of(shapes)
    begins = joined.first_prims
    prim_refs = np.empty((2 * begins[-1], BOX_LANES), np.float32)
    prim_ids = np.empty(begins[-1], np.int32)
    # A tree over n primitives has up to 2n - 1 nodes.
    nodes, node_counts = np.empty((2 * begins[-1], BOX_LANES), np.float32), np.empty(len(shapes), np.int64)
    output = prim_refs, prim_ids, nodes, node_counts
    rule = make_rule(options)
    with HostThreads(workers) as threads:
        threads.for_ranges(
            len(shapes),
            lambda first, end: _build_trees(joined, rule, first, end, *output),
            least_items=_LEAST_SHAPES,
        )
    made = nodes.view(NODE).reshape(-1)
    # Copied, so that the free slots behind each tree go.
    rows = zip(shapes, begins[:-1].tolist(), begins[1:].tolist(), node_counts.tolist(), strict=True)
    return [
        Bvh(made[2 * begin : 2 * begin + node_count].copy(), prim_ids[begin:end], shape)
        for shape, begin, end, node_count in rows
    ]


@compiled
def _build_trees(joined, rule, first, end, prim_refs, prim_ids, nodes, node_counts):
    """Build the trees over a range of shapes.

    Parameters
    ----------
    joined : JoinedCorners
    rule : Rule
    first, end : int
        Of the shapes.
    prim_refs : (2 n, 8) float32, overwritten
    prim_ids : (n,) int32, written
    nodes : (2 n, 8) float32, rows of `structs.NODE`, written
        Those of a shape begin at twice the number of the primitives before it.
    node_counts : (shapes,) int64, written
    """
    bounds = np.empty((2, BOX_LANES), np.float32)
    for shape in range(first, end):
        begin, stop = joined.first_prims[shape], joined.first_prims[shape + 1]
        count = stop - begin
        points = joined.points[joined.first_points[shape] : joined.first_points[shape + 1]]
        refs = prim_refs[2 * begin : 2 * stop].reshape((2, count, BOX_LANES))
        fill_prim_refs(PrimSlice(points, joined.ids[begin:stop], 0, count), refs[0], bounds)
        node_counts[shape] = build_subtree(refs, SubtreeTask(0, count, 0, 0, bounds), rule, prim_ids[begin:stop])
        place_finished(refs, count, node_counts[shape], WHOLE_TREE, nodes[2 * begin : 2 * stop])
