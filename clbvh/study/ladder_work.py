"""The work of the ladder's variants in counts: comparisons, boxes, moves and allocations.

For machines whose processor counts nothing for us. The variants' own steps run, compiled once more with counts. These
do not depend on the machine, and say nothing of caches.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..builders.ladder.build_variant import DEFAULT_BINS
from ..builders.ladder.steps import Rule
from ..builders.ladder.variants import VARIANTS, Nodes
from ..builders.options import BuildOptions
from ..device.host.loops import Loops
from ..geometry import Mesh
from ..structs import BOX_LANES, NODE_LANES


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
    variant, count = VARIANTS[name], mesh.face_count
    rule = Rule(variant.how, options.bins or DEFAULT_BINS, variant.leaf_size(options), variant.copies)
    boxes, centroids = np.empty((count, BOX_LANES), np.float32), np.empty((count, 3), np.float32)
    # The counter's nodes are as little work as those of the flat tree.
    rows = None if variant.nodes is Nodes.HEAP else np.empty((2 * count, NODE_LANES), np.float32)
    prim_ids, scratch = np.arange(count, dtype=np.int32), np.empty(count, np.int32)
    counts = np.zeros(len(LadderWork._fields), np.int64)
    Loops("ladder/count").count_work(
        mesh.local_vertices, mesh.faces, *rule, variant.cached, boxes, centroids, rows, prim_ids, scratch,
        np.zeros(1, np.int64), counts,
    )  # fmt: skip
    return LadderWork._make(counts.tolist())
