"""Where to cut a range of primitives in two: binned surface area heuristic on three axes.

After Wald, "On fast construction of SAH-based bounding volume hierarchies" (2007): the centroids of a range fall
into equal bins along each axis, in one pass over the records; the boundary between two bins with the lowest
expected cost is the split. All steps are exact minima and integer sums, so bins filled by several workers and then
united are bit for bit the bins of one worker.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .simd import LANES, bins_of, empty_box, half_area, load_row, scales_of, store_row, unite

# A centroid on the upper bound must fall into the last bin, not behind it, whatever the rounding.
_BELOW_ONE = np.float32(0.99999)

# bins / extent must not overflow float32: on an axis along which the centroids lie closer together than this
# (object units), they count as equal.
_SMALLEST_EXTENT = np.float32(2.0**-110)

# A bin that gets two records in a row waits for the first to be stored. With two sets of bins, filled in turn, that is
# rare: 3.7 ms instead of 6.9 ms for 871,306 records. Small ranges do not earn back the second set.
_TWO_SETS_FROM = 256

# A range of fewer primitives than bins would spend its time on empty ones.
_FEWEST_BINS = 4
_PRIMS_PER_BIN = 2


@njit(cache=True, nogil=True)
def bin_count_for(prim_count, bins):  # type: ignore[no-untyped-def]
    """Return how many bins a range of `prim_count` primitives gets, at most `bins`."""
    return min(bins, max(_FEWEST_BINS, prim_count // _PRIMS_PER_BIN))


@njit(cache=True, nogil=True)
def bin_scales(centroid_bounds, row, bin_count):  # type: ignore[no-untyped-def]
    """Return the factors from a centroid's distance to the lower bound to its bin, as a box; 0 on a flat axis."""
    return scales_of(load_row(centroid_bounds, row), np.float32(bin_count) * _BELOW_ONE, _SMALLEST_EXTENT)


@njit(cache=True, nogil=True)
def make_bins(bin_count):  # type: ignore[no-untyped-def]
    """Return room for the bins of the three axes, twice: (6 * bin_count, 8) float32 boxes, int32 counts."""
    return np.empty((6 * bin_count, LANES), np.float32), np.empty(6 * bin_count, np.int32)


@njit(cache=True, nogil=True)
def fill_bins(records, begin, end, centroid_bounds, row, bin_count, boxes, counts):  # type: ignore[no-untyped-def]
    """Unite the records from `begin` to `end` into bins on the three axes.

    Parameters
    ----------
    records : (n, 8) float32
    centroid_bounds : (k, 8) float32
        `centroid_bounds[row]` bounds the centroids of the whole node.
    boxes : (6 * bin_count, 8) float32, written
        The first half: box of each bin, axis by axis. The second half is scratch.
    counts : (6 * bin_count,) int32, written
    """
    set_size = 3 * bin_count
    second_y, second_z = bin_count, 2 * bin_count
    lower, scales = load_row(centroid_bounds, row), bin_scales(centroid_bounds, row, bin_count)
    use_two = end - begin > _TWO_SETS_FROM
    for index in range(2 * set_size if use_two else set_size):
        store_row(boxes, index, empty_box())
        counts[index] = 0
    paired_end = begin + (end - begin) // 2 * 2 if use_two else begin
    for record in range(begin, paired_end, 2):
        even, odd = load_row(records, record), load_row(records, record + 1)
        x, y, z = bins_of(even, lower, scales)
        other_x, other_y, other_z = bins_of(odd, lower, scales)
        _put(even, x, boxes, counts)
        _put(odd, set_size + other_x, boxes, counts)
        _put(even, second_y + y, boxes, counts)
        _put(odd, set_size + second_y + other_y, boxes, counts)
        _put(even, second_z + z, boxes, counts)
        _put(odd, set_size + second_z + other_z, boxes, counts)
    for record in range(paired_end, end):
        box = load_row(records, record)
        x, y, z = bins_of(box, lower, scales)
        _put(box, x, boxes, counts)
        _put(box, second_y + y, boxes, counts)
        _put(box, second_z + z, boxes, counts)
    if use_two:
        for index in range(set_size):
            store_row(boxes, index, unite(load_row(boxes, index), load_row(boxes, set_size + index)))
            counts[index] += counts[set_size + index]


@njit(cache=True, nogil=True)
def _put(box, index, boxes, counts):  # type: ignore[no-untyped-def]
    store_row(boxes, index, unite(box, load_row(boxes, index)))
    counts[index] += 1


@njit(cache=True, nogil=True)
def find_split(boxes, counts, bin_count, prim_count, right_costs):  # type: ignore[no-untyped-def]
    """Return the cheapest boundary between two bins.

    Parameters
    ----------
    boxes, counts
        The bins, as `fill_bins` leaves them.
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
        box = empty_box()
        right_count = 0
        for index in range(bin_count - 1, 0, -1):
            if counts[first + index] > 0:
                box = unite(load_row(boxes, first + index), box)
                right_count += counts[first + index]
            right_costs[index] = half_area(box) * right_count if right_count > 0 else np.inf
        # From the left: what is below, and the sum.
        box = empty_box()
        left_count = 0
        for index in range(bin_count - 1):
            if counts[first + index] == 0:
                continue  # the same cut as the boundary before
            box = unite(load_row(boxes, first + index), box)
            left_count += counts[first + index]
            if left_count == prim_count:
                break
            cost = half_area(box) * left_count + right_costs[index + 1]
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
    left, right = empty_box(), empty_box()
    first = axis * bin_count
    for index in range(bin_count):
        if counts[first + index] > 0:
            if index <= last_left_bin:
                left = unite(load_row(boxes, first + index), left)
            else:
                right = unite(load_row(boxes, first + index), right)
    store_row(children, 0, left)
    store_row(children, 1, right)
