"""Start points of rays that leave a surface: so far above it that the tracer cannot meet it again.

A point on a triangle, rounded to float32 in the tracer's local coordinates, may be on either side of the triangle that
the tracer has in float32, and the triangle test rounds as well. The distance is a bound on all these roundings, which
docs/internals/offsets.md derives.

The tracer takes a ray into an instance in float32, so that map rounds as well: the bound is in the object's local
coordinates. In a world with shapes that span scales, the same roundings are those of float64, and relative to the
primitive instead of the shape: `extent` is its size, or that of any shape, 1.
"""

from __future__ import annotations

import numpy as np

from ...structs import NO_PRIM, PRIM_KINDS
from ...support.compiled import compiled
from ..world.surface_arrays import DOUBLE_ROUNDING, FLOAT_ROUNDING, place_vector, to_object
from .locations import find_corners, locate_point, make_normal, turn_normal
from .spheres import sphere_point

# Roundings of float32 between a point and the t of a triangle, by docs/internals/offsets.md.
ROUNDINGS = 40


_SPHERES = PRIM_KINDS["spheres"]

# Roundings of float32 on the way into an instance, and of float64 on the way to the world: docs/internals/offsets.md.
_ENTRY_ROUNDINGS = 16
_DOUBLE_ROUNDINGS = 8

# Roundings of float32 relative to a sphere's radius, by the same page.
_ROOT_ROUNDINGS = 40

# No sphere has a smaller radius on the device.
_LEAST_RADIUS = float(np.finfo(np.float32).tiny)

# Relative error of the difference of two positions that the device has as pairs of float32.
_PAIR_ROUNDING = 2.0**-45

# Float32 cannot tell the sides of an object whose start points would need more; no distance would do.
_MOST_GROWTH = 0.5


@compiled(error_model="numpy")
def offset_points(arrays, reach, is_upright, prim_ids, instance_ids, us, vs, is_front, points, heights):
    """Write a point above each primitive, in world coordinates; NaN without one.

    Above is the outer side where `is_front` is true. A point is above along the world's normal, or along the object's
    if it is to be upright there. `reach` is how far any coordinate of an instance can be from the middle of the world's
    box. `heights` are those in the object's local units, of points that may be too close to another triangle, see
    room.py; 0 for all others.
    """
    local, way, shares = np.empty(3), np.empty(3), np.empty(3)
    errors, growths = np.empty(3), np.empty(3)
    for hit in range(len(prim_ids)):
        prim, instance = prim_ids[hit], instance_ids[hit]
        heights[hit] = 0.0
        if prim == NO_PRIM:
            points[hit, 0] = points[hit, 1] = points[hit, 2] = np.nan
            continue
        u, v = us[hit], vs[hit]
        geometry = arrays.geometry_id[instance]
        scale = arrays.scale[geometry]
        side = 1.0 if is_front[hit] else -1.0
        x, y, z = locate_point(arrays, instance, prim, u, v)
        points[hit, 0], points[hit, 1], points[hit, 2] = x, y, z

        # The normal, the point in the object's local coordinates, and the highest point of the tracer's primitive
        # above it.
        most, from_edge, from_corner = np.inf, -np.inf, -np.inf
        if arrays.kind[geometry] == _SPHERES:
            x, y, z = sphere_point(u, v)
            normal = side * x, side * y, side * z
            highest, radius = _find_on_sphere(arrays, geometry, prim, normal, is_front[hit], local)
            highest += _ROOT_ROUNDINGS * arrays.rounding * radius
            extent = 1.0 if arrays.rounding == FLOAT_ROUNDING else 2.0 * radius
            most = np.inf if is_front[hit] else radius
        else:
            corners = find_corners(arrays, geometry, prim)
            x, y, z = make_normal(corners[0], corners[1], corners[2], scale)
            normal = side * x, side * y, side * z
            highest, extent = _find_on_triangle(arrays, geometry, corners, u, v, normal, local)
            face, column = arrays.first_face[geometry] + prim, 0 if is_front[hit] else 2
            from_edge, from_corner = arrays.margins[face, column], arrays.margins[face, column + 1]

        is_inside = np.isfinite(most)
        if arrays.is_lone:
            _bound_lone_roundings(arrays.rounding, extent, scale, local, points, hit, errors)
            height = min(highest + _add_errors(errors, is_inside), most)
            for axis in range(3):
                points[hit, axis] += height * normal[axis] / scale
        else:
            # The way in the world on which a height of 1 is gained in the object: along the world's normal, on which it
            # is shortest; inside of a sphere towards the centre, and no farther.
            if is_upright or is_inside:
                way[0], way[1], way[2] = place_vector(arrays, instance, normal[0], normal[1], normal[2])
            else:
                (x, y, z), gain = turn_normal(arrays, instance, normal)
                way[0], way[1], way[2] = x / gain, y / gain, z / gain
            x, y, z = to_object(arrays, instance, way[0], way[1], way[2])
            shares[0], shares[1], shares[2] = abs(x), abs(y), abs(z)
            _bound_roundings(arrays, instance, extent, local, shares, errors, growths)
            _add_coarseness(arrays, instance, geometry, local, points, hit, reach, errors)
            growth = min(_add_errors(growths, is_inside), _MOST_GROWTH)
            height = min((highest + _add_errors(errors, is_inside)) / (1.0 - growth), most)
            for axis in range(3):
                points[hit, axis] += height / scale * way[axis]
        w = 1.0 - u - v
        if from_edge == 0.0 or min(u, v, w) < from_edge * height or 1.0 - max(u, v, w) < from_corner * height:
            heights[hit] = height


