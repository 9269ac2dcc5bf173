"""Primitive references for tests, and the same steps in plain numpy."""

from __future__ import annotations

import numpy as np

from clbvh.builders.prim_refs import fill_slice
from clbvh.geometry.corners import find_corners
from clbvh.structs import BOX_LANES


def make_prim_refs(mesh):
    """Return the (2, n, 8) buffers that a build starts with, and the (2, 8) bounds of all."""
    prim_refs = np.zeros((2, mesh.face_count, BOX_LANES), np.float32)
    return prim_refs, fill_slice(find_corners(mesh), 0, mesh.face_count, prim_refs[0])


def boxes_of(rows):
    """Return the lower and upper corners of rows, (n, 3) each."""
    return rows[:, :3], -rows[:, 4:7]


def bins_by_numpy(prim_refs, centroid_bounds, bin_count):
    """Return the bin of each reference on each axis, (n, 3), after the formula of the builder in float32."""
    lower = centroid_bounds[:3]
    extent = -centroid_bounds[4:7] - lower
    scale = np.zeros(3, np.float32)
    wide = extent > 2.0**-110
    scale[wide] = np.float32(bin_count) * np.float32(0.99999) / extent[wide]
    centroids = prim_refs[:, :3] - prim_refs[:, 4:7]
    return ((centroids - lower) * scale).astype(np.int64)


def split_by_numpy(prim_refs, bins, bin_count):
    """Return (cost, axis, last left bin, left count) of the cheapest boundary, by trying all of them."""
    lower, upper = (corner.astype(np.float64) for corner in boxes_of(prim_refs))

    def cost_of(chosen):
        x, y, z = upper[chosen].max(axis=0) - lower[chosen].min(axis=0)
        return (x * y + y * z + z * x) * chosen.sum()

    best = (np.inf, 0, 0, 0)
    for axis in range(3):
        for last_left in range(bin_count - 1):
            left = bins[:, axis] <= last_left
            if left.any() and not left.all():
                cost = cost_of(left) + cost_of(~left)
                if cost < best[0]:
                    best = (cost, axis, last_left, int(left.sum()))
    return best
