"""Trees over many small shapes: one loop builds them all, from common arrays.

To call the steps of `build_sah.py` one by one takes 50 us for each shape, as long as a tree over 200 triangles; here a
tree over 12 triangles takes 8 us. The trees have the same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...bvh import Bvh
from ...geometry.joined_shapes import JoinedCorners
from ...geometry.spheres import Bounded
from ...structs import BOX_LANES, NODE
from ...support.host_threads import HostThreads
from ..options import BuildOptions
from ..prim_refs import SUBTREES
from .subtree import make_rule

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
    nodes, node_counts = np.empty(2 * begins[-1], NODE), np.empty(len(shapes), np.int64)
    rule = make_rule(options)
    with HostThreads(workers) as threads:
        threads.for_ranges(
            len(shapes),
            lambda first, end: SUBTREES.build_trees(
                *joined, *rule, first, end, prim_refs, prim_ids, nodes, node_counts
            ),
            least_items=_LEAST_SHAPES,
        )
    # Copied, so that the free slots behind each tree go.
    rows = zip(shapes, begins[:-1].tolist(), begins[1:].tolist(), node_counts.tolist(), strict=True)
    return [
        Bvh(nodes[2 * begin : 2 * begin + node_count].copy(), prim_ids[begin:end], shape)
        for shape, begin, end, node_count in rows
    ]
