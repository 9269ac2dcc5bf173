"""Hits from the device are computed again in float64, on the file's own vertices.

Of what the device found only the primitive counts. So t, u and v depend on nothing but the ray and the primitive, and
not on the layout, the device, or its compiler.

Hits are refined in blocks: first all inputs are gathered, then comes the arithmetic, which the compiler turns into
vector instructions, then the exceptions. Hit by hit it takes twice as long, and a block stays in the first-level cache.

Triangles of instances are placed first and intersected then, so that their hits are as exact far from the world's zero
as they are in a mesh that lies there. A placed sphere is an ellipsoid, so there the ray goes into the geometry's
coordinates.
"""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...structs import HIT_PRIM_ID, HIT_U, NO_PRIM, PRIM_KINDS, WORLD_HIT_INSTANCE_ID
from ...support.compiled import compiled
from ...support.loop_functions import add_scaled, cross, dot, exponent_of, prefetch, subtract, times_power_of_two
from ..rays.batch import RayRows, row_step
from ..world.surface_arrays import SurfaceArrays, multiply
from .hits import Hits
from .locations import locate_point
from .spheres import sphere_crossing, sphere_uv
from .surface import Surface

# Least hits of a thread's range. Refining one takes 40 to 100 ns, and waking a thread as long as 600 to 1,500 of them.
LEAST_HITS = 1 << 11

# Hits of a block.
BLOCK_HITS = 128

# Prefetch distance in hits; 8 to 16 perform alike.
PREFETCH_HITS = 12

# A triangle is seen edge-on where the volume that its edges span with the ray is below this share of the products of
# which it is the sum. Float64 then knows t to 1e-5 of the triangle's size at best.
_EDGE_ON = 2.0**-36

# The t of a hit beyond float64: infinity is the t of a miss.
_MOST_T = np.finfo(np.float64).max

# Vectors of each hit in a block, one row for each axis: the ray's direction, the triangle's corner a as seen from the
# ray's origin, its edges, and (t, u, v). All in units of `world_scale`, the direction with a longest component from 1
# to 2. Of a sphere, `CORNER` becomes the unit vector from its centre to the hit.
DIRECTION, CORNER, AB, AC, TUV = range(5)

_SPHERES = PRIM_KINDS["spheres"]

# The block of each thread.
_kept = threading.local()


