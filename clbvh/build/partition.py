"""Move the records of a range to the side of the split that each belongs to."""

from __future__ import annotations

import numpy as np
from numba import njit

from ..simd import centroid_of, empty_box, lane_of, load_row, store_row, unite
from .metadata import NEGATED_MAX
from .splits import bin_scales


@njit(cache=True, nogil=True)
def partition(  # type: ignore[no-untyped-def]
    source,
    begin,
    end,
    centroid_bounds,
    row,
    bin_count,
    axis,
    last_left_bin,
    target,
    left,
    right,
    child_bounds,
):
    """Copy the records of one slice of a node to both sides, in their order.

    The order within a side is that of the source, so slices that are partitioned by several workers, each to its
    own place, give bit for bit what one worker gives. It also makes the primitives of every leaf ascend.

    Parameters
    ----------
    source, target : (n, 8) float32
        Two buffers: a level of the tree reads from one and writes to the other.
    begin, end : int
        The slice in `source`.
    centroid_bounds, row, bin_count, axis, last_left_bin
        The node's bounds and its split: a record whose bin is at most `last_left_bin` goes left.
    left, right : int
        Where in `target` the slice's first left and first right record go.
    child_bounds : (2, 8) float32, written
        Bounds of the centroids of both sides of the slice.
    """
    left_bounds, right_bounds = empty_box(), empty_box()
    lower = centroid_bounds[row, axis]
    scale = lane_of(bin_scales(centroid_bounds, row, bin_count), axis)
    for record in range(begin, end):
        box = load_row(source, record)
        # The same arithmetic as `bins_of`, on one axis.
        centroid = source[record, axis] - source[record, NEGATED_MAX + axis]
        if np.int32((centroid - lower) * scale) <= last_left_bin:
            store_row(target, left, box)
            left_bounds = unite(centroid_of(box), left_bounds)
            left += 1
        else:
            store_row(target, right, box)
            right_bounds = unite(centroid_of(box), right_bounds)
            right += 1
    store_row(child_bounds, 0, left_bounds)
    store_row(child_bounds, 1, right_bounds)


@njit(cache=True, nogil=True)
def bound_halves(records, begin, middle, end, boxes, child_bounds):  # type: ignore[no-untyped-def]
    """Bound both halves of a range that is cut at `middle` without moving anything.

    For ranges that no plane splits, such as many copies of one triangle.

    Parameters
    ----------
    boxes, child_bounds : (2, 8) float32, written
        Row 0: left, row 1: right. The boxes, and the bounds of the centroids.
    """
    for side in range(2):
        box, bounds = empty_box(), empty_box()
        for record in range(begin if side == 0 else middle, middle if side == 0 else end):
            box = unite(load_row(records, record), box)
            bounds = unite(centroid_of(load_row(records, record)), bounds)
        store_row(boxes, side, box)
        store_row(child_bounds, side, bounds)
