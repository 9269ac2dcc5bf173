"""A block of hits on the way to float64: rays and triangles are gathered, then all are intersected at once.

First all inputs are gathered, then comes the arithmetic, which the compiler turns into vector instructions, then the
exceptions. Hit by hit it takes twice as long, and a block stays in the first-level cache.

Triangles of a scene are placed first and intersected then, so that their hits are as exact far from the scene's zero as
they are in a mesh that lies there. A placed sphere is an ellipsoid, so there the ray goes into the geometry's
coordinates.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...structs import HIT_PRIM_ID, HIT_U, PRIM_KINDS, WORLD_HIT_INSTANCE_ID
from ...support.compiled import compiled
from ...support.loop_functions import add_scaled, cross, dot, exponent_of, prefetch, subtract, times_power_of_two
from ..rays.batch import row_step
from ..world.surface_arrays import to_object_by
from .locations import locate_point
from .spheres import sphere_crossing, sphere_uv

# Hits of a block.
BLOCK_HITS = 128

# Prefetch distance in hits; 8 to 16 perform alike.
PREFETCH_HITS = 12

# A triangle is seen edge-on where the volume that its edges span with the ray is below this share of the products of
# which it is the sum. Float64 then knows t to 1e-5 of the triangle's size at best.
_EDGE_ON = 2.0**-36

# Vectors of each hit in a block, one row for each axis: the ray's direction, the triangle's corner a as seen from the
# ray's origin, its edges, and (t, u, v). All in local units, the direction with a longest component from 1 to 2.
DIRECTION, CORNER, AB, AC, TUV = range(5)


class RefineBlock(NamedTuple):
    """Working memory for a block of hits.

    Attributes
    ----------
    vectors : (5, 3, 128) float64
    volumes : (128,) float64
        Of the parallelepiped of each triangle's edges and the ray's direction: above 0 if the ray meets the front.
    exponents : (128,) int64
        The t of each hit is the user's times this power of two.
    rays, sources, targets : (128,) int64
        Indices of each hit: its ray, what the device found, and where the result goes.
    """

    vectors: NDArray[np.float64]
    volumes: NDArray[np.float64]
    exponents: NDArray[np.int64]
    rays: NDArray[np.int64]
    sources: NDArray[np.int64]
    targets: NDArray[np.int64]

    @classmethod
    def make(cls) -> RefineBlock:
        """Return memory that is not yet written; numba would need half a second to compile this."""
        indices = np.empty((4, BLOCK_HITS), np.int64)
        return cls(np.empty((TUV + 1, 3, BLOCK_HITS)), np.empty(BLOCK_HITS), *indices)


@compiled
def gather_lone(rays, arrays, found_ints, block, count):
    """Write the rays and the triangles of some hits on a lone mesh into a block."""
    origins, directions = rays.origins, rays.directions
    origin_step, direction_step = row_step(origins), row_step(directions)
    vertices, faces, scale = arrays.vertices, arrays.faces, arrays.scale[0]
    vectors, exponents, sources = block.vectors, block.exponents, block.sources
    exponent_of_scale = exponent_of(scale)
    for hit in range(count):
        prefetch(faces, 3 * found_ints[sources[hit], HIT_PRIM_ID])
    for hit in range(count):
        origin_id, direction_id = block.rays[hit] * origin_step, block.rays[hit] * direction_step
        prim = found_ints[sources[hit], HIT_PRIM_ID]
        coming = found_ints[sources[min(hit + PREFETCH_HITS, count - 1)], HIT_PRIM_ID]
        for corner in range(3):
            prefetch(vertices, 3 * faces[coming, corner])
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
        ia, ib, ic = faces[prim, 0], faces[prim, 1], faces[prim, 2]
        for axis in range(3):
            a = vertices[ia, axis]
            vectors[CORNER, axis, hit] = (a - origins[origin_id, axis]) * scale
            vectors[AB, axis, hit] = (vertices[ib, axis] - a) * scale
            vectors[AC, axis, hit] = (vertices[ic, axis] - a) * scale


@compiled(error_model="numpy")
def intersect_planes(vectors, volumes, count):
    """Write (t, u, v) of each ray of a block in the plane of its triangle, and the volume whose sign is its side.

    Moeller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.
    """
    for hit in range(count):
        dx, dy, dz = vectors[DIRECTION, 0, hit], vectors[DIRECTION, 1, hit], vectors[DIRECTION, 2, hit]
        abx, aby, abz = vectors[AB, 0, hit], vectors[AB, 1, hit], vectors[AB, 2, hit]
        acx, acy, acz = vectors[AC, 0, hit], vectors[AC, 1, hit], vectors[AC, 2, hit]
        tx, ty, tz = vectors[CORNER, 0, hit], vectors[CORNER, 1, hit], vectors[CORNER, 2, hit]
        px, py, pz = dy * acz - dz * acy, dz * acx - dx * acz, dx * acy - dy * acx
        qx, qy, qz = ty * abz - tz * aby, tz * abx - tx * abz, tx * aby - ty * abx
        volume = abx * px + aby * py + abz * pz
        volumes[hit] = volume
        vectors[TUV, 0, hit] = -(acx * qx + acy * qy + acz * qz) / volume
        u = -(tx * px + ty * py + tz * pz) / volume
        # Of a ray in the triangle's plane, but for rounding, this leaves noise: NaN lets `settle` look closer. Here the
        # volume is compared with that of a box with these sides, which is cheaper, and too strict for slivers.
        sides = (abs(abx) + abs(aby) + abs(abz)) * (abs(acx) + abs(acy) + abs(acz))
        is_flat = abs(volume) <= _EDGE_ON * sides * (abs(dx) + abs(dy) + abs(dz))
        vectors[TUV, 1, hit] = np.nan if is_flat else u
        vectors[TUV, 2, hit] = -(dx * qx + dy * qy + dz * qz) / volume


@compiled(error_model="numpy")
def settle(block, count):
    """Move hits beside their triangle onto it, and give t the unit of the user's direction.

    The device sees a rounded ray and a rounded triangle, which can meet where the exact ones pass each other.
    """
    vectors, exponents = block.vectors, block.exponents
    for hit in range(count):
        t, u, v = vectors[TUV, 0, hit], vectors[TUV, 1, hit], vectors[TUV, 2, hit]
        if not (u >= 0.0 and v >= 0.0 and u + v <= 1.0 and np.isfinite(t)):
            _move_onto_edge(vectors, hit)
        vectors[TUV, 0, hit] = times_power_of_two(vectors[TUV, 0, hit], -exponents[hit])


@compiled(error_model="numpy")
def _move_onto_edge(vectors, hit):
    """Write (t, u, v) of the point of the triangle's edges that is nearest to the ray's line.

    Of a triangle seen edge-on, to the part of the line that the ray is: the line crosses two edges. A ray that may be
    in the triangle's plane, where u is NaN, stays inside the triangle if its crossing is known.
    """
    direction, corner = _vector(vectors, DIRECTION, hit), _vector(vectors, CORNER, hit)
    to_a, to_b, to_c = (0.0, 0.0, 0.0), _vector(vectors, AB, hit), _vector(vectors, AC, hit)
    is_edge_on = False
    if np.isnan(vectors[TUV, 1, hit]):
        normal_way = cross(direction, to_c)
        volume = dot(to_b, normal_way)
        is_edge_on = not abs(volume) > _EDGE_ON * dot(_sizes(to_b), _cross_sizes(direction, to_c))
        u, v = -dot(corner, normal_way) / volume, vectors[TUV, 2, hit]
        if not is_edge_on and u >= 0.0 and v >= 0.0 and u + v <= 1.0:
            vectors[TUV, 1, hit] = u
            return
    square = dot(direction, direction)
    least = np.inf
    for edge in range(3):
        # The edge from b to c, from c to a, from a to b: its begin and its way, less their shares along the ray.
        to_begin = to_b if edge == 0 else to_c if edge == 1 else to_a
        to_end = to_c if edge == 0 else to_a if edge == 1 else to_b
        begin, way = add_scaled(corner, 1.0, to_begin), subtract(to_end, to_begin)
        beside = add_scaled(begin, -dot(begin, direction) / square, direction)
        across = add_scaled(way, -dot(way, direction) / square, direction)
        # An edge along the ray has no nearest point: 0 / 0, and the comparison makes it the begin.
        share = -dot(beside, across) / dot(across, across)
        share = min(share, 1.0) if share > 0.0 else 0.0
        t = dot(add_scaled(begin, share, way), direction) / square
        if is_edge_on and t < 0.0:
            # Along the edge to where the ray begins, if it reaches so far.
            share = min(max(-dot(begin, direction) / dot(way, direction), 0.0), 1.0)
            t = 0.0 if 0.0 < share < 1.0 else dot(add_scaled(begin, share, way), direction) / square
        offset = add_scaled(beside, share, across)
        distance = dot(offset, offset)
        if is_edge_on and t < 0.0:
            distance += t * t * square
        if distance < least:
            least = distance
            vectors[TUV, 0, hit] = t
            vectors[TUV, 1, hit] = 1.0 - share if edge == 0 else 0.0 if edge == 1 else share
            vectors[TUV, 2, hit] = share if edge == 0 else 1.0 - share if edge == 1 else 0.0


@compiled
def _vector(vectors, name, hit):
    return vectors[name, 0, hit], vectors[name, 1, hit], vectors[name, 2, hit]


@compiled
def _sizes(vector):
    return abs(vector[0]), abs(vector[1]), abs(vector[2])


@compiled
def _cross_sizes(one, other):
    """Return the sums of the sizes of the products of which a cross product is the difference."""
    return (
        abs(one[1] * other[2]) + abs(one[2] * other[1]),
        abs(one[2] * other[0]) + abs(one[0] * other[2]),
        abs(one[0] * other[1]) + abs(one[1] * other[0]),
    )


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
        instance = np.int64(found_ints[sources[hit], WORLD_HIT_INSTANCE_ID])
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
        if found_ints[coming, WORLD_HIT_INSTANCE_ID] == instance:
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
        instance = np.int64(found_ints[sources[hit], WORLD_HIT_INSTANCE_ID])
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
        instance = np.int64(found_ints[sources[hit], WORLD_HIT_INSTANCE_ID])
        if kind[geometry_id[instance]] == _SPHERES:
            x, y, z = vectors[CORNER, 0, hit], vectors[CORNER, 1, hit], vectors[CORNER, 2, hit]
            vectors[TUV, 1, hit], vectors[TUV, 2, hit] = sphere_uv(x, y, z)


@compiled
def refine_block(rays, arrays, found_ints, block, count):
    """Write t, u, v and the side of a block's hits into the block."""
    if len(arrays.faces) > 0:
        if arrays.is_lone:
            gather_lone(rays, arrays, found_ints, block, count)
        else:
            gather_placed(rays, arrays, found_ints, block, count)
        intersect_planes(block.vectors, block.volumes, count)
        settle(block, count)
    if not arrays.is_lone:
        finish_placed(rays, arrays, found_ints, block, count)


@compiled
def locate(arrays, found_ints, block, count, locations):
    """Write the points of a block's hits to their targets, in the scene's coordinates."""
    vectors, sources, targets = block.vectors, block.sources, block.targets
    for hit in range(count):
        instance = np.int64(0 if arrays.is_lone else found_ints[sources[hit], WORLD_HIT_INSTANCE_ID])
        prim, u, v = found_ints[sources[hit], HIT_PRIM_ID], vectors[TUV, 1, hit], vectors[TUV, 2, hit]
        point = locate_point(arrays, instance, prim, u, v)
        locations[targets[hit], 0], locations[targets[hit], 1], locations[targets[hit], 2] = point
