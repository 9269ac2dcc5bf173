"""Locations and normals of hits in float64, by primitive and coordinates, for compiled loops.

A location is computed in the object and then placed, so a shared edge of two triangles is one line in the world, too.
"""

from __future__ import annotations

import numpy as np

from ...structs import NO_PRIM, PRIM_KINDS
from ...support.compiled import compiled
from ...support.loop_functions import cross, dot, subtract
from ..world.surface_arrays import place_point
from .spheres import sphere_point

_SPHERES = PRIM_KINDS["spheres"]

# A normal is not used if the corners of its triangle differ by more than this in height, in local units: sixteen
# roundings of float32.
_MOST_TILT = 2.0**-20


@compiled(error_model="numpy")
def make_normal(a, b, c, scale):
    """Return the unit normal of a triangle on the side from which its corners run anticlockwise.

    A triangle so thin that float64 does not know its normal gets a vector across its longest edge.
    """
    ab, ac = _scale(subtract(b, a), scale), _scale(subtract(c, a), scale)
    normal, _ = _unit(cross(ab, ac))
    # Written so that NaN is a tilt: how much higher one corner is than another one along the normal.
    if not abs(dot(ab, normal)) + abs(dot(ac, normal)) <= _MOST_TILT:
        normal = _find_across(a, b, c)
    return normal


@compiled
def _scale(vector, scale):
    return vector[0] * scale, vector[1] * scale, vector[2] * scale


@compiled(error_model="numpy")
def _unit(vector):
    """Return the unit vector and the length of a vector; NaN for one of length zero."""
    x, y, z = vector
    # Divided by the largest component first: the squares of a small triangle's normal could underflow.
    largest = max(abs(x), abs(y), abs(z))
    x, y, z = x / largest, y / largest, z / largest
    length = np.sqrt(x * x + y * y + z * z)
    return (x / length, y / length, z / length), length * largest


@compiled(error_model="numpy")
def _find_across(a, b, c):
    """Return a unit vector at right angles to the longest edge of a triangle; NaN if all edges have length zero."""
    longest, edge = 0.0, (0.0, 0.0, 0.0)
    for begin, end in ((a, b), (b, c), (c, a)):
        way = subtract(end, begin)
        length = max(abs(way[0]), abs(way[1]), abs(way[2]))
        if length > longest:
            longest, edge = length, way
    edge, _ = _unit(edge)
    # The axis that is most across the edge, less its share along it.
    across = 0
    for axis in range(1, 3):
        across = axis if abs(edge[axis]) < abs(edge[across]) else across
    share = edge[across]
    x, y, z = (
        (1.0 if across == 0 else 0.0) - share * edge[0], (1.0 if across == 1 else 0.0) - share * edge[1],
        (1.0 if across == 2 else 0.0) - share * edge[2],
    )  # fmt: skip
    length = np.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@compiled
def locate_points(arrays, prim_ids, instance_ids, us, vs, locations):
    """Write where primitives are hit, in world coordinates; NaN without one."""
    for hit in range(len(prim_ids)):
        if prim_ids[hit] == NO_PRIM:
            locations[hit, 0] = locations[hit, 1] = locations[hit, 2] = np.nan
        else:
            point = locate_point(arrays, instance_ids[hit], prim_ids[hit], us[hit], vs[hit])
            locations[hit, 0], locations[hit, 1], locations[hit, 2] = point


@compiled
def locate_point(arrays, instance, prim, u, v):
    """Return the world coordinates of a point of a primitive."""
    geometry = arrays.geometry_id[instance]
    if arrays.kind[geometry] == _SPHERES:
        spheres, sphere = arrays.spheres, arrays.first_sphere[geometry] + prim
        x, y, z = sphere_point(u, v)
        x = spheres[sphere, 0] + spheres[sphere, 3] * x
        y = spheres[sphere, 1] + spheres[sphere, 3] * y
        z = spheres[sphere, 2] + spheres[sphere, 3] * z
    else:
        a, b, c = find_corners(arrays, geometry, prim)
        x, y, z = _mix(a[0], b[0], c[0], u, v), _mix(a[1], b[1], c[1], u, v), _mix(a[2], b[2], c[2], u, v)
    return (x, y, z) if arrays.is_lone else place_point(arrays, instance, x, y, z)


@compiled
def _mix(a, b, c, u, v):
    return a + (u * (b - a) + v * (c - a))


@compiled
def find_corners(arrays, geometry, prim):
    """Return the corners of a triangle in its object's coordinates."""
    vertices, faces = arrays.vertices, arrays.faces
    face, first = arrays.first_face[geometry] + prim, arrays.first_vertex[geometry]
    a, b, c = first + faces[face, 0], first + faces[face, 1], first + faces[face, 2]
    return (
        (vertices[a, 0], vertices[a, 1], vertices[a, 2]),
        (vertices[b, 0], vertices[b, 1], vertices[b, 2]),
        (vertices[c, 0], vertices[c, 1], vertices[c, 2]),
    )


@compiled
def make_normals(arrays, prim_ids, instance_ids, us, vs, normals):
    """Write unit normals in the world, on the object's outer side; NaN without a primitive."""
    for hit in range(len(prim_ids)):
        prim, instance = prim_ids[hit], instance_ids[hit]
        if prim == NO_PRIM:
            normals[hit, 0] = normals[hit, 1] = normals[hit, 2] = np.nan
            continue
        geometry = arrays.geometry_id[instance]
        if arrays.kind[geometry] == _SPHERES:
            normal = sphere_point(us[hit], vs[hit])
        else:
            a, b, c = find_corners(arrays, geometry, prim)
            normal = make_normal(a, b, c, arrays.scale[geometry])
        turned, _ = turn_normal(arrays, instance, normal)
        normals[hit, 0], normals[hit, 1], normals[hit, 2] = turned


@compiled
def turn_normals(arrays, instance_ids, object_normals, normals):
    """Write unit normals in the world of vectors that are normal in objects; NaN without an instance."""
    for hit in range(len(instance_ids)):
        normal = object_normals[hit, 0], object_normals[hit, 1], object_normals[hit, 2]
        turned = (np.nan, np.nan, np.nan)
        if instance_ids[hit] != NO_PRIM:
            turned, _ = turn_normal(arrays, instance_ids[hit], normal)
        normals[hit, 0], normals[hit, 1], normals[hit, 2] = turned


@compiled
def turn_normal(arrays, instance, normal):
    """Return the unit vector along the inverse transpose of an instance's linear part times a vector of its object.

    And the length of that product: the way in the object, along its vector, for a unit of the way in the world. A lone
    shape's vector stays as it is.

    Lengths of tangents and of normals change by inverse factors, so the transform itself would tilt normals. The
    inverse transpose keeps their sides: its product with ``linear @ d`` is that of the object's normal with d.
    """
    x, y, z = normal
    if arrays.is_lone:
        return (x, y, z), 1.0
    inverse = arrays.inverse
    return _unit((
        inverse[instance, 0, 0] * x + inverse[instance, 1, 0] * y + inverse[instance, 2, 0] * z,
        inverse[instance, 0, 1] * x + inverse[instance, 1, 1] * y + inverse[instance, 2, 1] * z,
        inverse[instance, 0, 2] * x + inverse[instance, 1, 2] * y + inverse[instance, 2, 2] * z,
    ))  # fmt: skip
