"""Locations and normals of hits in float64, by primitive and coordinates."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...structs import NO_PRIM, PRIM_KINDS
from ...support.compiled import compiled
from ...support.host_threads import HostThreads
from .scene_arrays import SceneArrays, SurfacePoints, place_point
from .spheres import sphere_point

_SPHERES = PRIM_KINDS["spheres"]

# A normal is not used if the corners of its triangle differ by more than this in height, in local units: sixteen
# roundings of float32.
_MOST_TILT = 2.0**-20


@compiled(error_model="numpy")
def make_normal(corners, scale, normal):
    """Write the unit normal of a triangle, (3, 3), on the side from which its corners run anticlockwise.

    A triangle so thin that float64 does not know its normal gets a vector across its longest edge.
    """
    # Divided by its largest component first: the squares of a small triangle's normal could underflow.
    largest = 0.0
    for axis in range(3):
        following, last = (axis + 1) % 3, (axis + 2) % 3
        ab_following, ab_last = corners[1, following] - corners[0, following], corners[1, last] - corners[0, last]
        ac_following, ac_last = corners[2, following] - corners[0, following], corners[2, last] - corners[0, last]
        normal[axis] = ab_following * scale * (ac_last * scale) - ab_last * scale * (ac_following * scale)
        largest = max(largest, abs(normal[axis]))
    for axis in range(3):
        normal[axis] /= largest
    _normalize(normal)
    # Written so that NaN is a tilt.
    if not _tilt(corners, scale, normal) <= _MOST_TILT:
        _write_across(corners, normal)


@compiled(error_model="numpy")
def _normalize(vector):
    length = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    for axis in range(3):
        vector[axis] /= length


@compiled
def _tilt(corners, scale, normal):
    """Return how much higher one corner of a triangle is than another one along a vector, in local units."""
    to_b, to_c = 0.0, 0.0
    for axis in range(3):
        to_b += (corners[1, axis] - corners[0, axis]) * scale * normal[axis]
        to_c += (corners[2, axis] - corners[0, axis]) * scale * normal[axis]
    return abs(to_b) + abs(to_c)


@compiled(error_model="numpy")
def _write_across(corners, normal):
    """Write a unit vector at right angles to the longest edge of a triangle; NaN if all edges have length zero."""
    longest, edge = 0.0, np.zeros(3)
    for begin in range(3):
        end = (begin + 1) % 3
        length = 0.0
        for axis in range(3):
            length = max(length, abs(corners[end, axis] - corners[begin, axis]))
        if length > longest:
            longest = length
            for axis in range(3):
                edge[axis] = corners[end, axis] - corners[begin, axis]
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


def find_locations(arrays: SceneArrays, points: SurfacePoints) -> NDArray[np.float64]:
    """Return (..., 3) float64, world units: where the primitives are hit; NaN without one.

    On a triangle ``a + (u (b - a) + v (c - a))``. The point is computed in the object and then placed, so a shared edge
    of two triangles is one line in the world, too.
    """
    return for_points(_locate, arrays, points)


def find_normals(arrays: SceneArrays, points: SurfacePoints) -> NDArray[np.float64]:
    """Return (..., 3) float64: unit normals in the world, on the object's outer side; NaN without a primitive.

    The outer side of a triangle is the one from which its corners run anticlockwise in the object, and that of a sphere
    is its outside. A mirror takes it along. A triangle so thin that float64 does not know its normal has one across its
    longest edge, and one whose corners are one point has NaN.
    """
    return for_points(_make_normals, arrays, points)


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


def for_points(
    compute: Callable[..., None], arrays: SceneArrays, points: SurfacePoints, *more: NDArray[Any]
) -> NDArray[np.float64]:
    """Return (..., 3) float64: the vectors that a compiled function writes for points, given more arrays of theirs."""
    vectors = np.empty((*points.prim_id.shape, 3))
    flat = vectors.reshape(-1, 3)
    ids = (np.ascontiguousarray(values, np.int32).reshape(-1) for values in (points.prim_id, points.instance_id))
    coordinates = (np.ascontiguousarray(values, np.float64).reshape(-1) for values in (points.u, points.v))
    others = (np.ascontiguousarray(values).reshape(len(flat), *values.shape[points.prim_id.ndim :]) for values in more)
    inputs: list[NDArray[Any]] = [*ids, *coordinates, *others]

    def compute_part(begin: int, end: int) -> None:
        compute(arrays, *(values[begin:end] for values in inputs), flat[begin:end])

    with HostThreads() as threads:
        threads.for_ranges(len(flat), compute_part)
    return vectors


@compiled
def _locate(arrays, prim_ids, instance_ids, us, vs, locations):
    for hit in range(len(prim_ids)):
        if prim_ids[hit] == NO_PRIM:
            locations[hit, 0] = locations[hit, 1] = locations[hit, 2] = np.nan
        else:
            point = locate_point(arrays, instance_ids[hit], prim_ids[hit], us[hit], vs[hit])
            locations[hit, 0], locations[hit, 1], locations[hit, 2] = point


@compiled
def locate_point(arrays, instance, prim, u, v):
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
    return (x, y, z) if arrays.is_lone else place_point(arrays, instance, x, y, z)


@compiled
def _mix(a, b, c, u, v):
    return a + (u * (b - a) + v * (c - a))


@compiled
def _make_normals(arrays, prim_ids, instance_ids, us, vs, normals):
    corners, normal = np.empty((3, 3)), np.empty(3)
    for hit in range(len(prim_ids)):
        if prim_ids[hit] == NO_PRIM:
            normals[hit, 0] = normals[hit, 1] = normals[hit, 2] = np.nan
            continue
        make_object_normal(arrays, instance_ids[hit], prim_ids[hit], us[hit], vs[hit], corners, normal)
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
    make_normal(corners, arrays.scale[geometry], normal)


@compiled(error_model="numpy")
def turn_normal(arrays, instance, object_normal, normal):
    """Write the unit vector along the inverse transpose of an instance's linear part times a vector of its object.

    Return the length of that product: the way in the object, along its vector, for a unit of the way in the world. A
    lone shape's vector stays as it is.

    Lengths of tangents and of normals change by inverse factors, so the transform itself would tilt normals. The
    inverse transpose keeps their sides: its product with ``linear @ d`` is that of the object's normal with d.
    """
    if arrays.is_lone:
        normal[0], normal[1], normal[2] = object_normal[0], object_normal[1], object_normal[2]
        return 1.0
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
