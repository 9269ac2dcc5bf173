"""Locations and normals of hits in float64, by primitive and coordinates: on a mesh, or on instances of a scene."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ...structs import NO_PRIM, PRIM_KINDS
from ...support.compiled import compiled
from ...support.host_threads import HostThreads
from .scene_arrays import SceneArrays, Triangles, place_point, triangles_of
from .spheres import sphere_point

# A normal is not used if the corners of its triangle differ by more than this in height, in local units: sixteen
# roundings of float32.
_MOST_TILT = 2.0**-20


def find_locations(
    mesh: Mesh,
    prim_id: NDArray[np.int32],
    u: NDArray[np.floating],
    v: NDArray[np.floating],
) -> NDArray[np.float64]:
    """Return (..., 3) float64, the file's coordinates: ``(1 - u - v) a + u b + v c``; NaN without a face."""
    locations = np.empty((*prim_id.shape, 3))
    flat = locations.reshape(-1, 3)
    prims = np.ascontiguousarray(prim_id).reshape(-1)
    us, vs = (np.ascontiguousarray(values, np.float64).reshape(-1) for values in (u, v))

    def locate(begin: int, end: int) -> None:
        _locate(triangles_of(mesh), prims[begin:end], us[begin:end], vs[begin:end], flat[begin:end])

    with HostThreads() as threads:
        threads.for_ranges(len(flat), locate)
    return locations


