"""What trimesh calls nearest: the face that faces a point most directly, and the nearest vertex.

For most points outside a mesh, the closest point is on an edge or a vertex, which belongs to several faces. The device
returns the face with the smallest number. trimesh returns the face whose normal points to the point most directly, and
this module chooses the same.

The closest point of the surface does not tell the nearest vertex, which may belong to another face. A k-d tree of the
vertices would be a second tree; the boxes of the first one hold the vertices as well.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...geometry import Mesh
from ...geometry.smooth_normals import VertexFaces
from ...structs import NO_PRIM, NODE_LANES, NODE_MAX
from ...support.compiled import compiled
from ...support.host_threads import HostThreads
from ...trace.points.refine import ClosestPoints, closest_on_triangle

# Squared distances are equal when they differ by less than this share: a thousand roundings of float64.
_ROUNDING = 2.0**-42

# Largest tolerance of squared distances, as a share of them: next to the surface, the tolerance that trimesh adds to
# squares would return points that are not the closest.
_LARGEST_SHARE = 2.0**-20

# Cosines are equal when they differ by less than this: those of coplanar faces differ by roundings.
_SAME_COSINE = 2.0**-42

# Farther away than this many times half the mesh's size, the faces around differ by less than rounding, and a point
# keeps its face; and the vertices do, so the nearest one is found from that distance.
_FAR_SHARE = 2.0**20


def choose_facing(
    points: NDArray[np.float64], mesh: Mesh, around: VertexFaces, tolerance: float, closest: ClosestPoints
) -> None:
    """Replace each face by the one that faces the point most directly, among equally near ones around it.

    Parameters
    ----------
    points : (n, 3) float64, contiguous, the file's coordinates
    mesh : Mesh
    around : VertexFaces
        Of the mesh.
    tolerance : float, the file's unit squared
        Squared distances that differ by less are equal; points as near as this to the surface keep their faces.
    closest : ClosestPoints of the points, contiguous, written
        With the point and the distance of the face that is chosen.

    Notes
    -----
    Candidates are the faces that share a vertex with the face that was found. A nearer one replaces it, too, because
    the device chooses in float32. Of equally direct ones, the smallest number wins.
    """
    triangles = mesh.vertices, mesh.faces, mesh.scale

    def choose(begin: int, end: int) -> None:
        distance, point, prim_id = closest
        part = ClosestPoints(distance[begin:end], point[begin:end], prim_id[begin:end])
        _choose(points[begin:end], triangles, mesh.origin, around, tolerance, part)

    with HostThreads() as threads:
        threads.for_ranges(len(points), choose)


@compiled(error_model="numpy")
def _choose(points, triangles, centre, around, tolerance, closest):
    vertices, faces, scale = triangles
    a, b, c, weights = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for index in range(len(points)):
        own, point = closest.prim_id[index], points[index]
        is_far = False
        for axis in range(3):
            is_far |= not abs((point[axis] - centre[axis]) * scale) < _FAR_SHARE
        if own == NO_PRIM or is_far:
            continue
        least = _see(point, triangles, own, a, b, c, weights)
        if least <= tolerance * scale * scale:
            continue
        equal = max(min(tolerance * scale * scale, least * _LARGEST_SHARE), least * _ROUNDING)
        best, facing = own, _facing(a, b, c, weights, least)
        for corner in range(3):
            point_id = around.point_ids[faces[own, corner]]
            for slot in range(around.begin[point_id], around.begin[point_id + 1]):
                face = around.faces[slot]
                if face == own:
                    continue
                squared = _see(point, triangles, face, a, b, c, weights)
                if not squared < least + equal:
                    continue
                other = _facing(a, b, c, weights, squared)
                is_nearer = squared <= least - equal
                is_equal = abs(other - facing) <= _SAME_COSINE and face < best
                if is_nearer or is_equal or other > facing + _SAME_COSINE:
                    best, facing, least = face, other, min(least, squared)
        if best == own:
            continue
        squared = _see(point, triangles, best, a, b, c, weights)
        closest.prim_id[index], closest.distance[index] = best, np.sqrt(squared) / scale
        first, second, third = faces[best, 0], faces[best, 1], faces[best, 2]
        for axis in range(3):
            origin = vertices[first, axis]
            to_second, to_third = vertices[second, axis] - origin, vertices[third, axis] - origin
            closest.point[index, axis] = origin + (weights[1] * to_second + weights[2] * to_third)


@compiled(error_model="numpy")
def _see(point, triangles, face, a, b, c, weights):
    """Write the corners as seen from a point, and the closest point's weights; return its squared distance, scaled."""
    vertices, faces, scale = triangles
    for axis in range(3):
        a[axis] = (vertices[faces[face, 0], axis] - point[axis]) * scale
        b[axis] = (vertices[faces[face, 1], axis] - point[axis]) * scale
        c[axis] = (vertices[faces[face, 2], axis] - point[axis]) * scale
    return closest_on_triangle(a, b, c, weights)


@compiled(error_model="numpy")
def _facing(a, b, c, weights, squared):
    """Return the cosine between the normal and the way to the point; -2 for a triangle without a normal."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = aby * acz - abz * acy, abz * acx - abx * acz, abx * acy - aby * acx
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if not length > 0.0:
        return -2.0
    along = 0.0
    for axis, component in enumerate((nx, ny, nz)):
        along -= component * (weights[0] * a[axis] + weights[1] * b[axis] + weights[2] * c[axis])
    return along / (length * np.sqrt(squared))


# Boxes hold the vertices as float32 has them: a vertex of the file is this far outside at most, in local units, where
# no coordinate is above 1.
_BOX_SLACK = 2.0**-23


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
    tree = nodes.view(np.float32).reshape(-1, NODE_LANES), nodes["first"], nodes["count"], bvh.prim_ids
    triangles, vertex_id = (mesh.vertices, mesh.faces, mesh.scale), np.empty(len(points), np.int64)

    def find(begin: int, end: int) -> None:
        _find(points[begin:end], mesh.origin, triangles, tree, bvh.depth, loose, vertex_id[begin:end])

    with HostThreads() as threads:
        threads.for_ranges(len(points), find)
    x, y, z = (mesh.vertices[vertex_id] - points).T
    # Squares may overflow or underflow float64.
    return np.hypot(np.hypot(x, y), z), vertex_id


@compiled(error_model="numpy")
def _find(points, centre, triangles, tree, depth, loose, vertex_id):
    vertices, faces, scale = triangles
    boxes, first, count, prim_ids = tree
    local = np.empty(3)
    # A descent leaves one sibling behind at each level.
    stack, stack_near = np.empty(depth + 2, np.int64), np.empty(depth + 2)
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
