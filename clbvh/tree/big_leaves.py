"""Leaves that are larger than a group of triangles become subtrees of leaves that fill groups."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..layout import NODE_COUNT, NODE_FIRST, NODE_LANES, NODE_MAX
from .bvh import Bvh


def cut_big_leaves(bvh: Bvh, leaf_size: int) -> NDArray[np.float32]:
    """Return the rows of a tree whose leaves have `leaf_size` triangles at most.

    Parameters
    ----------
    bvh : Bvh
        The primitives of its leaves are cut where they stand: all but the last leaf of each are full.
    leaf_size : int

    Returns
    -------
    (N, 8) float32
        Lanes of `layout.NODE`. Children stand behind their parents, siblings together, but in no other order.
    """
    rows = np.ascontiguousarray(bvh.nodes).view(np.float32).reshape(-1, NODE_LANES)
    counts = bvh.nodes["count"]
    pieces = -(-counts[counts > leaf_size].astype(np.int64) // leaf_size)
    if len(pieces) == 0:
        return rows
    more = np.empty((len(rows) + int((2 * (pieces - 1)).sum()), NODE_LANES), np.float32)
    more[: len(rows)] = rows
    mesh = bvh.mesh
    _cut(more, more.view(np.int32), len(rows), leaf_size, bvh.prim_ids, mesh.vertices, mesh.faces)
    return more


@njit(cache=True, nogil=True)
def _cut(rows, row_ints, row_count, leaf_size, prim_ids, vertices, faces):  # type: ignore[no-untyped-def]
    row = 0
    while row < row_count:
        count = row_ints[row, NODE_COUNT]
        if count > leaf_size:
            # The left half gets whole groups; its own turn comes later.
            first = row_ints[row, NODE_FIRST]
            left_count = (count // leaf_size + (count % leaf_size > 0) + 1) // 2 * leaf_size
            _write_leaf(rows, row_ints, row_count, first, left_count, prim_ids, vertices, faces)
            _write_leaf(
                rows, row_ints, row_count + 1, first + left_count, count - left_count, prim_ids, vertices, faces
            )
            row_ints[row, NODE_FIRST] = row_count
            row_ints[row, NODE_COUNT] = 0
            row_count += 2
        row += 1


@njit(cache=True, nogil=True)
def _write_leaf(rows, row_ints, row, first, count, prim_ids, vertices, faces):  # type: ignore[no-untyped-def]
    row_ints[row, NODE_FIRST] = first
    row_ints[row, NODE_COUNT] = count
    for axis in range(3):
        least, most = np.inf, -np.inf
        for place in range(first, first + count):
            for corner in range(3):
                coordinate = vertices[faces[prim_ids[place], corner], axis]
                least, most = min(least, coordinate), max(most, coordinate)
        rows[row, axis], rows[row, NODE_MAX + axis] = least, most
