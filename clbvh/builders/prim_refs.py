"""Primitive references: the box and the id of each primitive, computed once before the build.

A primitive reference is one row of `boxes`: 32 bytes, eight float32 lanes
``(min_x, min_y, min_z, prim_id, -max_x, -max_y, -max_z, 0)``. The builder moves whole references, so that each range
lies contiguous in memory. A primitive's centroid is taken as min + max, twice the centre of its box: the factor
does not matter for binning.

No lane holds a negative zero: -0.0 equals 0.0, so the minimum of the two would be whichever came first, and the bytes
of the tree would depend on how many workers shared the work.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.boxes import centroid_of, empty_box, load_point, store_box, unite
from ..structs import BOX_LANES, PRIM_REF_ID
from ..support.compiled import compiled

if TYPE_CHECKING:
    from ..geometry.corners import Corners

# The bounds of a set of primitives: (2, 8) float32, two rows of `boxes`.
Bounds = NDArray[np.float32]
BOUNDS_BOX = 0  # the row with the box of the primitives
BOUNDS_CENTROIDS = 1  # the row with the box of their centroids


class PrimSlice(NamedTuple):
    """A range of primitives, for one thread.

    Attributes
    ----------
    points : (m, 3) float32
    ids : (n, 3) int32
        The corners of all primitives.
    begin, end : int
    """

    points: NDArray[np.float32]
    ids: NDArray[np.int32]
    begin: int
    end: int


@compiled
def box_of(points, ids, prim):
    """Return the box of one primitive."""
    a, b, c = load_point(points, ids[prim, 0]), load_point(points, ids[prim, 1]), load_point(points, ids[prim, 2])
    return unite(c, unite(b, a))


@compiled
def fill_prim_refs(prim_slice, refs, bounds):
    """Write the references of a slice's primitives, and their common bounds.

    Parameters
    ----------
    prim_slice : PrimSlice
    refs : (n, 8) float32, written
    bounds : (2, 8) float32, written
    """
    points, ids = prim_slice.points, prim_slice.ids
    ref_ints = refs.view(np.int32)
    box, centroid_box = empty_box(), empty_box()
    for prim in range(prim_slice.begin, prim_slice.end):
        ref = box_of(points, ids, prim)
        store_box(refs, prim, ref)
        ref_ints[prim, PRIM_REF_ID] = prim
        box = unite(ref, box)
        centroid_box = unite(centroid_of(ref), centroid_box)
    store_box(bounds, BOUNDS_BOX, box)
    store_box(bounds, BOUNDS_CENTROIDS, centroid_box)


def fill_slice(corners: Corners, begin: int, end: int, prim_refs: NDArray[np.float32]) -> Bounds:
    """Write the references of primitives `begin` to `end` into (n, 8) `prim_refs`; return their bounds."""
    bounds = np.empty((2, BOX_LANES), np.float32)
    fill_prim_refs(PrimSlice(*corners, begin, end), prim_refs, bounds)
    return bounds
