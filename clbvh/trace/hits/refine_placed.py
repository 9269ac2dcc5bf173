"""Hits on the placed geometries of a scene, in float64: triangles in the scene's coordinates, spheres in their own.

A triangle is placed first and intersected then, so that its hits are as exact far from the scene's zero as they are in
a mesh that lies there. A placed sphere is an ellipsoid, so there the ray goes into the geometry's coordinates.
"""

from __future__ import annotations

import numpy as np

from ...structs import HIT_PRIM_ID, HIT_U, PRIM_KINDS, SCENE_HIT_INSTANCE_ID
from ...support.compiled import compiled
from ...support.powers_of_two import exponent_of, times_power_of_two
from ...support.prefetch import prefetch
from ..rays.ray_rows import row_step
from .placed_locations import locate_placed_point
from .refine_block import AB, AC, CORNER, DIRECTION, PREFETCH_HITS, TUV
from .scene_arrays import to_object_by
from .sphere_coordinates import sphere_uv
from .sphere_roots import sphere_crossing

_SPHERES = PRIM_KINDS["spheres"]


@compiled
def gather_placed(rays, arrays, found_ints, block, count):
    """Write the rays and the placed triangles of some hits into a block; for a sphere, a triangle that the ray hits."""
    origins, directions = rays.origins, rays.directions
    origin_step, direction_step = row_step(origins), row_step(directions)
    vertices, faces = arrays.vertices, arrays.faces
    linear, offset = arrays.linear, arrays.offset
    vectors, exponents, sources = block.vectors, block.exponents, block.sources
    # Numbers of the instance, read anew where it is another one than that of the hit before: seldom, mostly.
    known, is_sphere, first_vertex, first_face, scale, exponent_of_scale = np.int64(-1), False, 0, 0, 1.0, 0
    xx, xy, xz, yx, yy, yz, zx, zy, zz = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    x_offset, y_offset, z_offset = 0.0, 0.0, 0.0
    for hit in range(count):
        origin_id, direction_id = block.rays[hit] * origin_step, block.rays[hit] * direction_step
        instance = np.int64(found_ints[sources[hit], SCENE_HIT_INSTANCE_ID])
        if instance != known:
            known, geometry = instance, arrays.geometry_id[instance]
            is_sphere = arrays.kind[geometry] == _SPHERES
            first_vertex, first_face = arrays.first_vertex[geometry], arrays.first_face[geometry]
            scale = arrays.world_scale[instance]
            exponent_of_scale = exponent_of(scale)
            xx, xy, xz = linear[instance, 0, 0], linear[instance, 0, 1], linear[instance, 0, 2]
            yx, yy, yz = linear[instance, 1, 0], linear[instance, 1, 1], linear[instance, 1, 2]
            zx, zy, zz = linear[instance, 2, 0], linear[instance, 2, 1], linear[instance, 2, 2]
            x_offset, y_offset, z_offset = offset[instance, 0], offset[instance, 1], offset[instance, 2]
        dx, dy, dz = (
            np.float64(directions[direction_id, 0]),
            np.float64(directions[direction_id, 1]),
            np.float64(directions[direction_id, 2]),
        )
        exponent = exponent_of(max(abs(dx), abs(dy), abs(dz)))
        vectors[DIRECTION, 0, hit] = times_power_of_two(dx, -exponent)
        vectors[DIRECTION, 1, hit] = times_power_of_two(dy, -exponent)
        vectors[DIRECTION, 2, hit] = times_power_of_two(dz, -exponent)
        exponents[hit] = exponent + exponent_of_scale
        if is_sphere:
            _write_triangle_across(vectors, hit)
            continue
        coming = sources[min(hit + PREFETCH_HITS, count - 1)]
        if found_ints[coming, SCENE_HIT_INSTANCE_ID] == instance:
            prefetch(faces, 3 * (first_face + found_ints[coming, HIT_PRIM_ID]))
        face = first_face + found_ints[sources[hit], HIT_PRIM_ID]
        a, b, c = first_vertex + faces[face, 0], first_vertex + faces[face, 1], first_vertex + faces[face, 2]
        x, y, z = vertices[a, 0], vertices[a, 1], vertices[a, 2]
        vectors[CORNER, 0, hit] = (xx * x + xy * y + xz * z + x_offset - origins[origin_id, 0]) * scale
        vectors[CORNER, 1, hit] = (yx * x + yy * y + yz * z + y_offset - origins[origin_id, 1]) * scale
        vectors[CORNER, 2, hit] = (zx * x + zy * y + zz * z + z_offset - origins[origin_id, 2]) * scale
        abx, aby, abz = vertices[b, 0] - x, vertices[b, 1] - y, vertices[b, 2] - z
        vectors[AB, 0, hit] = (xx * abx + xy * aby + xz * abz) * scale
        vectors[AB, 1, hit] = (yx * abx + yy * aby + yz * abz) * scale
        vectors[AB, 2, hit] = (zx * abx + zy * aby + zz * abz) * scale
        acx, acy, acz = vertices[c, 0] - x, vertices[c, 1] - y, vertices[c, 2] - z
        vectors[AC, 0, hit] = (xx * acx + xy * acy + xz * acz) * scale
        vectors[AC, 1, hit] = (yx * acx + yy * acy + yz * acz) * scale
        vectors[AC, 2, hit] = (zx * acx + zy * acy + zz * acz) * scale


