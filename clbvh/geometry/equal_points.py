"""Points with equal coordinates, in files that repeat vertices for each face."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# Odd numbers without a pattern.
_FACTORS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)


class EqualPoints(NamedTuple):
    """Groups of points whose coordinates have the same bits.

    Attributes
    ----------
    first : (P,) int64
        The first point of each group, ascending.
    ids : (n,) int64
        The group of each point.
    """

    first: NDArray[np.int64]
    ids: NDArray[np.int64]


def find_equal_points(points: NDArray[np.floating]) -> EqualPoints:
    """Find the groups of equal points among (n, 3) float32 or float64, in O(n log n).

    0.0 and -0.0 differ.
    """
    if len(points) == 0:
        return EqualPoints(np.empty(0, np.int64), np.empty(0, np.int64))
    order, is_new = _sort(np.ascontiguousarray(points).view(f"u{points.itemsize}"))
    first = np.minimum.reduceat(order, np.flatnonzero(is_new))
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    ids = np.empty(len(points), np.int64)
    ids[order] = rank[np.cumsum(is_new) - 1]
    return EqualPoints(np.sort(first), ids)


def _sort(bits: NDArray[np.unsignedinteger]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return an order in which equal rows are neighbours, and where one differs from the row before."""
    # One key is sorted ten times as fast as three.
    keys = _find_keys(bits)
    order = np.argsort(keys)
    is_new = _differ_from_before(bits[order])
    if (is_new != _differ_from_before(keys[order][:, None])).any():
        # Different points with the same key: a forged file has them, no other one does.
        order = np.lexsort(bits.T)
        is_new = _differ_from_before(bits[order])
    return order, is_new


def _find_keys(bits: NDArray[np.unsignedinteger]) -> NDArray[np.uint64]:
    wide = bits.astype(np.uint64)
    # Doubles that were floats end with zeros, which no product would mix.
    folded = wide ^ (wide >> np.uint64(32))
    return np.asarray((folded * _FACTORS).sum(axis=1, dtype=np.uint64))


def _differ_from_before(rows: NDArray[np.unsignedinteger]) -> NDArray[np.bool_]:
    is_new = np.ones(len(rows), np.bool_)
    is_new[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    return is_new


def find_points(vertices: NDArray[np.float64]) -> EqualPoints:
    """Find the vertices with equal coordinates among (V, 3), whatever the sign of their zeros."""
    return find_equal_points(vertices + 0.0)
