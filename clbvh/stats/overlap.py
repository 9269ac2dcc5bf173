"""End-point overlap: how much of the surface lies in boxes of nodes that have nothing to do with it.

A ray that ends on a surface must visit every node whose box holds the end point, also those whose subtree does not
have the triangle that it hits. The measure sums up just this, and explains differences between trees of equal SAH cost
(Aila, Karras and Laine, "On quality metrics of bounding volume hierarchies", HPG 2013).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ..errors import ConfigError
from ..layout import NODE_COUNT, NODE_FIRST, NODE_LANES, NODE_MAX
from .bvh import Bvh

# A triangle that is clipped by six planes gains at most one vertex from each.
_MAX_VERTICES = 9


@dataclass(frozen=True)
class Overlap:
    """The end-point overlap of a tree.

    Attributes
    ----------
    epo : float
        Expected cost of the needless node visits at the end of a ray that ends anywhere on the surface, each place
        being as likely as any other.
    triangle_count : int
        Triangles that were measured: all of them, or a sample.
    """

    epo: float
    triangle_count: int


def measure_overlap(
    bvh: Bvh,
    *,
    traversal_cost: float = 1.0,
    intersection_cost: float = 1.0,
    sample: int | None = None,
) -> Overlap:
    """Measure the end-point overlap (EPO) of a tree.

    Parameters
    ----------
    bvh : Bvh
    traversal_cost : float
        Cost of an interior node; the paper's is 1.2.
    intersection_cost : float
        Cost of one triangle test.
    sample : int, optional
        Measure on this many triangles, evenly spread over the order of the leaves, instead of on all.

    Returns
    -------
    Overlap
        Its `epo` is 0 for a surface without area.

    Raises
    ------
    ConfigError
        A sample of less than one triangle.

    Notes
    -----
    For each node, the area of the surface inside its box that does not belong to its subtree, times the node's cost,
    summed up over all nodes and divided by the area of the whole surface. Boxes are closed: a triangle in the face of
    a box lies inside. Where triangles are folded onto each other, each counts.

    The area is exact up to rounding in float64, because triangles are clipped to the boxes. Each triangle goes down
    the tree and is clipped further on its way, so the time is proportional to the overlaps there are, and not to nodes
    times triangles. Deterministic.
    """
    if sample is not None and sample < 1:
        raise ConfigError(f"a sample must have at least 1 triangle, not {sample}")
    place_count = len(bvh.prim_ids)
    sample_count = place_count if sample is None else min(sample, place_count)
    # The middles of equal intervals: all places, when the sample is the whole.
    places = ((2 * np.arange(sample_count) + 1) * place_count) // (2 * sample_count)

    rows = np.ascontiguousarray(bvh.nodes).view(np.float32).reshape(-1, NODE_LANES)
    count = bvh.nodes["count"]
    costs = np.where(count > 0, count * float(intersection_cost), float(traversal_cost))
    overlap, area = _sum_overlaps(
        bvh.mesh.vertices, bvh.mesh.faces, bvh.prim_ids, places, rows, rows.view(np.int32), costs, bvh.depth
    )
    return Overlap(float(overlap / area) if area > 0 else 0.0, sample_count)


@njit(cache=True, nogil=True)
def _sum_overlaps(  # type: ignore[no-untyped-def]
    vertices, faces, prim_ids, places, rows, row_ints, costs, depth
):
    """Return the summed costs times areas of the overlaps of some triangles, and the triangles' own area.

    Parameters
    ----------
    vertices, faces, prim_ids
        Of the mesh and of the tree.
    places : (n,) int64
        Where the triangles stand in `prim_ids`.
    rows, row_ints : (N, 8) float32 and int32
        The nodes.
    costs : (N,) float64
        Of a visit to each node.
    depth : int
        Of the tree.
    """
    parents, owners = _find_owners(row_ints)
    # owned_by[row] is the leaf at hand for all nodes above it: they have the triangle, so they are no overlap.
    owned_by = np.full(len(rows), -1, np.int64)

    # What waits: a node that the triangle is in or that has it, and the part of the triangle that is inside.
    waiting_rows = np.empty(depth + 2, np.int64)
    waiting_sizes = np.empty(depth + 2, np.int64)
    waiting = np.empty((depth + 2, _MAX_VERTICES, 3), np.float64)
    polygon = np.empty((_MAX_VERTICES, 3), np.float64)
    clipped = np.empty((2, _MAX_VERTICES, 3), np.float64)

    overlap, total_area = 0.0, 0.0
    for number in range(len(places)):
        for corner in range(3):
            polygon[corner] = vertices[faces[prim_ids[places[number]], corner]]
        area = _measure_area(polygon, 3)
        total_area += area
        if area == 0:
            continue
        leaf = owners[places[number]]
        row = leaf
        while row >= 0 and owned_by[row] != leaf:
            owned_by[row] = leaf
            row = parents[row]
        if row_ints[0, NODE_COUNT] > 0:
            continue  # the root is the only node, and has everything

        waiting_rows[0], waiting_sizes[0] = 0, 3
        waiting[0] = polygon
        waiting_count = 1
        while waiting_count > 0:
            waiting_count -= 1
            size = waiting_sizes[waiting_count]
            polygon[:size] = waiting[waiting_count, :size]
            first = row_ints[waiting_rows[waiting_count], NODE_FIRST]
            for row in range(first, first + 2):
                if owned_by[row] == leaf:
                    part, part_size = polygon, size
                else:
                    side, part_size = _clip(polygon, size, rows, row, clipped)
                    part = clipped[side]
                    area = _measure_area(part, part_size)
                    if area == 0:
                        continue
                    overlap += costs[row] * area
                if row_ints[row, NODE_COUNT] == 0:
                    waiting_rows[waiting_count], waiting_sizes[waiting_count] = row, part_size
                    waiting[waiting_count, :part_size] = part[:part_size]
                    waiting_count += 1
    return overlap, total_area


@njit(cache=True, nogil=True)
def _find_owners(row_ints):  # type: ignore[no-untyped-def]
    """Return the parent of each row, -1 for the root, and the leaf of each place in the order of the leaves."""
    parents = np.full(len(row_ints), -1, np.int64)
    place_count = 0
    for row in range(len(row_ints)):
        place_count += row_ints[row, NODE_COUNT]
    owners = np.empty(place_count, np.int64)
    for row in range(len(row_ints)):
        first, count = row_ints[row, NODE_FIRST], row_ints[row, NODE_COUNT]
        if count == 0:
            parents[first] = parents[first + 1] = row
        owners[first : first + count] = row
    return parents, owners


@njit(cache=True, nogil=True)
def _measure_area(polygon, size):  # type: ignore[no-untyped-def]
    """Return the area of a plane, convex polygon; 0 for fewer than three vertices."""
    x = y = z = 0.0
    for corner in range(1, size - 1):
        ax = polygon[corner, 0] - polygon[0, 0]
        ay = polygon[corner, 1] - polygon[0, 1]
        az = polygon[corner, 2] - polygon[0, 2]
        bx = polygon[corner + 1, 0] - polygon[0, 0]
        by = polygon[corner + 1, 1] - polygon[0, 1]
        bz = polygon[corner + 1, 2] - polygon[0, 2]
        x += ay * bz - az * by
        y += az * bx - ax * bz
        z += ax * by - ay * bx
    return 0.5 * np.sqrt(x * x + y * y + z * z)


@njit(cache=True, nogil=True)
def _clip(polygon, size, rows, row, clipped):  # type: ignore[no-untyped-def]
    """Cut off what lies outside a node's box (Sutherland and Hodgman, "Reentrant polygon clipping", 1974).

    Parameters
    ----------
    polygon : (9, 3) float64
        Its first `size` vertices; not modified.
    rows : (N, 8) float32
    row : int
        The node.
    clipped : (2, 9, 3) float64, written
        Two polygons, of which one is read while the other is written.

    Returns
    -------
    side, size : int
        The result is the first `size` vertices of ``clipped[side]``.
    """
    # Most polygons miss the box, or lie in it along most axes: look at the bounds first.
    for axis in range(3):
        low = high = polygon[0, axis]
        for corner in range(1, size):
            low = min(low, polygon[corner, axis])
            high = max(high, polygon[corner, axis])
        if low > rows[row, NODE_MAX + axis] or high < rows[row, axis]:
            return 0, 0
    side = 0
    clipped[0, :size] = polygon[:size]
    for axis in range(3):
        for is_upper in range(2):
            # Inside is where sign * coordinate <= sign * plane.
            sign = 2.0 * is_upper - 1.0
            plane = sign * rows[row, NODE_MAX * is_upper + axis]
            source, target = clipped[side], clipped[1 - side]
            is_cut = False
            for corner in range(size):
                is_cut |= sign * source[corner, axis] > plane
            if not is_cut:
                continue
            target_size = 0
            for corner in range(size):
                following = corner + 1 if corner + 1 < size else 0
                here = sign * source[corner, axis] - plane
                there = sign * source[following, axis] - plane
                if here <= 0:
                    target[target_size] = source[corner]
                    target_size += 1
                if (here < 0 < there) or (there < 0 < here):
                    share = here / (here - there)
                    for other in range(3):
                        target[target_size, other] = source[corner, other] + share * (
                            source[following, other] - source[corner, other]
                        )
                    target[target_size, axis] = sign * plane
                    target_size += 1
            side, size = 1 - side, target_size
            if size < 3:
                return side, 0
    return side, size
