"""Where to cut a range of primitives in two: binned surface area heuristic on three axes.

After Wald, "On fast construction of SAH-based bounding volume hierarchies" (2007): the centroids of a range fall
into equal bins along each axis, in one pass over the records; the boundary between two bins with the lowest
expected cost is the split. All steps are exact minima and integer sums, so bins filled by several workers and then
united are bit for bit the bins of one worker.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .metadata import NEGATED_MAX, clear_box
from .simd import merge_aabb

# A centroid on the upper bound must fall into the last bin, not behind it, whatever the rounding.
_BELOW_ONE = np.float32(0.99999)

# bins / extent must not overflow float32: on an axis along which the centroids lie closer together than this
# (object units), they count as equal.
_SMALLEST_EXTENT = np.float32(2.0**-110)

# A range of fewer primitives than bins would spend its time on empty ones.
_FEWEST_BINS = 4
_PRIMS_PER_BIN = 2


@njit(cache=True, nogil=True)
def bin_count_for(prim_count, bins):  # type: ignore[no-untyped-def]
    """Return how many bins a range of `prim_count` primitives gets, at most `bins`."""
    return min(bins, max(_FEWEST_BINS, prim_count // _PRIMS_PER_BIN))


@njit(cache=True, nogil=True)
def bin_scale(centroid_bounds, row, axis, bin_count):  # type: ignore[no-untyped-def]
    """Return the factor from a centroid's distance to the lower bound to its bin; 0 on a flat axis."""
    extent = -centroid_bounds[row, NEGATED_MAX + axis] - centroid_bounds[row, axis]
    if not extent > _SMALLEST_EXTENT:
        return np.float32(0.0)
    return np.float32(bin_count) * _BELOW_ONE / extent


@njit(cache=True, nogil=True)
def bin_of(records, record, axis, lower, scale):  # type: ignore[no-untyped-def]
    """Return the bin of one record along one axis."""
    return np.uint32((records[record, axis] - records[record, NEGATED_MAX + axis] - lower) * scale)


@njit(cache=True, nogil=True)
def fill_bins(records, begin, end, centroid_bounds, row, bin_count, boxes, counts):  # type: ignore[no-untyped-def]
    """Unite the records from `begin` to `end` into bins on the three axes.

    Parameters
    ----------
    records : (n, 8) float32
    centroid_bounds : (k, 8) float32
        `centroid_bounds[row]` bounds the centroids of the whole node.
    boxes : (3 * bin_count, 8) float32, written
        Box of each bin, axis by axis.
    counts : (3 * bin_count,) int32, written
    """
    for index in range(3 * bin_count):
        clear_box(boxes, index)
        counts[index] = 0
    lower_x, lower_y, lower_z = centroid_bounds[row, 0], centroid_bounds[row, 1], centroid_bounds[row, 2]
    scale_x = bin_scale(centroid_bounds, row, 0, bin_count)
    scale_y = bin_scale(centroid_bounds, row, 1, bin_count)
    scale_z = bin_scale(centroid_bounds, row, 2, bin_count)
    first_y, first_z = np.uint32(bin_count), np.uint32(2 * bin_count)
    for record in range(begin, end):
        bin_x = bin_of(records, record, 0, lower_x, scale_x)
        bin_y = first_y + bin_of(records, record, 1, lower_y, scale_y)
        bin_z = first_z + bin_of(records, record, 2, lower_z, scale_z)
        merge_aabb(boxes, bin_x, records, record)
        merge_aabb(boxes, bin_y, records, record)
        merge_aabb(boxes, bin_z, records, record)
        counts[bin_x] += 1
        counts[bin_y] += 1
        counts[bin_z] += 1


@njit(cache=True, nogil=True)
def half_area(boxes, row):  # type: ignore[no-untyped-def]
    """Return half the surface area of a box that is not empty."""
    # In float64: areas of a mesh that is 1e20 units wide do not fit float32.
    size_x = -(np.float64(boxes[row, 0]) + boxes[row, NEGATED_MAX])
    size_y = -(np.float64(boxes[row, 1]) + boxes[row, NEGATED_MAX + 1])
    size_z = -(np.float64(boxes[row, 2]) + boxes[row, NEGATED_MAX + 2])
    return size_x * size_y + size_y * size_z + size_z * size_x


@njit(cache=True, nogil=True)
def find_split(boxes, counts, bin_count, prim_count, sweep, right_costs):  # type: ignore[no-untyped-def]
    """Return the cheapest boundary between two bins.

    Parameters
    ----------
    boxes, counts
        The bins, as `fill_bins` leaves them.
    sweep : (>= 1, 8) float32, scratch
    right_costs : (>= bin_count,) float64, scratch

    Returns
    -------
    cost : float
        Half area times count, summed over both sides; infinite when all centroids fall into one bin.
    axis : int
    last_left_bin : int
    left_count : int
        Equal costs go to the lowest axis, then the lowest bin.
    """
    best_cost, best_axis, best_bin, best_left = np.inf, 0, 0, 0
    for axis in range(3):
        first = axis * bin_count
        # From the right: the cost of everything above each boundary.
        clear_box(sweep, 0)
        right_count = 0
        for index in range(bin_count - 1, 0, -1):
            if counts[first + index] > 0:
                merge_aabb(sweep, 0, boxes, first + index)
                right_count += counts[first + index]
            right_costs[index] = half_area(sweep, 0) * right_count if right_count > 0 else np.inf
        # From the left: what is below, and the sum.
        clear_box(sweep, 0)
        left_count = 0
        for index in range(bin_count - 1):
            if counts[first + index] == 0:
                continue  # the same cut as the boundary before
            merge_aabb(sweep, 0, boxes, first + index)
            left_count += counts[first + index]
            if left_count == prim_count:
                break
            cost = half_area(sweep, 0) * left_count + right_costs[index + 1]
            if cost < best_cost:
                best_cost, best_axis, best_bin, best_left = cost, axis, index, left_count
    return best_cost, best_axis, best_bin, best_left


@njit(cache=True, nogil=True)
def unite_sides(boxes, counts, bin_count, axis, last_left_bin, children):  # type: ignore[no-untyped-def]
    """Write the boxes of both sides of a split: the union of their bins.

    Parameters
    ----------
    children : (2, 8) float32, written
        Row 0: left, row 1: right.
    """
    clear_box(children, 0)
    clear_box(children, 1)
    for index in range(bin_count):
        if counts[axis * bin_count + index] > 0:
            merge_aabb(children, 0 if index <= last_left_bin else 1, boxes, axis * bin_count + index)
