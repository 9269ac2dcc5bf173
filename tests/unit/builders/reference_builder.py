"""A serial builder in plain numpy, written for comparison only: 16 bins, three axes, surface area heuristic.

After Wald, "On fast construction of SAH-based bounding volume hierarchies" (2007), in float64 throughout. It returns
no tree, but what a tree is measured by.
"""

from __future__ import annotations

import numpy as np

BINS = 16
LEAF_SIZE = 4


def area_of(lower, upper):
    x, y, z = np.moveaxis(upper - lower, -1, 0)
    return 2 * (x * y + y * z + z * x)


def sah_cost_by_reference(mesh):
    """Return the SAH cost of the tree that the reference builder makes: traversal 1, intersection 1."""
    corners = mesh.local_vertices[mesh.faces].astype(np.float64)
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    centres = (lower + upper) / 2
    root_area = area_of(lower.min(axis=0), upper.max(axis=0))

    cost = 0.0
    waiting = [np.arange(mesh.face_count)]
    while waiting:
        prims = waiting.pop()
        area = area_of(lower[prims].min(axis=0), upper[prims].max(axis=0))
        split_cost, goes_left = find_split(lower[prims], upper[prims], centres[prims])
        if len(prims) <= LEAF_SIZE and len(prims) * area <= area + split_cost:
            cost += len(prims) * area
            continue
        cost += area
        if goes_left is None:
            goes_left = np.arange(len(prims)) < len(prims) // 2
        waiting += [prims[goes_left], prims[~goes_left]]
    return cost / root_area


def find_split(lower, upper, centres):
    """Return the cheapest cost of two sides, and which primitives go left; (infinity, None) without one."""
    begin, extent = centres.min(axis=0), np.ptp(centres, axis=0)
    best, best_side = np.inf, None
    for axis in np.flatnonzero(extent > 0):
        bins = np.minimum(BINS * (centres[:, axis] - begin[axis]) / extent[axis], BINS - 1).astype(int)
        order = np.argsort(bins, kind="stable")
        used, starts, counts = np.unique(bins[order], return_index=True, return_counts=True)
        bin_lower = np.minimum.reduceat(lower[order], starts)
        bin_upper = np.maximum.reduceat(upper[order], starts)
        # Boxes and counts of everything up to each bin, and of everything behind it.
        left = area_of(np.minimum.accumulate(bin_lower), np.maximum.accumulate(bin_upper)) * np.cumsum(counts)
        backwards = slice(None, None, -1)
        right = area_of(np.minimum.accumulate(bin_lower[backwards]), np.maximum.accumulate(bin_upper[backwards]))
        right = (right * np.cumsum(counts[backwards]))[backwards]
        costs = left[:-1] + right[1:]
        if costs.min() < best:
            best = costs.min()
            best_side = bins <= used[costs.argmin()]
    return best, best_side