def find_normals(mesh: Mesh, prim_id: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return (..., 3) float64: unit normals on the side from which the corners run anticlockwise.

    Across its longest edge for a triangle so thin that float64 does not know its normal. NaN without a face, and for a
    triangle whose corners are one point.
    """
    normals = np.empty((*prim_id.shape, 3))
    _make_normals(triangles_of(mesh), np.ascontiguousarray(prim_id).reshape(-1), normals.reshape(-1, 3))
    return normals


@compiled
def _locate(triangles, prim_ids, us, vs, locations):
    vertices, faces = triangles.vertices, triangles.faces
    for hit in range(len(prim_ids)):
        prim, u, v = prim_ids[hit], us[hit], vs[hit]
        for axis in range(3):
            if prim == NO_PRIM:
                locations[hit, axis] = np.nan
                continue
            a = vertices[faces[prim, 0], axis]
            ab, ac = vertices[faces[prim, 1], axis] - a, vertices[faces[prim, 2], axis] - a
            locations[hit, axis] = a + (u * ab + v * ac)


@compiled
def _make_normals(triangles, prim_ids, normals):
    for hit in range(len(prim_ids)):
        if prim_ids[hit] == NO_PRIM:
            normals[hit, 0] = normals[hit, 1] = normals[hit, 2] = np.nan
        else:
            make_normal(triangles, prim_ids[hit], normals[hit])


@compiled(error_model="numpy")
def make_normal(triangles, prim, normal):
    """Write the unit normal of a triangle on the side from which its corners run anticlockwise.

    A triangle so thin that float64 does not know its normal gets a vector across its longest edge.
    """
    vertices, faces, scale = triangles.vertices, triangles.faces, triangles.scale
    a, b, c = faces[prim, 0], faces[prim, 1], faces[prim, 2]
    # Divided by its largest component first: the squares of a small triangle's normal could underflow.
    largest = 0.0
    for axis in range(3):
        following, last = (axis + 1) % 3, (axis + 2) % 3
        ab_following, ab_last = vertices[b, following] - vertices[a, following], vertices[b, last] - vertices[a, last]
        ac_following, ac_last = vertices[c, following] - vertices[a, following], vertices[c, last] - vertices[a, last]
        normal[axis] = ab_following * scale * (ac_last * scale) - ab_last * scale * (ac_following * scale)
        largest = max(largest, abs(normal[axis]))
    for axis in range(3):
        normal[axis] /= largest
    _normalize(normal)
    # Written so that NaN is a tilt.
    if not _tilt(triangles, prim, normal) <= _MOST_TILT:
        _write_across(triangles, prim, normal)


@compiled(error_model="numpy")
def _normalize(vector):
    length = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    for axis in range(3):
        vector[axis] /= length


@compiled
def _tilt(triangles, prim, normal):
    """Return how much higher one corner of a triangle is than another one along a vector, in local units."""
    vertices, faces, scale = triangles.vertices, triangles.faces, triangles.scale
    to_b, to_c = 0.0, 0.0
    for axis in range(3):
        a = vertices[faces[prim, 0], axis]
        to_b += (vertices[faces[prim, 1], axis] - a) * scale * normal[axis]
        to_c += (vertices[faces[prim, 2], axis] - a) * scale * normal[axis]
    return abs(to_b) + abs(to_c)


@compiled(error_model="numpy")
def _write_across(triangles, prim, normal):
    """Write a unit vector at right angles to the longest edge of a triangle; NaN if all edges have length zero."""
    vertices, faces = triangles.vertices, triangles.faces
    longest, edge = 0.0, np.zeros(3)
    for corner in range(3):
        begin, end = faces[prim, corner], faces[prim, (corner + 1) % 3]
        length = 0.0
        for axis in range(3):
            length = max(length, abs(vertices[end, axis] - vertices[begin, axis]))
        if length > longest:
            longest = length
            for axis in range(3):
                edge[axis] = vertices[end, axis] - vertices[begin, axis]
    # Divided by its largest component first, as the normal is.
    for axis in range(3):
        edge[axis] /= longest
    _normalize(edge)
    # The axis that is most across the edge, less its share along it.
    across = 0
    for axis in range(1, 3):
        across = axis if abs(edge[axis]) < abs(edge[across]) else across
    share = edge[across]
    for axis in range(3):
        normal[axis] = (1.0 if axis == across else 0.0) - share * edge[axis]
    _normalize(normal)


_SPHERES = PRIM_KINDS["spheres"]

# The corners of one triangle, as a mesh of its own.
_ONE_FACE = np.array([[0, 1, 2]], np.int32)


def find_placed_locations(
    arrays: SceneArrays,
    prim_id: NDArray[np.int32],
    instance_id: NDArray[np.int32],
    u: NDArray[np.floating],
    v: NDArray[np.floating],
) -> NDArray[np.float64]:
    """Return (..., 3) float64, world units: where the primitives are hit; NaN without one.

    The point is computed in the object, as `find_locations` does, and then placed. So an instance that is placed by the
    identity gives the bytes of its mesh, and a shared edge of two triangles is one line in the world, too.
    """
    return _for_points(_locate_placed, arrays, prim_id, instance_id, u, v)


def find_placed_normals(
    arrays: SceneArrays,
    prim_id: NDArray[np.int32],
    instance_id: NDArray[np.int32],
    u: NDArray[np.floating],
    v: NDArray[np.floating],
) -> NDArray[np.float64]:
    """Return (..., 3) float64: unit normals in the world, on the object's outer side; NaN without a primitive.

    The outer side of a triangle is the one from which its corners run anticlockwise in the object, and that of a sphere
    is its outside. A mirror takes it along.
    """
    return _for_points(_make_placed_normals, arrays, prim_id, instance_id, u, v)


def turn_normals(
    arrays: SceneArrays, instance_id: NDArray[np.int32], object_normals: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return (n, 3) float64: unit normals in the world of (n, 3) vectors normal to surfaces of objects.

    Parameters
    ----------
    arrays : SceneArrays
    instance_id : (n,) int32
        None is -1.
    object_normals : (n, 3) float64
        Of about length 1.
    """
    normals = np.empty(object_normals.shape)
    _turn_normals(arrays, np.ascontiguousarray(instance_id), object_normals, normals)
    return normals


def _for_points(
    compute: Callable[..., None],
    arrays: SceneArrays,
    prim_id: NDArray[np.int32],
    instance_id: NDArray[np.int32],
    u: NDArray[np.floating],
    v: NDArray[np.floating],
) -> NDArray[np.float64]:
    """Return (..., 3) float64: the vectors that a compiled function writes for points."""
    vectors = np.empty((*prim_id.shape, 3))
    flat = vectors.reshape(-1, 3)
    ids = [np.ascontiguousarray(values, np.int32).reshape(-1) for values in (prim_id, instance_id)]
    coordinates = [np.ascontiguousarray(values, np.float64).reshape(-1) for values in (u, v)]

    def compute_part(begin: int, end: int) -> None:
        part = slice(begin, end)
        compute(arrays, ids[0][part], ids[1][part], coordinates[0][part], coordinates[1][part], flat[part])

    with HostThreads() as threads:
        threads.for_ranges(len(flat), compute_part)
    return vectors


@compiled
def _locate_placed(arrays, prim_ids, instance_ids, us, vs, locations):
    for hit in range(len(prim_ids)):
        if prim_ids[hit] == NO_PRIM:
            locations[hit, 0] = locations[hit, 1] = locations[hit, 2] = np.nan
        else:
            point = locate_placed_point(arrays, instance_ids[hit], prim_ids[hit], us[hit], vs[hit])
            locations[hit, 0], locations[hit, 1], locations[hit, 2] = point


@compiled
def locate_placed_point(arrays, instance, prim, u, v):
    """Return the world coordinates of a point of a primitive."""
    vertices, faces, spheres = arrays.vertices, arrays.faces, arrays.spheres
    geometry = arrays.geometry_id[instance]
    if arrays.kind[geometry] == _SPHERES:
        sphere = arrays.first_sphere[geometry] + prim
        x, y, z = sphere_point(u, v)
        x = spheres[sphere, 0] + spheres[sphere, 3] * x
        y = spheres[sphere, 1] + spheres[sphere, 3] * y
        z = spheres[sphere, 2] + spheres[sphere, 3] * z
    else:
        face, first = arrays.first_face[geometry] + prim, arrays.first_vertex[geometry]
        a, b, c = first + faces[face, 0], first + faces[face, 1], first + faces[face, 2]
        x = _mix(vertices[a, 0], vertices[b, 0], vertices[c, 0], u, v)
        y = _mix(vertices[a, 1], vertices[b, 1], vertices[c, 1], u, v)
        z = _mix(vertices[a, 2], vertices[b, 2], vertices[c, 2], u, v)
    return place_point(arrays, instance, x, y, z)


@compiled
def _mix(a, b, c, u, v):
    return a + (u * (b - a) + v * (c - a))


@compiled
def _make_placed_normals(arrays, prim_ids, instance_ids, us, vs, normals):
    triangle = Triangles(np.empty((3, 3)), _ONE_FACE, 1.0)
    normal = np.empty(3)
    for hit in range(len(prim_ids)):
        if prim_ids[hit] == NO_PRIM:
            normals[hit, 0] = normals[hit, 1] = normals[hit, 2] = np.nan
            continue
        make_object_normal(arrays, instance_ids[hit], prim_ids[hit], us[hit], vs[hit], triangle.vertices, normal)
        turn_normal(arrays, instance_ids[hit], normal, normals[hit])


@compiled
def _turn_normals(arrays, instance_ids, object_normals, normals):
    for hit in range(len(instance_ids)):
        if instance_ids[hit] == NO_PRIM:
            normals[hit, 0] = normals[hit, 1] = normals[hit, 2] = np.nan
        else:
            turn_normal(arrays, instance_ids[hit], object_normals[hit], normals[hit])


@compiled
def make_object_normal(arrays, instance, prim, u, v, corners, normal):
    """Write the unit normal of a primitive in its object's coordinates; `corners` is working memory, (3, 3)."""
    geometry = arrays.geometry_id[instance]
    if arrays.kind[geometry] == _SPHERES:
        normal[0], normal[1], normal[2] = sphere_point(u, v)
        return
    face, first = arrays.first_face[geometry] + prim, arrays.first_vertex[geometry]
    for corner in range(3):
        for axis in range(3):
            corners[corner, axis] = arrays.vertices[first + arrays.faces[face, corner], axis]
    make_normal(Triangles(corners, _ONE_FACE, arrays.scale[geometry]), 0, normal)


@compiled(error_model="numpy")
def turn_normal(arrays, instance, object_normal, normal):
    """Write the unit vector along the inverse transpose of an instance's linear part times a vector of its object.

    Return the length of that product: the way in the object, along its vector, for a unit of the way in the world.

    Lengths of tangents and of normals change by inverse factors, so the transform itself would tilt normals. The
    inverse transpose keeps their sides: its product with ``linear @ d`` is that of the object's normal with d.
    """
    inverse = arrays.inverse
    # Divided by the largest component first: squares of a large or a tiny instance's could leave float64.
    largest = 0.0
    for axis in range(3):
        normal[axis] = (
            inverse[instance, 0, axis] * object_normal[0]
            + inverse[instance, 1, axis] * object_normal[1]
            + inverse[instance, 2, axis] * object_normal[2]
        )
        largest = max(largest, abs(normal[axis]))
    length = 0.0
    for axis in range(3):
        normal[axis] /= largest
        length += normal[axis] ** 2
    length = np.sqrt(length)
    for axis in range(3):
        normal[axis] /= length
    return length * largest