class RefinedHits(NamedTuple):
    """Where refined hits go, one element for each hit; see `Hits`.

    `instance_id` has no elements for hits on a lone shape.
    """

    t: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    is_front: NDArray[np.bool_]
    prim_id: NDArray[np.int32]
    instance_id: NDArray[np.int32]

    @classmethod
    def make(cls, count: int, *, is_lone: bool = True) -> RefinedHits:
        """Return arrays for hits, not yet written."""
        t, u, v, is_front = np.empty(count), np.empty(count), np.empty(count), np.empty(count, np.bool_)
        return cls(t, u, v, is_front, np.empty(count, np.int32), np.empty(0 if is_lone else count, np.int32))

    def part(self, begin: int, end: int) -> RefinedHits:
        """Return views for some of the hits."""
        if end - begin == len(self.t):  # views would cost a call with one ray 3 % of its time
            return self
        part = slice(begin, end)
        return RefinedHits(*(values[part] for values in self))  # type: ignore[arg-type]

    def as_hits(self, shape: tuple[int, ...], surface: Surface) -> Hits:
        """Return the hits of rays of a leading shape."""
        t, u, v = (values.reshape(shape) for values in (self.t, self.u, self.v))
        return Hits(
            t, u, v, self.prim_id.reshape(shape), is_front=self.is_front.reshape(shape), surface=surface,
            known_instance_id=None if surface.arrays.is_lone else self.instance_id.reshape(shape),
        )  # fmt: skip


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
    instances : (128,) int64
    faces, firsts : (128,) int64
        Rows of `SurfaceArrays`: the face, and its mesh's first vertex; of a sphere -1, and the sphere.
    """

    vectors: NDArray[np.float64]
    volumes: NDArray[np.float64]
    exponents: NDArray[np.int64]
    rays: NDArray[np.int64]
    sources: NDArray[np.int64]
    targets: NDArray[np.int64]
    instances: NDArray[np.int64]
    faces: NDArray[np.int64]
    firsts: NDArray[np.int64]

    @classmethod
    def of_thread(cls) -> RefineBlock:
        """Return the memory of the calling thread: to make it takes a tenth of a call with one ray.

        Made here and not in a compiled loop, since numba takes long to compile that.
        """
        block: RefineBlock | None = getattr(_kept, "block", None)
        if block is None:
            vectors, volumes = np.empty((TUV + 1, 3, BLOCK_HITS)), np.empty(BLOCK_HITS)
            block = _kept.block = cls(vectors, volumes, *np.empty((7, BLOCK_HITS), np.int64))
        return block


def refine_closest(rays: RayRows, arrays: SurfaceArrays, found: NDArray[np.void], hits: RefinedHits) -> None:
    """Write one hit for each ray in float64.

    Parameters
    ----------
    rays : RayRows
        The rays that were cast, as the user gave them.
    arrays : SurfaceArrays
    found : (n,) `structs.HIT` of a lone shape, else `structs.WORLD_HIT`
        What the device found.
    hits : RefinedHits of (n,) arrays, written
        Where float64 sees the ray pass beside the primitive, by less than float32 resolves, t, u and v are those of the
        primitive's point that is nearest to the ray.
    """
    lanes = np.ascontiguousarray(found).view(np.float32).reshape(-1, found.dtype.itemsize // 4)
    refine_found(rays, arrays, lanes.view(np.int32), RefineBlock.of_thread(), hits)


@compiled(error_model="numpy")
def refine_found(rays, arrays, found_ints, block, hits):
    """Write one hit for each ray, as `refine_closest`; `found_ints` are (n, lanes) int32."""
    t, u, v, is_front, prim_id, instance_id = hits
    count = 0
    for ray in range(len(found_ints)):
        if found_ints[ray, HIT_PRIM_ID] == NO_PRIM:
            t[ray], u[ray], v[ray], is_front[ray], prim_id[ray] = np.inf, 0.0, 0.0, False, NO_PRIM
            if not arrays.is_lone:
                instance_id[ray] = NO_PRIM
        else:
            block.rays[count] = block.sources[count] = block.targets[count] = ray
            count += 1
        if count == BLOCK_HITS or ray == len(found_ints) - 1:
            refine_block(rays, arrays, found_ints, block, count, hits)
            count = 0


@compiled
def refine_block(rays, arrays, found_ints, block, count, hits):
    """Write the hits that a block lists to their targets, t within the ray's limits."""
    _look_up(arrays, found_ints, block, count, hits)
    if len(arrays.faces) > 0:
        _gather(rays, arrays, block, count)
        intersect_planes(block.vectors, block.volumes, count)
        settle(block, count)
    if len(arrays.spheres) > 0 or not arrays.is_lone:
        _finish(rays, arrays, found_ints, block, count)
    tuv, volumes, t_mins, t_maxs = block.vectors[TUV], block.volumes, rays.t_min, rays.t_max
    t, u, v, is_front, targets = hits.t, hits.u, hits.v, hits.is_front, block.targets
    for hit in range(count):
        ray, target = block.rays[hit], targets[hit]
        t_min = t_mins[ray] if len(t_mins) > 1 else t_mins[0]
        t_max = t_maxs[ray] if len(t_maxs) > 1 else t_maxs[0]
        t[target] = min(max(tuv[0, hit], t_min), t_max, _MOST_T)
        u[target], v[target], is_front[target] = tuv[1, hit], tuv[2, hit], volumes[hit] > 0.0


@compiled
def _look_up(arrays, found_ints, block, count, hits):
    """Write the ids of a block's hits, and the rows of their primitives."""
    is_lone, faces, sources, targets = arrays.is_lone, arrays.faces, block.sources, block.targets
    prim_id, instance_id = hits.prim_id, hits.instance_id
    # Numbers of the instance, read anew where it is another one than that of the hit before.
    known, is_sphere, first, first_vertex = np.int64(-1), False, np.int64(0), np.int64(0)
    for hit in range(count):
        source, target = sources[hit], targets[hit]
        prim = found_ints[source, HIT_PRIM_ID]
        instance = np.int64(0 if is_lone else found_ints[source, WORLD_HIT_INSTANCE_ID])
        if instance != known:
            known, geometry = instance, arrays.geometry_id[instance]
            is_sphere = arrays.kind[geometry] == _SPHERES
            first = arrays.first_sphere[geometry] if is_sphere else arrays.first_face[geometry]
            first_vertex = arrays.first_vertex[geometry]
        prim_id[target], block.instances[hit] = prim, instance
        if not is_lone:
            instance_id[target] = instance
        block.faces[hit] = NO_PRIM if is_sphere else first + prim
        block.firsts[hit] = first + prim if is_sphere else first_vertex
        if not is_sphere:
            prefetch(faces, 3 * (first + prim))


