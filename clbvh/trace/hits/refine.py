"""Hits from the device are computed again in float64, on the file's own vertices.

Of what the device found only the triangle counts. So t, u and v depend on nothing but the ray and the triangle, and not
on the layout, the device, or its compiler.

Hits are refined in blocks: first all inputs are gathered, then comes the arithmetic, which the compiler turns into
vector instructions, then the exceptions. Hit by hit it takes twice as long, and a block stays in the first-level cache.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh
from ...structs import HIT_LANES, HIT_PRIM_ID, NO_PRIM
from ...support.compiled import compiled
from ...support.powers_of_two import exponent_of, times_power_of_two
from ...support.prefetch import prefetch
from ..rays.batch import RayBatch
from ..rays.ray_rows import RayRows, row_step
from ..triangles import triangles_of
from .crossings import Crossings, source_index
from .hits import Hits

# Hits of a block.
_BLOCK = 128

# Prefetch distance in hits; 8 to 16 perform alike.
_PREFETCH_HITS = 12

# Rays that are made contiguous at a time, where they are not.
_MOST_RAYS = 2**20

# The t of a hit beyond float64: infinity is the t of a miss.
_MOST_T = np.finfo(np.float64).max

# Vectors of each hit in a block, one row for each axis: the ray's direction, the triangle's corner a as seen from the
# ray's origin, its edges, and (t, u, v). All in local units, the direction with a longest component from 1 to 2.
_DIRECTION, _CORNER, _AB, _AC, _TUV = range(5)


class RefinedHits(NamedTuple):
    """Where refined hits go, one element for each hit; see `Hits`."""

    t: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    is_front: NDArray[np.bool_]

    @classmethod
    def make(cls, count: int) -> RefinedHits:
        """Return arrays for hits, not yet written."""
        return cls(np.empty(count), np.empty(count), np.empty(count), np.empty(count, np.bool_))

    def part(self, begin: int, end: int) -> RefinedHits:
        """Return views for some of the hits."""
        part = slice(begin, end)
        return RefinedHits(self.t[part], self.u[part], self.v[part], self.is_front[part])

    def as_hits(self, prim_id: NDArray[np.int32], mesh: Mesh, shape: tuple[int, ...]) -> Hits:
        """Return the hits of rays of a leading shape."""
        t, u, v = (values.reshape(shape) for values in (self.t, self.u, self.v))
        return Hits(t, u, v, prim_id.reshape(shape), mesh, is_front=self.is_front.reshape(shape))


class _Block(NamedTuple):
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
    def make(cls) -> _Block:
        """Return memory that is not yet written; numba would need half a second to compile this."""
        indices = np.empty((4, _BLOCK), np.int64)
        return cls(np.empty((_TUV + 1, 3, _BLOCK)), np.empty(_BLOCK), *indices)


def refine_closest(
    rays: RayRows,
    mesh: Mesh,
    found: NDArray[np.void],
    hits: RefinedHits,
    prim_id: NDArray[np.int32],
) -> None:
    """Write one hit for each ray in float64.

    Parameters
    ----------
    rays : RayRows
        The rays that were cast, as the user gave them.
    mesh : Mesh
    found : (n,) `structs.HIT`
        What the device found.
    hits : RefinedHits of (n,) arrays, written
    prim_id : (n,) int32, written
        Where float64 sees the ray pass beside the triangle, by less than float32 resolves, t, u and v are those of the
        triangle's point that is nearest to the ray.
    """
    lanes = np.ascontiguousarray(found).view(np.float32).reshape(-1, HIT_LANES)
    _refine_closest(rays, triangles_of(mesh), lanes.view(np.int32), _Block.make(), hits, prim_id)


def refine_crossings(
    batch: RayBatch,
    mesh: Mesh,
    crossings: Crossings,
    begin: int,
    end: int,
    next_slots: NDArray[np.int64],
    *,
    prim_id: NDArray[np.integer],
    hits: RefinedHits | None = None,
    ray_id: NDArray[np.int64] | None = None,
    locations: NDArray[np.float64] | None = None,
) -> None:
    """Write several hits for each ray in float64.

    Parameters
    ----------
    batch : RayBatch
        All rays.
    mesh : Mesh
    crossings : Crossings
        Of all rays.
    begin, end : int
        The rays to work on.
    next_slots : (1,) or (depths,) int64, changed
        Index of the first hit in the results: ray after ray; or, with a `ray_id`, one for each depth.
    prim_id : (m,) int, written
    hits : RefinedHits of (m,) arrays, written
        No t is smaller than that of the crossing before it on the ray. The device's order holds for all queries, so
        that `all_hits` begins with what `closest_hit` finds; float64 may see two crossings that are closer than
        float32 resolves in the other order.
    ray_id : (m,) int64, written
    locations : (m, 3) float64, written
    """
    first_slot = int(next_slots[0]) if len(next_slots) else 0
    found_ints, triangles, block = crossings.found.view(np.int32), triangles_of(mesh), _Block.make()
    for first in range(begin, end, _MOST_RAYS):
        last = min(first + _MOST_RAYS, end)
        # Counts and sources of these rays alone: their indices agree with the part's.
        of_part = crossings._replace(counts=crossings.counts[first:last], sources=crossings.sources[first:last])
        _refine_crossings(
            batch.part(first, last), triangles, of_part, found_ints, block, first, next_slots,
            prim_id, hits, ray_id, locations,
        )  # fmt: skip
    if hits is not None:
        _keep_order(crossings.counts[begin:end], first_slot, hits.t)


@compiled(error_model="numpy")
def _refine_closest(rays, triangles, found_ints, block, hits, prim_id):
    t, u, v, is_front = hits.t, hits.u, hits.v, hits.is_front
    count = 0
    for ray in range(len(found_ints)):
        prim = found_ints[ray, HIT_PRIM_ID]
        prim_id[ray] = prim
        if prim == NO_PRIM:
            t[ray], u[ray], v[ray], is_front[ray] = np.inf, 0.0, 0.0, False
        else:
            block.rays[count] = block.sources[count] = block.targets[count] = ray
            count += 1
        if count == _BLOCK or ray == len(found_ints) - 1:
            _gather(rays, triangles, found_ints, block, count)
            _intersect_planes(block.vectors, block.volumes, count)
            _settle(block, count)
            _store_hits(rays.t_min, rays.t_max, block, count, hits)
            count = 0


@compiled(error_model="numpy")
def _refine_crossings(
    rays, triangles, crossings, found_ints, block, first_ray, next_slots, prim_id, hits, ray_id, locations
):
    counts, sources, segment_begins = crossings.counts, crossings.sources, crossings.segment_begins
    found = crossings.found
    ray, depth = 0, 0
    while ray < len(counts):
        # List the next hits, and where they go.
        count = 0
        while ray < len(counts) and count < _BLOCK:
            if depth == counts[ray]:
                ray, depth = ray + 1, 0
                if ray + _PREFETCH_HITS < len(counts):
                    coming = source_index(sources[ray + _PREFETCH_HITS], segment_begins)
                    prefetch(found, HIT_LANES * coming + HIT_PRIM_ID)
                continue
            counter = 0 if ray_id is None else depth
            block.rays[count], block.targets[count] = ray, next_slots[counter]
            block.sources[count] = source_index(sources[ray], segment_begins) + depth
            next_slots[counter] += 1
            depth += 1
            count += 1
        for hit in range(count):
            prim_id[block.targets[hit]] = found_ints[block.sources[hit], HIT_PRIM_ID]
        if ray_id is not None:
            for hit in range(count):
                ray_id[block.targets[hit]] = first_ray + block.rays[hit]

        # Refine what is wanted of them.
        if hits is not None or locations is not None:
            _gather(rays, triangles, found_ints, block, count)
            _intersect_planes(block.vectors, block.volumes, count)
            _settle(block, count)
        if hits is not None:
            _store_hits(rays.t_min, rays.t_max, block, count, hits)
        if locations is not None:
            _store_locations(triangles, found_ints, block, count, locations)


@compiled
def _keep_order(counts, first_slot, t):
    """Raise each t to that of the crossing before it on the ray."""
    slot = first_slot
    for ray in range(len(counts)):
        for depth in range(counts[ray]):
            if depth > 0:
                t[slot] = max(t[slot], t[slot - 1])
            slot += 1


@compiled
def _gather(rays, triangles, found_ints, block, count):
    """Write the rays and the triangles of some hits into a block."""
    origins, directions = rays.origins, rays.directions
    origin_step, direction_step = row_step(origins), row_step(directions)
    vertices, faces, scale = triangles.vertices, triangles.faces, triangles.scale
    vectors, exponents, sources = block.vectors, block.exponents, block.sources
    exponent_of_scale = exponent_of(scale)
    for hit in range(count):
        prefetch(faces, 3 * found_ints[sources[hit], HIT_PRIM_ID])
    for hit in range(count):
        origin_id, direction_id = block.rays[hit] * origin_step, block.rays[hit] * direction_step
        prim = found_ints[sources[hit], HIT_PRIM_ID]
        coming = found_ints[sources[min(hit + _PREFETCH_HITS, count - 1)], HIT_PRIM_ID]
        for corner in range(3):
            prefetch(vertices, 3 * faces[coming, corner])
        dx, dy, dz = (
            np.float64(directions[direction_id, 0]),
            np.float64(directions[direction_id, 1]),
            np.float64(directions[direction_id, 2]),
        )
        exponent = exponent_of(max(abs(dx), abs(dy), abs(dz)))
        vectors[_DIRECTION, 0, hit] = times_power_of_two(dx, -exponent)
        vectors[_DIRECTION, 1, hit] = times_power_of_two(dy, -exponent)
        vectors[_DIRECTION, 2, hit] = times_power_of_two(dz, -exponent)
        exponents[hit] = exponent + exponent_of_scale
        ia, ib, ic = faces[prim, 0], faces[prim, 1], faces[prim, 2]
        for axis in range(3):
            a = vertices[ia, axis]
            vectors[_CORNER, axis, hit] = (a - origins[origin_id, axis]) * scale
            vectors[_AB, axis, hit] = (vertices[ib, axis] - a) * scale
            vectors[_AC, axis, hit] = (vertices[ic, axis] - a) * scale


@compiled(error_model="numpy")
def _intersect_planes(vectors, volumes, count):
    """Write (t, u, v) of each ray of a block in the plane of its triangle, and the volume whose sign is its side.

    Moeller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.
    """
    for hit in range(count):
        dx, dy, dz = vectors[_DIRECTION, 0, hit], vectors[_DIRECTION, 1, hit], vectors[_DIRECTION, 2, hit]
        abx, aby, abz = vectors[_AB, 0, hit], vectors[_AB, 1, hit], vectors[_AB, 2, hit]
        acx, acy, acz = vectors[_AC, 0, hit], vectors[_AC, 1, hit], vectors[_AC, 2, hit]
        tx, ty, tz = vectors[_CORNER, 0, hit], vectors[_CORNER, 1, hit], vectors[_CORNER, 2, hit]
        px, py, pz = dy * acz - dz * acy, dz * acx - dx * acz, dx * acy - dy * acx
        qx, qy, qz = ty * abz - tz * aby, tz * abx - tx * abz, tx * aby - ty * abx
        volume = abx * px + aby * py + abz * pz
        volumes[hit] = volume
        vectors[_TUV, 0, hit] = -(acx * qx + acy * qy + acz * qz) / volume
        vectors[_TUV, 1, hit] = -(tx * px + ty * py + tz * pz) / volume
        vectors[_TUV, 2, hit] = -(dx * qx + dy * qy + dz * qz) / volume


@compiled(error_model="numpy")
def _settle(block, count):
    """Move hits beside their triangle onto it, and give t the unit of the user's direction.

    The device sees a rounded ray and a rounded triangle, which can meet where the exact ones pass each other.
    """
    vectors, exponents = block.vectors, block.exponents
    for hit in range(count):
        t, u, v = vectors[_TUV, 0, hit], vectors[_TUV, 1, hit], vectors[_TUV, 2, hit]
        if not (u >= 0.0 and v >= 0.0 and u + v <= 1.0 and np.isfinite(t)):
            _move_onto_edge(vectors, hit)
        vectors[_TUV, 0, hit] = times_power_of_two(vectors[_TUV, 0, hit], -exponents[hit])


@compiled(error_model="numpy")
def _move_onto_edge(vectors, hit):
    """Write (t, u, v) of the point of the triangle's edges that is nearest to the ray's line."""
    # Numbers, not slices of arrays, which take the compiler two seconds.
    direction, corner = _vector(vectors, _DIRECTION, hit), _vector(vectors, _CORNER, hit)
    to_a, to_b, to_c = (0.0, 0.0, 0.0), _vector(vectors, _AB, hit), _vector(vectors, _AC, hit)
    square = _dot(direction, direction)
    least = np.inf
    for edge in range(3):
        # The edge from b to c, from c to a, from a to b: its begin and its way, less their shares along the ray.
        to_begin = to_b if edge == 0 else to_c if edge == 1 else to_a
        to_end = to_c if edge == 0 else to_a if edge == 1 else to_b
        begin, way = _add(corner, 1.0, to_begin), _add(to_end, -1.0, to_begin)
        beside = _add(begin, -_dot(begin, direction) / square, direction)
        across = _add(way, -_dot(way, direction) / square, direction)
        # An edge along the ray has no nearest point: 0 / 0, and the comparison makes it the begin.
        share = -_dot(beside, across) / _dot(across, across)
        share = min(share, 1.0) if share > 0.0 else 0.0
        offset = _add(beside, share, across)
        distance = _dot(offset, offset)
        if distance < least:
            least = distance
            vectors[_TUV, 0, hit] = _dot(_add(begin, share, way), direction) / square
            vectors[_TUV, 1, hit] = 1.0 - share if edge == 0 else 0.0 if edge == 1 else share
            vectors[_TUV, 2, hit] = share if edge == 0 else 1.0 - share if edge == 1 else 0.0


@compiled
def _vector(vectors, name, hit):
    return vectors[name, 0, hit], vectors[name, 1, hit], vectors[name, 2, hit]


@compiled
def _dot(one, other):
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


@compiled
def _add(one, share, other):
    """Return one + share * other."""
    return one[0] + share * other[0], one[1] + share * other[1], one[2] + share * other[2]


@compiled
def _store_hits(t_mins, t_maxs, block, count, hits):
    """Write t, within the ray's limits, u, v and side of a block's hits to their targets."""
    tuv, volumes = block.vectors[_TUV], block.volumes
    t, u, v, is_front, targets = hits.t, hits.u, hits.v, hits.is_front, block.targets
    for hit in range(count):
        ray, target = block.rays[hit], targets[hit]
        t_min = t_mins[ray] if len(t_mins) > 1 else t_mins[0]
        t_max = t_maxs[ray] if len(t_maxs) > 1 else t_maxs[0]
        t[target] = min(max(tuv[0, hit], t_min), t_max, _MOST_T)
        u[target], v[target], is_front[target] = tuv[1, hit], tuv[2, hit], volumes[hit] > 0.0


@compiled
def _store_locations(triangles, found_ints, block, count, locations):
    """Write the points of a block's hits to their targets, in the file's coordinates."""
    vectors, sources, targets = block.vectors, block.sources, block.targets
    vertices, faces = triangles.vertices, triangles.faces
    inverse_scale = 1.0 / triangles.scale
    for hit in range(count):
        u, v = vectors[_TUV, 1, hit], vectors[_TUV, 2, hit]
        first = faces[found_ints[sources[hit], HIT_PRIM_ID], 0]
        for axis in range(3):
            offset = u * vectors[_AB, axis, hit] + v * vectors[_AC, axis, hit]
            locations[targets[hit], axis] = vertices[first, axis] + offset * inverse_scale
