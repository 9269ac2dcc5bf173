"""One record per primitive: its box and its number, computed once before the build.

A record is one row of `simd`: 32 bytes, eight float32 lanes
``(min_x, min_y, min_z, prim_id, -max_x, -max_y, -max_z, 0)``. The builder moves whole records, so that each range
lies contiguous in memory. A primitive's centroid is taken as min + max, twice the centre of its box: the factor
does not matter for binning.

No lane holds a negative zero: -0.0 equals 0.0, so the minimum of the two would be whichever came first, and the bytes
of the tree would depend on how many workers shared the work.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..simd import LANES, centroid_of, empty_box, load_point, store_row, unite
from .ranges import Boxes

if TYPE_CHECKING:
    from ..geometry import Mesh

# Lanes of a record, of a bin and of any other box in the builder.
PRIM_ID = 3
NEGATED_MAX = 4


@njit(cache=True, nogil=True)
def box_of(vertices, faces, prim):  # type: ignore[no-untyped-def]
    """Return the box of one primitive."""
    a, b, c = (
        load_point(vertices, faces[prim, 0]),
        load_point(vertices, faces[prim, 1]),
        load_point(vertices, faces[prim, 2]),
    )
    return unite(c, unite(b, a))


@njit(cache=True, nogil=True)
def fill_records(vertices, faces, begin, end, records, record_ids, bounds):  # type: ignore[no-untyped-def]
    """Write the records of primitives `begin` to `end`, and their common bounds.

    Parameters
    ----------
    vertices : (V, 3) float32
    faces : (F, 3) int32
    begin, end : int
        Half-open range of primitives, for one worker's slice.
    records : (F, 8) float32, written
    record_ids : (F, 8) int32, written
        The same memory as `records`.
    bounds : (2, 8) float32, written
        Row 0: the box of the slice. Row 1: the box of its centroids.
    """
    box, centroid_box = empty_box(), empty_box()
    for prim in range(begin, end):
        record = box_of(vertices, faces, prim)
        store_row(records, prim, record)
        record_ids[prim, PRIM_ID] = prim
        box = unite(record, box)
        centroid_box = unite(centroid_of(record), centroid_box)
    store_row(bounds, 0, box)
    store_row(bounds, 1, centroid_box)


def record_slice(mesh: Mesh, begin: int, end: int, records: NDArray[np.float32]) -> Boxes:
    """Write the records of primitives `begin` to `end` of a mesh, (F, 8); return their (2, 8) bounds."""
    bounds = np.empty((2, LANES), np.float32)
    fill_records(mesh.vertices, mesh.faces, begin, end, records, records.view(np.int32), bounds)
    return bounds