@compiled
def _gather(rays, arrays, block, count):
    """Write the rays and the placed triangles of some hits into a block; for a sphere, a triangle that is hit."""
    origins, directions = rays.origins, rays.directions
    origin_step, direction_step = row_step(origins), row_step(directions)
    vertices, faces, is_lone = arrays.vertices, arrays.faces, arrays.is_lone
    linear, offset, world_scale = arrays.linear, arrays.offset, arrays.world_scale
    vectors, exponents = block.vectors, block.exponents
    known, scale, exponent_of_scale = np.int64(-1), 1.0, 0
    for hit in range(count):
        coming = min(hit + PREFETCH_HITS, count - 1)
        if block.faces[coming] != NO_PRIM:
            for corner in range(3):
                prefetch(vertices, 3 * (block.firsts[coming] + faces[block.faces[coming], corner]))
        face, first, instance = block.faces[hit], block.firsts[hit], block.instances[hit]
        if face == NO_PRIM:
            # Any other one would be taken for a miss, and moved onto an edge at the cost of all other steps together.
            exponents[hit] = 0
            for axis in range(3):
                vectors[CORNER, axis, hit] = 0.0
                vectors[DIRECTION, axis, hit] = 1.0 if axis == 0 else 0.0
                vectors[AB, axis, hit] = 1.0 if axis == 1 else 0.0
                vectors[AC, axis, hit] = 1.0 if axis == 2 else 0.0
            continue
        if instance != known:
            known, scale = instance, world_scale[instance]
            exponent_of_scale = exponent_of(scale)
        origin_id, direction_id = block.rays[hit] * origin_step, block.rays[hit] * direction_step
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
        a, b, c = first + faces[face, 0], first + faces[face, 1], first + faces[face, 2]
        x, y, z = vertices[a, 0], vertices[a, 1], vertices[a, 2]
        abx, aby, abz = vertices[b, 0] - x, vertices[b, 1] - y, vertices[b, 2] - z
        acx, acy, acz = vertices[c, 0] - x, vertices[c, 1] - y, vertices[c, 2] - z
        if not is_lone:
            x, y, z = multiply(linear, instance, (x, y, z))
            x, y, z = x + offset[instance, 0], y + offset[instance, 1], z + offset[instance, 2]
            abx, aby, abz = multiply(linear, instance, (abx, aby, abz))
            acx, acy, acz = multiply(linear, instance, (acx, acy, acz))
        vectors[CORNER, 0, hit] = (x - origins[origin_id, 0]) * scale
        vectors[CORNER, 1, hit] = (y - origins[origin_id, 1]) * scale
        vectors[CORNER, 2, hit] = (z - origins[origin_id, 2]) * scale
        vectors[AB, 0, hit], vectors[AB, 1, hit], vectors[AB, 2, hit] = abx * scale, aby * scale, abz * scale
        vectors[AC, 0, hit], vectors[AC, 1, hit], vectors[AC, 2, hit] = acx * scale, acy * scale, acz * scale


@compiled
def _row(vectors, row):
    return np.float64(vectors[row, 0]), np.float64(vectors[row, 1]), np.float64(vectors[row, 2])


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


@compiled
def _finish(rays, arrays, found_ints, block, count):
    """Turn the sides of mirrored triangles, and write the hits on spheres."""
    # Looked up once: to hand all arrays to another function for each hit takes longer than the hit itself.
    origins, directions = rays.origins, rays.directions
    origin_step, direction_step = row_step(origins), row_step(directions)
    is_mirrored, offset, inverse, spheres = arrays.is_mirrored, arrays.offset, arrays.inverse, arrays.spheres
    vectors, volumes = block.vectors, block.volumes
    for hit in range(count):
        instance, sphere = block.instances[hit], block.firsts[hit]
        if block.faces[hit] != NO_PRIM:
            if is_mirrored[instance]:
                volumes[hit] = -volumes[hit]
            continue
        # The kernel writes a u of 0 where the ray enters the sphere and of 1 where it leaves it.
        is_leaving = found_ints[block.sources[hit], HIT_U] != 0
        origin = subtract(_row(origins, block.rays[hit] * origin_step), _row(offset, instance))
        direction = _row(directions, block.rays[hit] * direction_step)
        t, x, y, z = sphere_crossing(
            multiply(inverse, instance, origin), multiply(inverse, instance, direction),
            _row(spheres, sphere), spheres[sphere, 3], is_leaving,
        )  # fmt: skip
        vectors[TUV, 0, hit] = t
        vectors[CORNER, 0, hit], vectors[CORNER, 1, hit], vectors[CORNER, 2, hit] = x, y, z
        volumes[hit] = -1.0 if is_leaving else 1.0
    # In a loop of their own the calls of atan2 take half the time.
    for hit in range(count):
        if block.faces[hit] == NO_PRIM:
            x, y, z = vectors[CORNER, 0, hit], vectors[CORNER, 1, hit], vectors[CORNER, 2, hit]
            vectors[TUV, 1, hit], vectors[TUV, 2, hit] = sphere_uv(x, y, z)


@compiled
def locate(arrays, found_ints, block, count, locations):
    """Write the points of a block's hits to their targets, in the world's coordinates."""
    vectors, sources, targets = block.vectors, block.sources, block.targets
    for hit in range(count):
        prim, u, v = found_ints[sources[hit], HIT_PRIM_ID], vectors[TUV, 1, hit], vectors[TUV, 2, hit]
        point = locate_point(arrays, block.instances[hit], prim, u, v)
        locations[targets[hit], 0], locations[targets[hit], 1], locations[targets[hit], 2] = point
