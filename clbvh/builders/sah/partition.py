"""Move the primitive references of a node to their sides of a split."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...geometry.boxes import centroid_of, empty_box, lane_of, load_box, store_box, unite
from ...structs import BOX_NEGATED_MAX
from ...support.compiled import compiled
from ..prim_refs import BOUNDS_CENTROIDS
from .binned_split import bin_scales


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