@compiled
def _add_errors(errors, is_inside):
    """Return how far errors along the axes lead at most: in any direction, or in all of them inside of a sphere."""
    if is_inside:
        return errors[0] + errors[1] + errors[2]
    return np.sqrt(errors[0] * errors[0] + errors[1] * errors[1] + errors[2] * errors[2])


@compiled
def _bound_lone_roundings(rounding, extent, scale, local, locations, hit, errors):
    """Write how far rounding can move a point of a lone shape and its surface apart along each axis, in local units."""
    error = ROUNDINGS * rounding * (max(abs(local[0]), abs(local[1]), abs(local[2])) + extent)
    for axis in range(3):
        errors[axis] = error + 2 * DOUBLE_ROUNDING * abs(locations[hit, axis]) * scale


@compiled
def _bound_roundings(arrays, instance, extent, local, shares, errors, growths):
    """Write how far float32 moves a ray and a primitive apart along each axis, and by how much more for a height of 1.

    In local units. `shares` is how far a start point is moved along each of the object's axes for a height of 1.
    """
    reach = extent + max(abs(local[0]), abs(local[1]), abs(local[2]))
    sideways = max(shares[0], shares[1], shares[2])
    for axis in range(3):
        entry, growth_of_entry = 0.0, 0.0
        for column in range(3):
            condition = 0.0
            for world_axis in range(3):
                share = abs(arrays.inverse[instance, axis, world_axis])
                condition += share * abs(arrays.linear[instance, world_axis, column])
            entry += condition * (extent + abs(local[column]))
            growth_of_entry += condition * shares[column]
        errors[axis] = arrays.rounding * (ROUNDINGS * reach + _ENTRY_ROUNDINGS * entry)
        growths[axis] = arrays.rounding * (ROUNDINGS * sideways + _ENTRY_ROUNDINGS * growth_of_entry)


@compiled
def _add_coarseness(arrays, instance, geometry, local, locations, hit, reach, errors):
    """Add how far the roundings of world coordinates, in float64 and in pairs, move a point, in local units."""
    scale = arrays.scale[geometry]
    for world_axis in range(3):
        size = _add_magnitudes(arrays, instance, geometry, local, locations, hit, world_axis)
        moved = _PAIR_ROUNDING * reach + _DOUBLE_ROUNDINGS * DOUBLE_ROUNDING * size
        for axis in range(3):
            errors[axis] += abs(arrays.inverse[instance, axis, world_axis]) * moved * scale


@compiled
def _add_magnitudes(arrays, instance, geometry, local, locations, hit, world_axis):
    """Return the sum of the absolute values of which a world coordinate of a point is made, and of its own."""
    scale = arrays.scale[geometry]
    size = abs(locations[hit, world_axis]) + abs(arrays.offset[instance, world_axis])
    for column in range(3):
        place = abs(local[column]) / scale + abs(arrays.origin[geometry, column])
        size += abs(arrays.linear[instance, world_axis, column]) * place
    return size


@compiled
def _find_on_triangle(arrays, geometry, corners, u, v, normal, local):
    """Write the local coordinates of a point; return how much higher the tracer's triangle is, and the extent."""
    scale, highest = arrays.scale[geometry], 0.0
    for axis in range(3):
        a = corners[0][axis]
        point = a + (u * (corners[1][axis] - a) + v * (corners[2][axis] - a))
        local[axis] = (point - arrays.origin[geometry, axis]) * scale
    if arrays.rounding < FLOAT_ROUNDING:
        extent = 0.0
        for corner in range(3):
            for axis in range(3):
                place = (corners[corner][axis] - arrays.origin[geometry, axis]) * scale
                extent = max(extent, abs(place - local[axis]))
        return 0.0, extent
    for corner in range(3):
        height = 0.0
        for axis in range(3):
            on_device = np.float32((corners[corner][axis] - arrays.origin[geometry, axis]) * scale)
            height += (np.float64(on_device) - local[axis]) * normal[axis]
        highest = max(highest, height)
    return highest, 1.0


@compiled
def _find_on_sphere(arrays, geometry, prim, normal, is_outside, local):
    """Write the local coordinates of a point; return how far the float32 sphere reaches along a normal, and its radius.

    From inside, that is the distance by which its surface lies within the sphere of float64.
    """
    scale, sphere = arrays.scale[geometry], arrays.first_sphere[geometry] + prim
    radius = arrays.spheres[sphere, 3] * scale
    side = 1.0 if is_outside else -1.0
    height, is_rounded = 0.0, arrays.rounding == FLOAT_ROUNDING
    for axis in range(3):
        centre = (arrays.spheres[sphere, axis] - arrays.origin[geometry, axis]) * scale
        local[axis] = centre + side * radius * normal[axis]
        height += ((np.float64(np.float32(centre)) if is_rounded else centre) - local[axis]) * normal[axis]
    height += side * (max(np.float64(np.float32(radius)), _LEAST_RADIUS) if is_rounded else radius)
    return max(height, 0.0), radius
