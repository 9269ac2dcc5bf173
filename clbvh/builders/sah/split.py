"""Where to cut a range of primitives in two, and how its references move to their sides.

The binned surface area heuristic on three axes, after Wald, "On fast construction of SAH-based bounding volume
hierarchies" (2007): the centroids of a range fall into equal bins along each axis, in one pass over the primitive
references; the boundary between two bins with the lowest expected cost is the split. All steps are exact minima and
integer sums, so bins filled by several threads and then united are bit for bit the bins of one thread.

Of a few primitives every division in two is tried. Most nodes of a tree are this small; it takes less time than filling
bins, and finds the cheapest division, which need not be a cut along an axis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...geometry.boxes import (
    add_to_box,
    bins_of,
    centroid_of,
    empty_box,
    half_area,
    lane_of,
    load_box,
    scales_of,
    store_box,
    tally_of,
    unite,
)
from ...structs import BOX_LANES, BOX_NEGATED_MAX
from ...support.compiled import compiled
from ...support.loop_functions import prefetch
from ..prim_refs import BOUNDS_CENTROIDS

# A centroid on the upper bound must fall into the last bin, not behind it, whatever the rounding.
_BELOW_ONE = np.float32(0.99999)

# bins / extent must not overflow float32: on an axis along which the centroids lie closer together than this
# (local units), they count as equal.
_SMALLEST_EXTENT = np.float32(2.0**-110)

# Prefetch distance in primitive references. A range larger than the caches is read from memory, which the processor
# foresees only within a page: 871,306 references take 3.1 ms instead of 4.2 ms.
_PREFETCH_DISTANCE = 64

# A small range would spend its time on nearly empty bins. With 4 primitives a bin instead of 2, 871,306 primitives take
# 5 % less time and the SAH cost grows by 0.13 %.
_FEWEST_BINS = 4
_PRIMS_PER_BIN = 4


class Split(NamedTuple):
    """A plane between two bins of one axis.

    Attributes
    ----------
    cost : float
        Half area times count, summed over both sides; infinite when no plane splits the range.
    axis, last_left_bin, left_count : int
    bin_count : int
        Bins along the axis.
    """

    cost: float
    axis: int
    last_left_bin: int
    left_count: int
    bin_count: int


@compiled
def bin_count_for(prim_count, bins):
    """Return how many bins a range of `prim_count` primitives gets, at most `bins`."""
    return min(bins, max(_FEWEST_BINS, prim_count // _PRIMS_PER_BIN))


@compiled
def bin_scales(centroid_box, bin_count):
    """Return the factors from a centroid's distance to the lower bound to its bin, as a box; 0 on a flat axis."""
    return scales_of(centroid_box, np.float32(bin_count) * _BELOW_ONE, _SMALLEST_EXTENT)


@compiled
def make_bins(bin_count):
    """Return memory for the bins of the three axes: (3 * bin_count, 8) float32, rows of `boxes`, axis by axis."""
    return np.empty((3 * bin_count, BOX_LANES), np.float32)


@compiled
def fill_bins(refs, begin, end, bounds, bin_count, bins):
    """Unite the primitive references from `begin` to `end` into bins on the three axes.

    Parameters
    ----------
    refs : (n, 8) float32
    begin, end : int
        A node's range, or a slice of it.
    bounds : (2, 8) float32
        The bounds of the whole node.
    bin_count : int
    bins : (3 * bin_count, 8) float32, written
        The box of each bin, with the number of its primitives as tally.
    """
    first_y, first_z = bin_count, 2 * bin_count
    lower = load_box(bounds, BOUNDS_CENTROIDS)
    scales = bin_scales(lower, bin_count)
    for index in range(3 * bin_count):
        store_box(bins, index, empty_box())
    for index in range(begin, end):
        prefetch(refs, BOX_LANES * (index + _PREFETCH_DISTANCE))
        box = load_box(refs, index)
        x, y, z = bins_of(box, lower, scales)
        add_to_box(bins, x, box)
        add_to_box(bins, first_y + y, box)
        add_to_box(bins, first_z + z, box)


