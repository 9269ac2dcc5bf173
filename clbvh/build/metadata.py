"""One record per primitive: its box and its number, computed once before the build.

A record is one row of `simd`: 32 bytes, eight float32 lanes
``(min_x, min_y, min_z, prim_id, -max_x, -max_y, -max_z, 0)``. The builder moves whole records, so that each range
lies contiguous in memory. A primitive's centroid is taken as min + max, twice the centre of its box: the factor
does not matter for binning.

No lane holds a negative zero: -0.0 equals 0.0, so the minimum of the two would be whichever came first, and the bytes
of the tree would depend on how many workers shared the work.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .simd import centroid_of, empty_box, load_row, store_row, unite

# Lanes of a record, of a bin and of any other box in the builder.
PRIM_ID = 3
NEGATED_MAX = 4
PADDING = 7


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
        corner_a, corner_b, corner_c = faces[prim, 0], faces[prim, 1], faces[prim, 2]
        for axis in range(3):
            a = vertices[corner_a, axis]
            b = vertices[corner_b, axis]
            c = vertices[corner_c, axis]
            # -0.0 + 0.0 and 0.0 - 0.0 are 0.0.
            records[prim, axis] = min(a, b, c) + np.float32(0.0)
            records[prim, NEGATED_MAX + axis] = np.float32(0.0) - max(a, b, c)
        record_ids[prim, PRIM_ID] = prim
        record_ids[prim, PADDING] = 0
        record = load_row(records, prim)
        box = unite(record, box)
        centroid_box = unite(centroid_of(record), centroid_box)
    store_row(bounds, 0, box)
    store_row(bounds, 1, centroid_box)
