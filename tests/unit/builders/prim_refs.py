"""Records of the builder for tests, and the same steps in plain numpy."""

from __future__ import annotations

import numpy as np

from clbvh.build.metadata import record_slice
from clbvh.simd import LANES


def make_records(mesh):
    """Return the (2, n, 8) buffers that a build starts with, and the (2, 8) bounds of all."""
    records = np.zeros((2, mesh.face_count, LANES), np.float32)
    return records, record_slice(mesh, 0, mesh.face_count, records[0])


def boxes_of(rows):
    """Return the lower and upper corners of rows, (n, 3) each."""
    return rows[:, :3], -rows[:, 4:7]


def bins_by_numpy(records, centroid_bounds, bin_count):
    """Return the bin of each record on each axis, (n, 3), after the formula of the builder in float32."""
    lower = centroid_bounds[:3]
    extent = -centroid_bounds[4:7] - lower
    scale = np.zeros(3, np.float32)
    wide = extent > 2.0**-110
    scale[wide] = np.float32(bin_count) * np.float32(0.99999) / extent[wide]
    centroids = records[:, :3] - records[:, 4:7]
    return ((centroids - lower) * scale).astype(np.int64)


def split_by_numpy(records, bins, bin_count):
    """Return (cost, axis, last left bin, left count) of the cheapest boundary, by trying all of them."""
    lower, upper = (corner.astype(np.float64) for corner in boxes_of(records))

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