@compiled
def find_split(bins, bin_count, right_costs):
    """Return the cheapest boundary between two bins.

    Parameters
    ----------
    bins : (3 * bin_count, 8) float32
        As `fill_bins` leaves them.
    bin_count : int
    right_costs : (>= 3 * bin_count,) float64, scratch

    Returns
    -------
    Split
        Equal costs go to the lowest axis, then the lowest bin.

    Notes
    -----
    Empty bins need no branch: an empty side has an infinite area and no primitives, so its cost is not a number and
    loses every comparison; and a cut behind an empty bin costs as much as the cut before it.
    """
    # From the right: the cost of everything above each boundary, all axes at once.
    first_y, first_z = bin_count, 2 * bin_count
    x, y, z = empty_box(), empty_box(), empty_box()
    count_x = count_y = count_z = 0
    for index in range(bin_count - 1, 0, -1):
        bin_x, bin_y, bin_z = load_box(bins, index), load_box(bins, first_y + index), load_box(bins, first_z + index)
        x, y, z = unite(bin_x, x), unite(bin_y, y), unite(bin_z, z)
        count_x += tally_of(bin_x)
        count_y += tally_of(bin_y)
        count_z += tally_of(bin_z)
        right_costs[index] = half_area(x) * count_x
        right_costs[first_y + index] = half_area(y) * count_y
        right_costs[first_z + index] = half_area(z) * count_z

    # From the left: the cost of everything below, and the sum.
    best_cost, best_axis, best_bin, best_left = np.inf, 0, 0, 0
    for axis in range(3):
        first = axis * bin_count
        box = empty_box()
        left_count = 0
        for index in range(bin_count - 1):
            bin_box = load_box(bins, first + index)
            box = unite(bin_box, box)
            left_count += tally_of(bin_box)
            cost = half_area(box) * left_count + right_costs[first + index + 1]
            if cost < best_cost:
                best_cost, best_axis, best_bin, best_left = cost, axis, index, left_count
    return Split(best_cost, best_axis, best_bin, best_left, bin_count)


@compiled
def unite_sides(bins, split, boxes):
    """Write the boxes of both sides of a split: the union of their bins.

    Parameters
    ----------
    bins : (3 * split.bin_count, 8) float32
    split : Split
    boxes : (2, 8) float32, written
        Row 0: left, row 1: right.
    """
    first = split.axis * split.bin_count
    left, right = empty_box(), empty_box()
    for index in range(split.last_left_bin + 1):
        left = unite(load_box(bins, first + index), left)
    for index in range(split.last_left_bin + 1, split.bin_count):
        right = unite(load_box(bins, first + index), right)
    store_box(boxes, 0, left)
    store_box(boxes, 1, right)


# Four primitives can be divided in 7 ways, five in 15.
MAX_EXHAUSTIVE = 4


@compiled
def find_exhaustive_split(refs, begin, prim_count):
    """Return the cheapest division of 2 to `MAX_EXHAUSTIVE` primitives in two.

    Parameters
    ----------
    refs : (n, 8) float32
    begin, prim_count : int

    Returns
    -------
    cost : float
        Half area times count, summed over both sides.
    left_mask : int
        Bit i is set if the primitive reference at begin + i goes left. The first one always does, and of equal costs
        the division that is tried first wins.
    """
    a, b = load_box(refs, begin), load_box(refs, begin + 1)
    if prim_count == 2:
        return half_area(a) + half_area(b), 0b01

    c = load_box(refs, begin + 2)
    ab, ac, bc = unite(a, b), unite(a, c), unite(b, c)
    if prim_count == 3:
        cost, left_mask = _cheaper(half_area(a) + 2 * half_area(bc), 0b001, 2 * half_area(ab) + half_area(c), 0b011)
        return _cheaper(cost, left_mask, 2 * half_area(ac) + half_area(b), 0b101)

    d = load_box(refs, begin + 3)
    ad, bd, cd = unite(a, d), unite(b, d), unite(c, d)
    cost, left_mask = _cheaper(2 * (half_area(ab) + half_area(cd)), 0b0011, 2 * (half_area(ac) + half_area(bd)), 0b0101)
    cost, left_mask = _cheaper(cost, left_mask, 2 * (half_area(ad) + half_area(bc)), 0b1001)
    cost, left_mask = _cheaper(cost, left_mask, half_area(a) + 3 * half_area(unite(b, cd)), 0b0001)
    cost, left_mask = _cheaper(cost, left_mask, half_area(b) + 3 * half_area(unite(a, cd)), 0b1101)
    cost, left_mask = _cheaper(cost, left_mask, half_area(c) + 3 * half_area(unite(ab, d)), 0b1011)
    return _cheaper(cost, left_mask, half_area(d) + 3 * half_area(unite(ab, c)), 0b0111)