@compiled
def _write_triangle_across(vectors, hit):
    """Write a triangle that the ray hits in its first corner, in the plane across the direction's longest axis.

    Any other one would be taken for a miss, and moved onto an edge at the cost of all other steps together.
    """
    for axis in range(3):
        vectors[CORNER, axis, hit] = vectors[AB, axis, hit] = vectors[AC, axis, hit] = 0.0
    # The longest component is from 1 to 2.
    if abs(vectors[DIRECTION, 0, hit]) >= 1.0:
        vectors[AB, 1, hit] = vectors[AC, 2, hit] = 1.0
    elif abs(vectors[DIRECTION, 1, hit]) >= 1.0:
        vectors[AB, 2, hit] = vectors[AC, 0, hit] = 1.0
    else:
        vectors[AB, 0, hit] = vectors[AC, 1, hit] = 1.0


@compiled
def finish_placed(rays, arrays, found_ints, block, count):
    """Turn the sides of mirrored triangles, and write the hits on spheres."""
    # Looked up once: to hand all arrays to another function for each hit takes longer than the hit itself.
    origins, directions = rays.origins, rays.directions
    origin_step, direction_step = row_step(origins), row_step(directions)
    kind, geometry_id, is_mirrored = arrays.kind, arrays.geometry_id, arrays.is_mirrored
    offset, inverse = arrays.offset, arrays.inverse
    spheres, first_sphere = arrays.spheres, arrays.first_sphere
    vectors, volumes, sources = block.vectors, block.volumes, block.sources
    for hit in range(count):
        instance = np.int64(found_ints[sources[hit], SCENE_HIT_INSTANCE_ID])
        geometry = geometry_id[instance]
        if kind[geometry] != _SPHERES:
            if is_mirrored[instance]:
                volumes[hit] = -volumes[hit]
            continue
        origin_id, direction_id = block.rays[hit] * origin_step, block.rays[hit] * direction_step
        sphere = first_sphere[geometry] + found_ints[sources[hit], HIT_PRIM_ID]
        # The kernel writes a u of 0 where the ray enters the sphere and of 1 where it leaves it.
        is_leaving = found_ints[sources[hit], HIT_U] != 0
        origin = to_object_by(
            inverse, instance,
            origins[origin_id, 0] - offset[instance, 0],
            origins[origin_id, 1] - offset[instance, 1],
            origins[origin_id, 2] - offset[instance, 2],
        )  # fmt: skip
        direction = to_object_by(
            inverse, instance,
            np.float64(directions[direction_id, 0]),
            np.float64(directions[direction_id, 1]),
            np.float64(directions[direction_id, 2]),
        )  # fmt: skip
        centre = spheres[sphere, 0], spheres[sphere, 1], spheres[sphere, 2]
        t, x, y, z = sphere_crossing(origin, direction, centre, spheres[sphere, 3], is_leaving)
        vectors[TUV, 0, hit] = t
        vectors[CORNER, 0, hit], vectors[CORNER, 1, hit], vectors[CORNER, 2, hit] = x, y, z
        volumes[hit] = -1.0 if is_leaving else 1.0
    # In a loop of their own the calls of atan2 take half the time.
    for hit in range(count):
        instance = np.int64(found_ints[sources[hit], SCENE_HIT_INSTANCE_ID])
        if kind[geometry_id[instance]] == _SPHERES:
            x, y, z = vectors[CORNER, 0, hit], vectors[CORNER, 1, hit], vectors[CORNER, 2, hit]
            vectors[TUV, 1, hit], vectors[TUV, 2, hit] = sphere_uv(x, y, z)


@compiled
def locate_placed(arrays, found_ints, block, count, locations):
    """Write the points of a block's hits to their targets, in the scene's coordinates."""
    vectors, sources, targets = block.vectors, block.sources, block.targets
    for hit in range(count):
        instance = np.int64(found_ints[sources[hit], SCENE_HIT_INSTANCE_ID])
        prim, u, v = found_ints[sources[hit], HIT_PRIM_ID], vectors[TUV, 1, hit], vectors[TUV, 2, hit]
        point = locate_placed_point(arrays, instance, prim, u, v)
        locations[targets[hit], 0], locations[targets[hit], 1], locations[targets[hit], 2] = point
