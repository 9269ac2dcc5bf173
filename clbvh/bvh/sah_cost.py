"""The expected cost of a random ray, by the surface area heuristic."""

from __future__ import annotations

import numpy as np

from .bvh import Bvh


def sah_cost(bvh: Bvh, *, traversal_cost: float = 1.0, intersection_cost: float = 1.0) -> float:
    """Return the expected cost of a random ray that hits the root's box, by the surface area heuristic.

    Parameters
    ----------
    bvh : Bvh
    traversal_cost : float
        Cost of an interior node.
    intersection_cost : float
        Cost of one triangle test.

    Returns
    -------
    float
        The sum over all nodes of cost times area, relative to the root's area (MacDonald and Booth, "Heuristics
        for ray tracing using space subdivision", 1990). For a mesh without extent, whose areas are all zero, the
        cost of the ray that visits everything.

    Examples
    --------
    A tree that was refitted costs the more, the farther its triangles have moved apart. Build again above 1.3 times:

    >>> import clbvh
    >>> import numpy as np
    >>> boxes = clbvh.make_shape("boxes", triangles=1200)
    >>> shift = np.random.default_rng(0).normal(size=(100, 3))
    >>> bvh = clbvh.build(boxes).refit(boxes.vertices + shift.repeat(8, axis=0))  # 8 corners of each box
    >>> clbvh.sah_cost(bvh) > 1.3 * clbvh.sah_cost(clbvh.build(bvh.mesh))
    True
    """
    nodes = bvh.nodes
    size = nodes["aabb_max"].astype(np.float64) - nodes["aabb_min"]
    areas = size[:, 0] * size[:, 1] + size[:, 1] * size[:, 2] + size[:, 2] * size[:, 0]
    costs = np.where(nodes["count"] > 0, nodes["count"] * intersection_cost, traversal_cost)
    if areas[0] == 0:
        return float(costs.sum())
    return float((areas * costs).sum() / areas[0])
