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
    """
    nodes = bvh.nodes
    size = nodes["aabb_max"].astype(np.float64) - nodes["aabb_min"]
    areas = size[:, 0] * size[:, 1] + size[:, 1] * size[:, 2] + size[:, 2] * size[:, 0]
    costs = np.where(nodes["count"] > 0, nodes["count"] * intersection_cost, traversal_cost)
    if areas[0] == 0:
        return float(costs.sum())
    return float((areas * costs).sum() / areas[0])
