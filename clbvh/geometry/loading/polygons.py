"""Polygons become triangles: fans where these cover the polygon, cut ears where a fan would reach out of it.

All polygons of a file are looked at together, in blocks that stay in the cache. Only concave ones pay for more.

G. H. Meisters, "Polygons have ears", 1975.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ..mesh import check_face_count
from .file_mesh import Problems

# Quads that are looked at together. Of 2^11 to 2^14, the middle two take least.
_BLOCK_QUADS = 1 << 12
# Corners of larger polygons; a corner takes about 500 bytes.
_BLOCK_CORNERS = 1 << 18
# Corners that are tested against ears at once; a pair takes about 200 bytes.
_BLOCK_PAIRS = 1 << 18
# Of all corners at a time, which takes half a minute. A coast of a million corners has 2 pairs of each, stripes have 1;
# 100,000 corners at random have as many as this.
_MOST_PAIRS = 1 << 28
# Of a polygon's area: a triangle that faces away by less is flat but for rounding.
_ROUNDING = 1e-12

# Of a polygon without ears, corners within this part of it are cut at a time.
_CAUTION = 64

# How good it is to cut off a corner, best first. Spikes, where an edge turns back or has no length, and flat corners
# make degenerate triangles; spikes that stay let corners look convex that are not. An ear that another corner touches
# leaves that one on an edge. The last two are for polygons that cross themselves.
_SPIKE, _EAR, _TOUCHED, _FLAT, _BLOCKED, _REFLEX = range(6)


def count_triangles(sizes: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the number of triangles of each polygon, (p,), of its number of corners."""
    return np.maximum(sizes.astype(np.int64) - 2, 0)


def report_edges(sizes: NDArray[np.integer], problems: Problems) -> None:
    """Say how many polygons of these numbers of corners have no triangle."""
    if edge_count := np.count_nonzero(sizes < 3):
        problems.add(f"{edge_count:,} of {len(sizes):,} faces have fewer than three corners, and are left out")


def cut_fans(corners: NDArray[np.integer], sizes: NDArray[np.integer]) -> NDArray[np.integer]:
    """Cut polygons into fans around their first corners.

    A fan covers a convex polygon exactly, and reaches out of most concave ones.

    Parameters
    ----------
    corners : (n,) int
        Vertex indices of all polygons, concatenated.
    sizes : (p,) int
        Corners per polygon.

    Returns
    -------
    (F, 3) int
        Triangles in the order of the polygons, with their winding. Polygons with fewer than three corners have none.

    Raises
    ------
    MeshError
        The triangles do not fit the memory: a large polygon has hardly more corners than triangles, and a corner may
        be one byte of a file.
    """
    return corners.reshape(-1, 3) if (sizes == 3).all() else corners[_find_fans(sizes)]


def cut_polygons(
    corners: NDArray[np.integer],
    sizes: NDArray[np.integer],
    vertex_ids: NDArray[np.integer],
    vertices: NDArray[np.number],
) -> NDArray[np.integer]:
    """Cut polygons into triangles that cover them: fans, or ears where a fan would reach out.

    A polygon that is not flat is cut as its projection along the axis that it faces. One that crosses itself has no
    right answer, and one that touches itself has, as has one whose hole is reached by an edge there and back.

    Parameters
    ----------
    corners : (n,) int
        Values of the corners of all polygons, concatenated: what the triangles shall have.
    sizes : (p,) int
        Corners per polygon.
    vertex_ids : (n,) int
        The vertex of each corner.
    vertices : (V, 3) number
        Of any other number of axes, not finite, or fewer than the corners name: the caller refuses them later.

    Returns
    -------
    (F, 3) int
        As of `cut_fans`; of a polygon that its fan covers, exactly those.

    Raises
    ------
    MeshError
        The triangles do not fit the memory, or a polygon of 100,000 corners or more is too tangled.

    Notes
    -----
    On two x86-64 cores, a million convex quads take 0.06 s more than their fans, 100,000 concave polygons of six
    corners 1.3 s, and a coast of 100,000 corners 0.4 s. A polygon of n corners needs O(n) for each round of cuts. These
    are few, but n / 2 where hardly any corner is an ear at a time: a square spiral of 4,000 corners takes 2 s.
    """
    if (sizes == 3).all():
        return corners.reshape(-1, 3)
    slots = _find_fans(sizes)
    in_range = len(vertex_ids) > 0 and 0 <= vertex_ids.min() <= vertex_ids.max() < len(vertices)
    if in_range and vertices.shape[1] == 3:
        begins = np.cumsum(sizes) - sizes
        with np.errstate(over="ignore", invalid="ignore"):
            doubtful = _find_doubtful(begins, sizes, vertex_ids, vertices)
            for block in _split(doubtful, sizes[doubtful], _BLOCK_CORNERS):
                _replace_fans(slots, block, begins, sizes, vertex_ids, vertices)
    return corners[slots]


