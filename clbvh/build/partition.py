"""Move the records of a range to the side of the split that each belongs to."""

from __future__ import annotations

from numba import njit

from .metadata import clear_box
from .simd import copy_row, merge_aabb, merge_centroid
from .splits import bin_of, bin_scale


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
    clear_box(child_bounds, 0)
    clear_box(child_bounds, 1)
    lower = centroid_bounds[row, axis]
    scale = bin_scale(centroid_bounds, row, axis, bin_count)
    for record in range(begin, end):
        if bin_of(source, record, axis, lower, scale) <= last_left_bin:
            copy_row(target, left, source, record)
            merge_centroid(child_bounds, 0, source, record)
            left += 1
        else:
            copy_row(target, right, source, record)
            merge_centroid(child_bounds, 1, source, record)
            right += 1


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
        clear_box(boxes, side)
        clear_box(child_bounds, side)
        for record in range(begin if side == 0 else middle, middle if side == 0 else end):
            merge_aabb(boxes, side, records, record)
            merge_centroid(child_bounds, side, records, record)
