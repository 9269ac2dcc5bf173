"""The vertex nearest to each point: a traversal of the tree on the host, exact in float64.

The closest point of the surface does not tell it: the nearest vertex may belong to another face. A k-d tree of the
vertices would be a second tree; the boxes of the first one hold the vertices as well.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...structs import NODE_LANES, NODE_MAX
from ...support.compiled import compiled
from ...support.host_threads import HostThreads
from ..triangles import triangles_of

# Boxes hold the vertices as float32 has them: a vertex of the file is this far outside at most, in local units, where
# no coordinate is above 1.
_BOX_SLACK = 2.0**-23

# A point farther away than this many times half the mesh's size is moved to that distance, towards the centre: beyond
# it, float64 would round the differences to the vertices more than the move changes.
_FAR_SHARE = 2.0**20


class _Tree(NamedTuple):
    """The arrays of a tree that a descent on the host reads."""

    boxes: NDArray[np.float32]
    first: NDArray[np.int32]
    counts: NDArray[np.int32]
    prim_ids: NDArray[np.int32]
    depth: int


def find_nearest_vertices(bvh: Bvh, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the distance to the nearest vertex of a tree's mesh, and its index, for each point.

    Parameters
    ----------
    bvh : Bvh
    points : (n, 3) float64, the file's coordinates
        Finite.

    Returns
    -------
    distance : (n,) float64, the file's unit
    vertex_id : (n,) int64
        At equal distance the smallest. Vertices without a face count, too; each of them is compared.
    """
    mesh, nodes = bvh.mesh, bvh.nodes
    points = np.ascontiguousarray(points, np.float64)
    loose = mesh.loose_vertices
    lanes: NDArray[Any] = nodes.view(np.float32).reshape(-1, NODE_LANES)
    tree = _Tree(lanes, nodes["first"], nodes["count"], bvh.prim_ids, bvh.depth)
    vertex_id = np.empty(len(points), np.int64)

    def find(begin: int, end: int) -> None:
        _find(points[begin:end], mesh.origin, triangles_of(mesh), tree, loose, vertex_id[begin:end])

    with HostThreads() as threads:
        threads.for_ranges(len(points), find)
    return _lengths(mesh.vertices[vertex_id] - points), vertex_id


def _lengths(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lengths of vectors, whose squares may overflow or underflow float64."""
    largest = np.abs(vectors).max(axis=1, initial=0.0)
    exponents = np.array([math.frexp(value)[1] for value in largest]) if _is_extreme(largest) else 0
    return np.ldexp(np.linalg.norm(np.ldexp(vectors, -np.reshape(exponents, (-1, 1))), axis=1), exponents)


def _is_extreme(lengths: NDArray[np.float64]) -> bool:
    """Return whether the square of a length is no normal float64."""
    some = lengths[lengths > 0]
    return len(some) > 0 and bool(some.max() > 1e150 or some.min() < 1e-150)


@compiled(error_model="numpy")
def _find(points, centre, triangles, tree, loose, vertex_id):
    vertices, faces, scale = triangles.vertices, triangles.faces, triangles.scale
    boxes, first, count, prim_ids = tree.boxes, tree.first, tree.counts, tree.prim_ids
    local = np.empty(3)
    # A descent leaves one sibling behind at each level.
    stack, stack_near = np.empty(tree.depth + 2, np.int64), np.empty(tree.depth + 2)
    for index in range(len(points)):
        size = 0.0
        for axis in range(3):
            local[axis] = (points[index, axis] - centre[axis]) * scale
            size = max(size, abs(local[axis]))
        share = _FAR_SHARE / size if size > _FAR_SHARE else 1.0
        for axis in range(3):
            local[axis] *= share
        # Boxes farther away than this hold no nearer vertex.
        best, nearest, limit = np.inf, -1, np.inf
        for vertex in loose:
            best, nearest = _nearer(vertices, vertex, centre, scale, local, best, nearest)
        limit = np.sqrt(best) + _BOX_SLACK
        stack[0], stack_near[0], height = 0, 0.0, 1
        while height > 0:
            height -= 1
            node = stack[height]
            if stack_near[height] > limit:
                continue
            if count[node] > 0:
                for slot in range(first[node], first[node] + count[node]):
                    for corner in range(3):
                        vertex = faces[prim_ids[slot], corner]
                        best, nearest = _nearer(vertices, vertex, centre, scale, local, best, nearest)
                limit = np.sqrt(best) + _BOX_SLACK
                continue
            left, right = first[node], first[node] + 1
            left_near, right_near = _box_distance(boxes, left, local), _box_distance(boxes, right, local)
            if left_near < right_near:
                left, right, left_near, right_near = right, left, right_near, left_near
            # The nearer one is on top.
            stack[height], stack_near[height] = left, left_near
            stack[height + 1], stack_near[height + 1] = right, right_near
            height += 2
        vertex_id[index] = nearest


@compiled(error_model="numpy")
def _nearer(vertices, vertex, centre, scale, local, best, nearest):
    """Return the smaller squared distance, and its vertex."""
    squared = 0.0
    for axis in range(3):
        away = (vertices[vertex, axis] - centre[axis]) * scale - local[axis]
        squared += away * away
    if squared < best or (squared == best and vertex < nearest):
        return squared, vertex
    return best, nearest


@compiled(error_model="numpy")
def _box_distance(boxes, node, local):
    """Return the distance from a point to a node's box."""
    squared = 0.0
    for axis in range(3):
        lower, upper = np.float64(boxes[node, axis]), np.float64(boxes[node, NODE_MAX + axis])
        away = max(lower - local[axis], local[axis] - upper, 0.0)
        squared += away * away
    return np.sqrt(squared)