def _find_fans(sizes: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return the corners of fans, (F, 3), as their positions among those of all polygons."""
    triangle_counts = count_triangles(sizes)
    check_face_count(int(triangle_counts.sum()))
    # Triangle k of a polygon has its corners 0, k + 1 and k + 2.
    first = np.repeat(np.cumsum(sizes) - sizes, triangle_counts)
    step = np.arange(len(first)) - np.repeat(np.cumsum(triangle_counts) - triangle_counts, triangle_counts)
    return np.column_stack((first, first + step + 1, first + step + 2))


def _find_doubtful(
    begins: NDArray[np.integer],
    sizes: NDArray[np.integer],
    vertex_ids: NDArray[np.integer],
    vertices: NDArray[np.number],
) -> NDArray[np.int64]:
    """Return the polygons that a fan may reach out of: quads with two triangles that do not face one side, and larger.

    Nearly all polygons of files are quads, and most of these are convex.
    """
    axes = np.ascontiguousarray(vertices.T, np.float64)
    quads = np.flatnonzero(sizes == 4)
    doubtful = [np.flatnonzero(sizes > 4)]
    for begin in range(0, len(quads), _BLOCK_QUADS):
        block = quads[begin : begin + _BLOCK_QUADS]
        a, b, c, d = (np.take(axes, vertex_ids[begins[block] + side], axis=1) for side in range(4))
        (x, y, z), (u, v, w) = _cross(b - a, c - a), _cross(c - a, d - a)
        doubtful.append(block[~(x * u + y * v + z * w > 0)])
    return np.sort(np.concatenate(doubtful))


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Return the three axes of the cross products of vectors, (3, n): `numpy.cross` takes three times as long."""
    (ax, ay, az), (bx, by, bz) = a, b
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


def _split(values: NDArray[np.int64], weights: NDArray[np.integer], most: int) -> list[NDArray[np.int64]]:
    """Return values in pieces of about the same weight, none of them empty."""
    ends = np.cumsum(weights)
    pieces = np.split(values, np.searchsorted(ends, np.arange(most, weights.sum(), most)))
    return [piece for piece in pieces if len(piece)]


def _replace_fans(
    slots: NDArray[np.int64],
    polygons: NDArray[np.int64],
    begins: NDArray[np.integer],
    sizes: NDArray[np.integer],
    vertex_ids: NDArray[np.integer],
    vertices: NDArray[np.number],
) -> None:
    """Write ears over the fans of those of some polygons that the fans reach out of."""
    # Corners relative to the first one of their polygon, and of a size near 1: areas have no overflow.
    counts = sizes[polygons]
    first = np.cumsum(counts) - counts
    corners = np.arange(counts.sum()) + np.repeat(begins[polygons] - first, counts)
    points = np.take(vertices, vertex_ids[corners], axis=0).astype(np.float64)
    points -= np.repeat(points[first], counts, axis=0)
    exponents = np.frexp(np.maximum.reduceat(np.abs(points).max(axis=1), first))[1]
    points = np.ldexp(points, -np.repeat(exponents, counts)[:, None])
    # The polygon in the plane of the two axes that it faces least, counterclockwise: no coordinate is rounded.
    normals = np.add.reduceat(np.stack(_cross(points.T, np.roll(points.T, -1, axis=1))), first, axis=1)
    axis = np.abs(normals).argmax(axis=0)
    area = normals[axis, np.arange(len(axis))]
    axes = np.repeat(np.where(area > 0, [axis + 1, axis + 2], [axis + 2, axis + 1]) % 3, counts, axis=1)
    plane = np.take_along_axis(points, axes.T, axis=1)
    # The first and the last corner of a polygon have no triangle of a fan, but an area of 0.
    fan = _turn(plane, np.roll(plane, -1, axis=0))
    is_concave = np.minimum.reduceat(fan, first) < -_ROUNDING * np.abs(area)
    inside = np.repeat(is_concave, counts)
    if inside.any():
        ears = _cut_ears(plane[inside], np.repeat(np.arange(len(counts)), counts)[inside])
        is_replaced = np.zeros(len(sizes), np.bool_)
        is_replaced[polygons[is_concave]] = True
        slots[np.repeat(is_replaced, count_triangles(sizes))] = corners[inside][ears]


def _turn(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cross products of vectors in the plane, (..., 2): positive where the second is left of the first."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _cut_ears(points: NDArray[np.float64], polygons: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cut off corners that hold no other one until nothing is left, of all polygons in turn.

    Parameters
    ----------
    points : (n, 2) float64
        Corners, counterclockwise.
    polygons : (n,) int
        The polygon of each, in ascending order.

    Returns
    -------
    (t, 3) int
        Positions of corners: two triangles fewer than a polygon has corners, in the order of the polygons.
    """
    keys = _find_keys(points, polygons)
    ranks, areas = np.zeros(len(points), np.int64), np.zeros(len(points))
    is_stale = np.ones(len(points), np.bool_)
    corners, cut = np.arange(len(points)), []
    while len(corners):
        # The corners that are left, with their neighbours.
        at = np.arange(len(corners))
        begins = np.flatnonzero(np.diff(polygons[corners], prepend=-1))
        ends = np.append(begins[1:], len(corners))
        before, after = at - 1, at + 1
        before[begins], after[ends - 1] = ends - 1, begins
        triangles = np.column_stack((corners[before], corners, corners[after]))

        # Only neighbours of what was cut have become better or worse.
        changed = triangles[is_stale[corners]]
        a, b, c = (points[changed[:, side]] for side in range(3))
        areas[changed[:, 1]] = area = _turn(b - a, c - b)
        turns_back = ((b - a) * (c - b)).sum(axis=1) <= 0
        ranks[changed[:, 1]] = np.where(area != 0, _REFLEX, np.where(turns_back, _SPIKE, _FLAT))
        others = corners[areas[corners] <= 0]
        convex = changed[area > 0]
        ranks[convex[:, 1]] = _rank_ears(convex, others[np.argsort(keys[others])], points, keys)
        is_stale[changed[:, 1]] = False

        # Of ears side by side every second one is cut, since each takes a corner of the next. Without any, so little
        # is cut that ears may show up, but enough for an end soon.
        rank, counts = ranks[corners], ends - begins
        best = np.minimum.reduceat(rank, begins)
        is_best = rank == np.repeat(best, counts)
        follows = is_best & np.append(False, is_best[:-1])
        follows[begins] = False
        is_cut = is_best & ((at - np.maximum.accumulate(np.where(follows, 0, at))) % 2 == 0)
        is_cut[ends - 1] &= ~is_cut[begins]
        first = np.minimum.reduceat(np.where(is_best, at, len(at)), begins)
        is_cut &= np.repeat(best <= _EAR, counts) | (at <= np.repeat(first + counts // _CAUTION, counts))
        cut.append(triangles[is_cut])
        is_stale[cut[-1][:, ::2]] = True

        left = counts - np.add.reduceat(is_cut, begins, dtype=np.int64)
        corners = corners[~is_cut][np.repeat(left > 2, left)]
    every = np.concatenate(cut)
    return every[np.argsort(polygons[every[:, 0]], kind="stable")]


def _find_keys(points: NDArray[np.float64], polygons: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return numbers that grow with the polygon, and in it along the axis that its edges are short on."""
    begins = np.flatnonzero(np.diff(polygons, prepend=-1))
    counts = np.diff(np.append(begins, len(points)))
    lower, upper = (end.reduceat(points, begins) for end in (np.minimum, np.maximum))
    lengths = np.add.reduceat(np.abs(points - np.roll(points, -1, axis=0)), begins)
    with np.errstate(divide="ignore", invalid="ignore"):
        axis = np.repeat((lengths / (upper - lower)).argmin(axis=1), counts)[:, None]
        shares = (points - np.repeat(lower, counts, axis=0)) / np.repeat(upper - lower, counts, axis=0)
    return 2.0 * polygons + np.take_along_axis(shares, axis, axis=1)[:, 0]


def _rank_ears(
    triangles: NDArray[np.int64], others: NDArray[np.int64], points: NDArray[np.float64], keys: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Return whether convex corners, (n, 3) with their neighbours, are ears: no other corner that is not convex is in.

    Where the boundary reaches into a triangle, the corner at which it turns back is not convex. Corners at the same
    point as one of the triangle's are none of these: there the boundary meets itself.
    """
    ranks = np.full(len(triangles), _EAR)
    of_triangles, of_others = keys[triangles], keys[others]
    begins = np.searchsorted(of_others, of_triangles.min(axis=1), "left")
    counts = np.searchsorted(of_others, of_triangles.max(axis=1), "right") - begins
    if counts.sum() > _MOST_PAIRS:
        raise MeshError(
            f"polygons of {len(triangles) + len(others):,} corners are too tangled to be cut into triangles"
        )
    lower, upper = (end(points[triangles], axis=1) for end in (np.min, np.max))
    for block in _split(np.arange(len(triangles)), counts, _BLOCK_PAIRS):
        rows = np.repeat(block, counts[block])
        steps = np.arange(len(rows)) - np.repeat(np.cumsum(counts[block]) - counts[block], counts[block])
        point = points[others[begins[rows] + steps]]
        is_near = ((point >= lower[rows]) & (point <= upper[rows])).all(axis=1)
        rows, point = rows[is_near], point[is_near]
        a, b, c = (points[triangles[rows, side]] for side in range(3))
        least = np.minimum(_turn(b - a, point - a), np.minimum(_turn(c - b, point - b), _turn(a - c, point - c)))
        is_other: Any = np.logical_and.reduce([(point != corner).any(axis=1) for corner in (a, b, c)])
        ranks[rows[is_other & (least == 0)]] = _TOUCHED
        # After the first, since a corner inside weighs more.
        ranks[rows[least > 0]] = _BLOCKED
    return ranks