@compiled
def _cheaper(cost, left_mask, other_cost, other_left_mask):
    return (other_cost, other_left_mask) if other_cost < cost else (cost, left_mask)


@compiled
def count_left(left_mask):
    """Return how many of at most `MAX_EXHAUSTIVE` primitives go left."""
    return (left_mask & 1) + (left_mask >> 1 & 1) + (left_mask >> 2 & 1) + (left_mask >> 3 & 1)


@compiled
def divide(source, target, begin, prim_count, left_mask, boxes):
    """Copy the primitive references of a range to both sides, in their order.

    Parameters
    ----------
    source, target : (n, 8) float32
    begin, prim_count, left_mask : int
        The range and its division, see `find_exhaustive_split`.
    boxes : (2, 8) float32, written
        The boxes of both sides.
    """
    left, right = begin, begin + count_left(left_mask)
    left_box, right_box = empty_box(), empty_box()
    for index in range(prim_count):
        box = load_box(source, begin + index)
        if left_mask >> index & 1:
            store_box(target, left, box)
            left_box = unite(box, left_box)
            left += 1
        else:
            store_box(target, right, box)
            right_box = unite(box, right_box)
            right += 1
    store_box(boxes, 0, left_box)
    store_box(boxes, 1, right_box)


class Slice(NamedTuple):
    """A part of a node's range, and where its primitive references go.

    Attributes
    ----------
    begin, end : int
    left, right : int
        Index in the other buffer of the slice's first reference on either side.
    """

    begin: int
    end: int
    left: int
    right: int


@compiled
def partition(source, target, part, bounds, split, centroid_boxes):
    """Copy the primitive references of one slice of a node to both sides, in their order.

    The order within a side is that of the source, so slices that are partitioned by several threads, each to slots of
    its own, give bit for bit the result of one thread. It also makes the primitives of every leaf ascend.

    Parameters
    ----------
    source, target : (n, 8) float32
        Two buffers: a level of the tree reads from one and writes to the other.
    part : Slice
    bounds : (2, 8) float32
        The bounds of the whole node.
    split : Split
    centroid_boxes : (2, 8) float32, written
        The boxes of the centroids on both sides of the slice.
    """
    axis, last_left_bin, left, right = split.axis, split.last_left_bin, part.left, part.right
    left_box, right_box = empty_box(), empty_box()
    lower = bounds[BOUNDS_CENTROIDS, axis]
    scale = lane_of(bin_scales(load_box(bounds, BOUNDS_CENTROIDS), split.bin_count), axis)
    for index in range(part.begin, part.end):
        box = load_box(source, index)
        # The same arithmetic as `bins_of`, on one axis.
        centroid = source[index, axis] - source[index, BOX_NEGATED_MAX + axis]
        if np.int32((centroid - lower) * scale) <= last_left_bin:
            store_box(target, left, box)
            left_box = unite(centroid_of(box), left_box)
            left += 1
        else:
            store_box(target, right, box)
            right_box = unite(centroid_of(box), right_box)
            right += 1
    store_box(centroid_boxes, 0, left_box)
    store_box(centroid_boxes, 1, right_box)


@compiled
def bound_halves(refs, begin, middle, end, boxes, centroid_boxes):
    """Bound both halves of a range that is cut at `middle` without moving anything.

    For ranges that no plane splits, such as many copies of one triangle.

    Parameters
    ----------
    refs : (n, 8) float32
    begin, middle, end : int
    boxes, centroid_boxes : (2, 8) float32, written
        Row 0: left, row 1: right.
    """
    for side in range(2):
        box, centroid_box = empty_box(), empty_box()
        for index in range(begin if side == 0 else middle, middle if side == 0 else end):
            box = unite(load_box(refs, index), box)
            centroid_box = unite(centroid_of(load_box(refs, index)), centroid_box)
        store_box(boxes, side, box)
        store_box(centroid_boxes, side, centroid_box)
