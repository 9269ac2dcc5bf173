"""Locations and normals of hits on the instances of a scene, in world coordinates and float64."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ...structs import NO_PRIM, PRIM_KINDS
from ...support.compiled import compiled
from ...support.host_threads import HostThreads
from ..triangles import Triangles
from .locations import make_normal
from .scene_arrays import SceneArrays, place_point
from .sphere_coordinates import sphere_point

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
    return _for_points(_locate, arrays, prim_id, instance_id, u, v)


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
    return _for_points(_make_normals, arrays, prim_id, instance_id, u, v)


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
def _locate(arrays, prim_ids, instance_ids, us, vs, locations):
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
def _make_normals(arrays, prim_ids, instance_ids, us, vs, normals):
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
