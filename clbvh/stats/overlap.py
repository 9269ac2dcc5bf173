"""End-point overlap: the share of the surface that lies in boxes of nodes which do not hold it.

A ray that ends on a surface must visit every node whose box holds the end point, even if the subtree does not hold the
triangle that is hit. The measure sums these visits up, and explains differences between trees of equal SAH cost
(Aila, Karras and Laine, "On quality metrics of bounding volume hierarchies", HPG 2013).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..bvh.bvh import Bvh
from ..errors import ConfigError
from ..structs import NODE_COUNT, NODE_FIRST, NODE_LANES, NODE_MAX
from ..support.compiled import compiled

# A triangle that is clipped by six planes gains at most one vertex from each plane.
_MAX_VERTICES = 9


class Overlap(NamedTuple):
    """The end-point overlap of a tree.

    Attributes
    ----------
    epo : float
        Expected cost of the needless node visits at the end of a ray, whose end points are uniform over the surface.
    triangle_count : int
        The number of triangles measured: all of them, or a sample.
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
        Measure on this many triangles, spread evenly over the order of the leaves, instead of on all.

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
    The sum over all nodes of the area of the surface inside the node's box that does not belong to its subtree, times
    the node's cost, divided by the area of the whole surface. Boxes are closed: a triangle in the face of a box lies
    inside. Where triangles coincide, each counts.

    The area is exact up to rounding in float64, because triangles are clipped to the boxes. Each triangle descends the
    tree and is clipped on its way, so the time is proportional to the number of overlaps, not to nodes times
    triangles. Deterministic.
    """
    if sample is not None and sample < 1:
        raise ConfigError(f"a sample must have at least 1 triangle, not {sample}")
    prim_count = len(bvh.prim_ids)
    sample_count = prim_count if sample is None else min(sample, prim_count)
    # The middles of equal intervals: all slots of prim_ids where the sample is the whole.
    slots = ((2 * np.arange(sample_count) + 1) * prim_count) // (2 * sample_count)

    nodes = np.ascontiguousarray(bvh.nodes).view(np.float32).reshape(-1, NODE_LANES)
    count = bvh.nodes["count"]
    costs = np.where(count > 0, count * float(intersection_cost), float(traversal_cost))
    overlap, area = _sum_overlaps(
        bvh.mesh.local_vertices, bvh.mesh.faces, bvh.prim_ids, slots, nodes, nodes.view(np.int32), costs, bvh.depth
    )
    return Overlap(float(overlap / area) if area > 0 else 0.0, sample_count)


@compiled
def _sum_overlaps(vertices, faces, prim_ids, slots, nodes, node_ints, costs, depth):
    """Return the summed costs times areas of the overlaps of some triangles, and the triangles' own area.

    Parameters
    ----------
    vertices, faces, prim_ids
        Of the mesh and of the tree.
    slots : (n,) int64
        The triangles, by their slots in `prim_ids`.
    nodes, node_ints : (N, 8) float32 and int32, the same memory
    costs : (N,) float64
        Of a visit to each node.
    depth : int
        Of the tree.
    """
    parents, owners = _find_owners(node_ints)
    # The last leaf whose triangle each node was found to hold: a node that holds the triangle is no overlap.
    held_leaf = np.full(len(nodes), -1, np.int64)

    # Nodes that overlap or hold the triangle, and the part of the triangle inside their boxes.
    stack_nodes = np.empty(depth + 2, np.int64)
    stack_sizes = np.empty(depth + 2, np.int64)
    stack_polygons = np.empty((depth + 2, _MAX_VERTICES, 3), np.float64)
    polygon = np.empty((_MAX_VERTICES, 3), np.float64)
    clipped = np.empty((2, _MAX_VERTICES, 3), np.float64)

    overlap, total_area = 0.0, 0.0
    for slot in slots:
        for corner in range(3):
            vertex = faces[prim_ids[slot], corner]
            for axis in range(3):
                polygon[corner, axis] = vertices[vertex, axis]
        area = _measure_area(polygon, 3)
        total_area += area
        if area == 0:
            continue
        leaf = owners[slot]
        node = leaf
        while node >= 0 and held_leaf[node] != leaf:
            held_leaf[node] = leaf
            node = parents[node]
        if node_ints[0, NODE_COUNT] > 0:
            continue  # the root is the only node, and holds every triangle

        stack_nodes[0], stack_sizes[0] = 0, 3
        _copy(polygon, 3, stack_polygons[0])
        stack_size = 1
        while stack_size > 0:
            stack_size -= 1
            size = stack_sizes[stack_size]
            _copy(stack_polygons[stack_size], size, polygon)
            first = node_ints[stack_nodes[stack_size], NODE_FIRST]
            for node in range(first, first + 2):
                if held_leaf[node] == leaf:
                    part, part_size = polygon, size
                else:
                    side, part_size = _clip(polygon, size, nodes, node, clipped)
                    part = clipped[side]
                    area = _measure_area(part, part_size)
                    if area == 0:
                        continue
                    overlap += costs[node] * area
                if node_ints[node, NODE_COUNT] == 0:
                    stack_nodes[stack_size], stack_sizes[stack_size] = node, part_size
                    _copy(part, part_size, stack_polygons[stack_size])
                    stack_size += 1
    return overlap, total_area


@compiled
def _copy(polygon, size, target):
    """Copy the first `size` vertices. As loops: numba takes seconds to compile an assignment to a slice."""
    for corner in range(size):
        for axis in range(3):
            target[corner, axis] = polygon[corner, axis]


@compiled
def _find_owners(node_ints):
    """Return the parent of each node, -1 for the root, and the leaf that owns each slot of `prim_ids`."""
    parents = np.full(len(node_ints), -1, np.int64)
    owners = np.empty(node_ints[:, NODE_COUNT].sum(), np.int64)
    for node in range(len(node_ints)):
        first, count = node_ints[node, NODE_FIRST], node_ints[node, NODE_COUNT]
        if count == 0:
            parents[first] = parents[first + 1] = node
        for slot in range(first, first + count):
            owners[slot] = node
    return parents, owners


@compiled
def _measure_area(polygon, size):
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


@compiled
def _clip(polygon, size, nodes, node, clipped):
    """Clip a polygon to a node's box (Sutherland and Hodgman, "Reentrant polygon clipping", 1974).

    Parameters
    ----------
    polygon : (9, 3) float64
        Its first `size` vertices; not modified.
    nodes : (N, 8) float32
    node : int
    clipped : (2, 9, 3) float64, written
        Two polygons: one is read while the other is written.

    Returns
    -------
    side, size : int
        The result is the first `size` vertices of ``clipped[side]``.
    """
    # Most polygons miss the box, which their bounds tell.
    for axis in range(3):
        low = high = polygon[0, axis]
        for corner in range(1, size):
            low = min(low, polygon[corner, axis])
            high = max(high, polygon[corner, axis])
        if low > nodes[node, NODE_MAX + axis] or high < nodes[node, axis]:
            return 0, 0
    side = 0
    _copy(polygon, size, clipped[0])
    for axis in range(3):
        for is_upper in range(2):
            # Inside is where sign * coordinate <= sign * plane.
            sign = 2.0 * is_upper - 1.0
            plane = sign * nodes[node, NODE_MAX * is_upper + axis]
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
