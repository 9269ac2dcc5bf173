"""End-point overlap: the share of the surface that lies in boxes of nodes which do not hold it.

A ray that ends on a surface must visit every node whose box holds the end point, even if the subtree does not hold the
triangle that is hit. The measure sums these visits up, and explains differences between trees of equal SAH cost
(Aila, Karras and Laine, "On quality metrics of bounding volume hierarchies", HPG 2013).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..bvh.bvh import Bvh
from ..device.host.loops import Loops
from ..errors import ConfigError

_LOOPS = Loops("stats/overlap")

# Of a node on the stack, see `pending_t` in the loop's file.
_PENDING_NUMBERS = 2 + 9 * 3


class Overlap(NamedTuple):
    """The end-point overlap of a tree.

    Attributes
    ----------
    epo : float
        Expected cost of the needless node visits at the end of a ray, whose end points are uniform over the surface.
    triangle_count : int
        The number of triangles measured: all of them, or a sample.
    """

    epo: float
    triangle_count: int


def measure_overlap(
    bvh: Bvh,
    *,
    traversal_cost: float = 1.0,
    intersection_cost: float = 1.0,
    sample: int | None = None,
) -> Overlap:
    """Measure the end-point overlap (EPO) of a tree.

    Parameters
    ----------
    bvh : Bvh
    traversal_cost : float
        Cost of an interior node; the paper's is 1.2.
    intersection_cost : float
        Cost of one triangle test.
    sample : int, optional
        Measure on this many triangles, spread evenly over the order of the leaves, instead of on all.

    Returns
    -------
    Overlap
        Its `epo` is 0 for a surface without area.

    Raises
    ------
    ConfigError
        A sample of less than one triangle.

    Notes
    -----
    The sum over all nodes of the area of the surface inside the node's box that does not belong to its subtree, times
    the node's cost, divided by the area of the whole surface. Boxes are closed: a triangle in the face of a box lies
    inside. Where triangles coincide, each counts.

    The area is exact up to rounding in float64, because triangles are clipped to the boxes. Each triangle descends the
    tree and is clipped on its way, so the time is proportional to the number of overlaps, not to nodes times
    triangles. Deterministic.
    """
    if sample is not None and sample < 1:
        raise ConfigError(f"a sample must have at least 1 triangle, not {sample}")
    prim_count = len(bvh.prim_ids)
    sample_count = prim_count if sample is None else min(sample, prim_count)
    # The middles of equal intervals: all slots of prim_ids where the sample is the whole.
    slots = ((2 * np.arange(sample_count) + 1) * prim_count) // (2 * sample_count)

    nodes = np.ascontiguousarray(bvh.nodes)
    count = nodes["count"]
    costs = np.where(count > 0, count * float(intersection_cost), float(traversal_cost))
    parents, owners = np.full(len(nodes), -1, np.int32), np.empty(prim_count, np.int32)
    _LOOPS.find_owners(nodes, parents, owners)
    sums, stack = np.empty(2), np.empty((bvh.depth + 2) * _PENDING_NUMBERS)
    _LOOPS.sum_overlaps(
        bvh.mesh.local_vertices, bvh.mesh.faces, bvh.prim_ids, slots, nodes, costs, parents, owners,
        np.full(len(nodes), -1, np.int32), stack, sums,
    )  # fmt: skip
    overlap, area = sums.tolist()
    return Overlap(overlap / area if area > 0 else 0.0, sample_count)
