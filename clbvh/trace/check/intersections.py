"""Every crossing of every ray with every primitive of a scene that there can be, and how sure each of them is.

The device rounds, so a ray that passes an edge, a sphere's outline, or one of its own limits closer than the blur may
cross a primitive or miss it: such a crossing is listed, but is not sure. A crossing that is not listed cannot be.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...geometry.mesh import Mesh
from ...geometry.spheres import Shape
from ...support.compiled import compiled
from .instances import Instance, SceneState, Tolerance, find_instances, world_radius
from .triangle import judge_triangle, make_frame, project

# Intersections that there is room for at first, for each ray of an instance.
_FIRST_ROOM = 4

# The rays of a scene are advanced to within this many times `Tolerance.near` radii of it; beyond, t does not grow.
_ADVANCED = 2.0

# Room for rounding where a ray is said to pass an instance by, as a share of the bound and of the way to the instance;
# an instance this many scenes away is never said to be passed.
_PASS_SHARE, _PASS_ROUNDING, _FARTHEST = 1.0 + 2.0**-20, 2.0**-44, 2.0**300


class Rays(NamedTuple):
    """Rays of the world, one element for each.

    Attributes
    ----------
    origins, directions : (n, 3) float64
    t_min, t_max : (n,) float64
    masks : (n,) uint32
        Instances whose mask shares no bit with the ray's are invisible to it.
    lengths : (n,) float64
        Of the directions.
    """

    origins: NDArray[np.float64]
    directions: NDArray[np.float64]
    t_min: NDArray[np.float64]
    t_max: NDArray[np.float64]
    masks: NDArray[np.uint32]
    lengths: NDArray[np.float64]

    @classmethod
    def make(
        cls,
        origins: ArrayLike,
        directions: ArrayLike,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike = 0xFFFFFFFF,
    ) -> Rays:
        """Return rays of the broadcast shape (n, 3); limits and masks broadcast to (n,)."""
        one, other = np.broadcast_arrays(
            np.atleast_2d(np.asarray(origins, np.float64)), np.atleast_2d(np.asarray(directions, np.float64))
        )
        count = len(one)
        longest = np.abs(other).max(axis=1)
        lengths = longest * np.linalg.norm(other / longest[:, None], axis=1)
        least, most = (np.broadcast_to(np.asarray(limit, np.float64), count) for limit in (t_min, t_max))
        masks = np.broadcast_to(np.asarray(mask, np.uint32), count)
        return cls(np.ascontiguousarray(one), np.ascontiguousarray(other), least, most, masks, lengths)


class Intersections(NamedTuple):
    """Intersections that there can be, ray by ray, each ray's in the order of (t, instance, primitive).

    Attributes
    ----------
    offsets : (rays + 1,) int64
        The crossings of ray i are those from ``offsets[i]`` to ``offsets[i + 1]``.
    instance_id, geometry_id, prim_id : (m,) int64
    t : (m,) float64
    t_low, t_high : (m,) float64
        Where the device may find it. A t beyond the limits of the ray is reported as the limit.
    t_slack : (m,) float64
        By how much t may be off besides, where it is compared with t of other instances.
    is_sure : (m,) bool
        Whether the device must find it.
    side : (m,) int64
        -1 where the ray enters a sphere, 1 where it leaves it, 0 of triangles.
    twin_instance, twin_prim : (m,) int64
        The first instance that is placed as this one, and the first primitive of the geometry that equals this one:
        the device sees them at exactly the same t.
    """

    offsets: NDArray[np.int64]
    instance_id: NDArray[np.int64]
    geometry_id: NDArray[np.int64]
    prim_id: NDArray[np.int64]
    t: NDArray[np.float64]
    t_low: NDArray[np.float64]
    t_high: NDArray[np.float64]
    t_slack: NDArray[np.float64]
    is_sure: NDArray[np.bool_]
    side: NDArray[np.int64]
    twin_instance: NDArray[np.int64]
    twin_prim: NDArray[np.int64]

    @property
    def ray_id(self) -> NDArray[np.int64]:
        """(m,) int64: the ray of each crossing."""
        return np.repeat(np.arange(len(self.offsets) - 1), np.diff(self.offsets))

    @property
    def sure_counts(self) -> NDArray[np.int64]:
        """(rays,) int64: the least number of crossings of each ray; the greatest is that of the crossings."""
        return np.bincount(self.ray_id[self.is_sure], minlength=len(self.offsets) - 1)


class _Found(NamedTuple):
    """Intersections of one instance: ray, primitive, side, whether it is sure, and distances along the ray."""

    rays: NDArray[np.int64]
    prims: NDArray[np.int64]
    sides: NDArray[np.int64]
    is_sure: NDArray[np.bool_]
    distances: NDArray[np.float64]

    @classmethod
    def make(cls, room: int) -> _Found:
        """Return arrays that are not yet written."""
        rays, prims, sides = np.empty((3, room), np.int64)
        return cls(rays, prims, sides, np.empty(room, np.bool_), np.empty((room, 3)))


class _SeenRays(NamedTuple):
    """Rays as an instance sees them, in its unit around its centre: the points that are nearest to the centre."""

    feet: NDArray[np.float64]
    directions: NDArray[np.float64]
    shifts: NDArray[np.float64]
    blurs: NDArray[np.float64]
    local_blurs: NDArray[np.float64]


def find_intersections(
    scene: SceneState, rays: Rays, blur: Tolerance | None = None, known_placements: list[Instance] | None = None
) -> Intersections:
    """Return every crossing that there can be.

    Parameters
    ----------
    scene : SceneState
    rays : Rays
    blur : Tolerance, optional
        How far the device may be off.
    known_placements : list of Instance, optional
        What `find_instances` returns for the scene.

    Notes
    -----
    O(rays x primitives of all instances), less those whose bounding sphere a ray passes by.
    """
    granted = blur or Tolerance()
    placements = find_instances(scene) if known_placements is None else known_placements
    twins = _find_twins(scene)
    size = world_radius(placements) if placements else 0.0
    with np.errstate(over="ignore"):
        slack_of_rays = granted.order * _ADVANCED * granted.near * size / rays.lengths
    longest = np.abs(rays.directions).max(axis=1, keepdims=True)
    directions = rays.directions / longest
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    near = np.empty(len(directions), np.int64)
    parts = []
    for placed in placements:
        chosen = near[: _find_near(_bound(placed, granted, size), rays.origins, directions, rays.masks, near)]
        if len(chosen):
            parts.append(_cross(placed, rays, directions, chosen, granted, size, slack_of_rays, twins))
    return _sort(parts, len(rays.lengths))


class _Bound(NamedTuple):
    """The sphere around an instance, its mask, and what blurs rays of it; lengths as shares of `size`, of the scene.

    `entering` is that of `Tolerance` times the growth, and from farther away than `near` it does not grow.
    """

    x: float
    y: float
    z: float
    radius: float
    entering: float
    near: float
    pair: float
    mask: np.uint32
    size: float


def _bound(placed: Instance, blur: Tolerance, size: float) -> _Bound:
    size = size if size > 0.0 else 1.0
    x, y, z = placed.centre.tolist()
    radius = placed.radius * (placed.unit / size)
    return _Bound(
        x, y, z, radius, placed.growth * blur.entering, blur.near * radius, blur.pair, np.uint32(placed.mask), size
    )  # fmt: skip


@compiled
def _find_near(bound, origins, directions, masks, near):
    """Write the rays that may meet an instance, or pass it by less than the blur; return how many there are."""
    count = 0
    for ray in range(len(origins)):
        if masks[ray] & bound.mask == 0:
            continue
        x, y, z = (
            (origins[ray, 0] - bound.x) / bound.size, (origins[ray, 1] - bound.y) / bound.size,
            (origins[ray, 2] - bound.z) / bound.size,
        )  # fmt: skip
        dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        along = x * dx + y * dy + z * dz
        side_x, side_y, side_z = x - along * dx, y - along * dy, z - along * dz
        way = abs(x) + abs(y) + abs(z)
        reach = bound.radius + min(way, bound.near)
        most = bound.radius + bound.entering * reach + bound.pair * (way + 1.0)
        most = most * _PASS_SHARE + _PASS_ROUNDING * way
        if side_x * side_x + side_y * side_y + side_z * side_z <= most * most or not way <= _FARTHEST:
            near[count] = ray
            count += 1
    return count


def _cross(
    placed: Instance,
    rays: Rays,
    directions: NDArray[np.float64],
    near: NDArray[np.int64],
    blur: Tolerance,
    size: float,
    slack_of_rays: NDArray[np.float64],
    twins: _Twins,
) -> tuple[NDArray, ...]:
    """Return the fields of `Intersections` of one instance and some rays, with the ray in place of the offsets."""
    seen, indices = _see(placed, rays.origins[near], directions[near], blur, size)
    indices = near[indices]
    found = _find(placed.shape, placed, seen)
    ray = indices[found.rays]
    with np.errstate(over="ignore", under="ignore"):
        t, low, high = (found.distances * (placed.unit / rays.lengths[ray])[:, None]).T
    slack = np.minimum(blur.order * np.abs(t), slack_of_rays[ray])
    t_min, t_max = rays.t_min[ray], rays.t_max[ray]
    can_be = (high + slack >= t_min) & (low - slack <= t_max)
    is_sure = found.is_sure & (low - slack > t_min) & (high + slack < t_max)
    prims = found.prims
    ids = [np.full(len(ray), value, np.int64) for value in (placed.instance_id, placed.geometry_id)]
    twin_instance = np.full(len(ray), twins.instances[placed.instance_id], np.int64)
    twin_prim = twins.prims[placed.geometry_id][prims]
    fields = ray, *ids, prims, t, low, high, slack, is_sure, found.sides, twin_instance, twin_prim
    return tuple(values[can_be] for values in fields)


def _see(
    placed: Instance, origins: NDArray[np.float64], directions: NDArray[np.float64], blur: Tolerance, size: float
) -> tuple[_SeenRays, NDArray[np.int64]]:
    """Return the rays that can meet an instance as it sees them, and their indices; the directions are 1 long."""
    origins = placed.to_unit(origins)
    shifts = -_dot(origins, directions)
    feet = origins + shifts[:, None] * directions
    more = -_dot(feet, directions)
    feet, shifts = feet + more[:, None] * directions, shifts + more

    blurs, local_blurs = placed.blurs(blur, origins, size)
    indices = np.flatnonzero(np.linalg.norm(feet, axis=1) <= placed.radius + blurs)
    return _SeenRays(*(values[indices] for values in (feet, directions, shifts, blurs, local_blurs))), indices


def _dot(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.einsum("ni,ni->n", one, other)


def _find(shape: Shape, placed: Instance, seen: _SeenRays) -> _Found:
    """Return the crossings of the rays with the primitives of an instance; distances in units."""
    found = _Found.make(_FIRST_ROOM * len(seen.shifts) + 1)
    while True:
        if isinstance(shape, Mesh):
            corners = shape.local_vertices.astype(np.float64) @ placed.to_world.T
            count = _cross_triangles(np.ascontiguousarray(corners), shape.faces, shape.degenerate_faces, seen, found)
        else:
            local_directions = seen.directions @ placed.to_local.T
            stretches = np.linalg.norm(local_directions, axis=1)
            local = _SeenRays(
                np.ascontiguousarray(seen.feet @ placed.to_local.T), local_directions / stretches[:, None],
                seen.shifts, seen.blurs, seen.local_blurs,
            )  # fmt: skip
            centres, radii = shape.local_centres.astype(np.float64), shape.local_radii.astype(np.float64)
            count = _cross_spheres(centres, radii, local, stretches, found)
        if count <= len(found.rays):
            return _Found._make(values[:count] for values in found)
        found = _Found.make(count)


@compiled
def _cross_triangles(corners, faces, degenerate, seen, found):
    """Write the crossings that there is room for; return how many there are."""
    frame = np.empty((3, 3), np.float64)
    verdict = np.empty(4, np.float64)
    count = 0
    for ray in range(len(seen.shifts)):
        make_frame(seen.directions[ray], frame)
        foot, shift, blur = seen.feet[ray], seen.shifts[ray], seen.blurs[ray]
        for prim in range(len(faces)):
            if degenerate[prim]:
                continue
            a = project(corners, faces[prim, 0], foot, frame)
            b = project(corners, faces[prim, 1], foot, frame)
            c = project(corners, faces[prim, 2], foot, frame)
            judge_triangle(a, b, c, blur, verdict)
            if verdict[0] < 0.0:
                continue
            if count < len(found.rays):
                found.rays[count], found.prims[count], found.sides[count] = ray, prim, 0
                found.is_sure[count] = verdict[0] > 0.0
                found.distances[count, 0] = shift + verdict[1]
                found.distances[count, 1] = shift + verdict[2]
                found.distances[count, 2] = shift + verdict[3]
            count += 1
    return count


@compiled
def _cross_spheres(centres, radii, seen, stretches, found):
    """Write the crossings that there is room for; return how many there are. The rays are local."""
    count = 0
    for ray in range(len(stretches)):
        foot, direction, blur, stretch = seen.feet[ray], seen.directions[ray], seen.local_blurs[ray], stretches[ray]
        for prim in range(len(radii)):
            x, y, z = centres[prim, 0] - foot[0], centres[prim, 1] - foot[1], centres[prim, 2] - foot[2]
            along = x * direction[0] + y * direction[1] + z * direction[2]
            x, y, z = x - along * direction[0], y - along * direction[1], z - along * direction[2]
            beside, radius = np.sqrt(x * x + y * y + z * z), radii[prim]
            if beside > radius + blur:
                continue
            # Half the chord, and what the blur can make of it: much, where the ray is almost a tangent.
            half = _half_chord(radius, beside)
            half_low, half_high = _half_chord(radius - blur, beside + blur), _half_chord(radius + blur, beside - blur)
            for side in (-1, 1):
                if count < len(found.rays):
                    found.rays[count], found.prims[count], found.sides[count] = ray, prim, side
                    found.is_sure[count] = beside < radius - blur
                    one, other = along + side * half_low, along + side * half_high
                    found.distances[count, 0] = seen.shifts[ray] + (along + side * half) / stretch
                    found.distances[count, 1] = seen.shifts[ray] + (min(one, other) - blur) / stretch
                    found.distances[count, 2] = seen.shifts[ray] + (max(one, other) + blur) / stretch
                count += 1
    return count


@compiled
def _half_chord(radius, beside):
    """Return half the chord of a circle at a distance from its centre; 0 beside the circle."""
    beside = max(beside, 0.0)
    return np.sqrt((radius - beside) * (radius + beside)) if beside < radius else 0.0


class _Twins(NamedTuple):
    """The first instance like each instance, and for each shape the first primitive like each primitive."""

    instances: NDArray[np.int64]
    prims: list[NDArray[np.int64]]


def _find_twins(scene: SceneState) -> _Twins:
    transforms = np.ascontiguousarray(scene.transforms, np.float64).reshape(-1, 16)
    keys = np.concatenate((np.asarray(scene.geometry_ids, np.float64)[:, None], transforms), axis=1)
    prims = []
    for shape in scene.shapes:
        if isinstance(shape, Mesh):
            prims.append(_first_equal(shape.local_vertices[shape.faces].reshape(-1, 9)))
        else:
            prims.append(_first_equal(np.column_stack((shape.local_centres, shape.local_radii))))
    return _Twins(_first_equal(keys), prims)


def _first_equal(rows: NDArray[np.floating]) -> NDArray[np.int64]:
    """Return for each row the index of the first one that equals it."""
    if len(rows) == 0:
        return np.empty(0, np.int64)
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return first[inverse.reshape(-1)]


def _sort(parts: list[tuple[NDArray, ...]], ray_count: int) -> Intersections:
    if not parts:
        ids, numbers = np.empty(0, np.int64), np.empty(0)
        nothing = ids, ids, ids, numbers, numbers, numbers, numbers, np.empty(0, np.bool_), ids, ids, ids
        return Intersections(np.zeros(ray_count + 1, np.int64), *nothing)
    ray, *fields = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.lexsort((fields[2], fields[0], fields[3], ray))
    offsets = np.concatenate(([0], np.cumsum(np.bincount(ray, minlength=ray_count))))
    return Intersections(offsets, *(values[order] for values in fields))
