"""Every intersection of every ray with every primitive of a world that there can be, and how sure each of them is.

The device rounds, so a ray that passes an edge, a sphere's outline, or one of its own limits closer than the tolerance
may hit a primitive or miss it: such an intersection is listed, but is not sure. One that is not listed cannot be.

Triangles are met in an orthonormal frame of the ray, instead of the device's shear, and spheres in their own space.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...geometry.mesh import Mesh
from ...scene.state import SceneState
from ...support.compiled import compiled
from ...support.loop_functions import add_scaled, dot, subtract
from .instances import Instance, Tolerance, find_blur, find_instances, world_radius

# Intersections that there is room for at first, for each ray of an instance.
_FIRST_ROOM = 4

# The rays of a world are advanced to within this many times `Tolerance.near` radii of it; beyond, t does not grow.
_ADVANCED = 2.0

# A component of a normal is a difference of two products, each of two edges: float64 rounds it by this share of the
# square of the largest edge at most.
_NORMAL_ROUNDING = 2.0**-50

# An intersection as it is found: the fields of `Intersections` but the twins, and the ray.
_FOUND = np.dtype(
    [("ray", "i8"), ("instance_id", "i8"), ("geometry_id", "i8"), ("prim_id", "i8"), ("t", "f8"), ("t_low", "f8"),
     ("t_high", "f8"), ("t_slack", "f8"), ("side", "i8"), ("is_sure", "?")],
    align=True,
)  # fmt: skip


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
        The intersections of ray i are those from ``offsets[i]`` to ``offsets[i + 1]``.
    instance_id, geometry_id, prim_id : (m,) int64
    t : (m,) float64
    t_low, t_high : (m,) float64
        Where the device may find it. A t beyond the limits of the ray is reported as the limit.
    t_slack : (m,) float64
        By how much t may be off besides, where it is compared with t of other instances.
    side : (m,) int64
        -1 where the ray enters a sphere, 1 where it leaves it, 0 of triangles.
    is_sure : (m,) bool
        Whether the device must find it.
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
    side: NDArray[np.int64]
    is_sure: NDArray[np.bool_]
    twin_instance: NDArray[np.int64]
    twin_prim: NDArray[np.int64]

    @property
    def ray_id(self) -> NDArray[np.int64]:
        """(m,) int64: the ray of each intersection."""
        return np.repeat(np.arange(len(self.offsets) - 1), np.diff(self.offsets))

    @property
    def sure_counts(self) -> NDArray[np.int64]:
        """(rays,) int64: the least number of hits of each ray; the greatest is that of the intersections."""
        return np.bincount(self.ray_id[self.is_sure], minlength=len(self.offsets) - 1)


class _SeenRays(NamedTuple):
    """Rays as an instance sees them, in its unit around its centre: from the points that are nearest to the centre."""

    ids: NDArray[np.int64]
    feet: NDArray[np.float64]
    directions: NDArray[np.float64]
    shifts: NDArray[np.float64]
    blurs: NDArray[np.float64]
    local_blurs: NDArray[np.float64]

    @classmethod
    def make(cls, count: int) -> Self:
        """Return arrays that are not yet written."""
        return cls(np.empty(count, np.int64), *np.empty((2, count, 3)), *np.empty((3, count)))


class _Asked(NamedTuple):
    """The rays and an instance, see `Instance.numbers`; what the device may be off; and the radius of the world."""

    instance: Any
    tolerance: Tolerance
    size: float
    rays: Rays


def find_intersections(
    world: SceneState, rays: Rays, tolerance: Tolerance | None = None, known_instances: list[Instance] | None = None
) -> Intersections:
    """Return every intersection that there can be.

    Parameters
    ----------
    world : SceneState
    rays : Rays
    tolerance : Tolerance, optional
        How far the device may be off.
    known_instances : list of Instance, optional
        What `find_instances` returns for the world.

    Notes
    -----
    O(rays x primitives of all instances), less those whose bounding sphere a ray passes by.
    """
    granted = tolerance or Tolerance()
    instances = find_instances(world) if known_instances is None else known_instances
    size = world_radius(instances)
    longest = np.abs(rays.directions).max(axis=1, keepdims=True)
    directions = rays.directions / longest
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    seen, parts = _SeenRays.make(len(directions)), [np.empty(0, _FOUND)]
    for instance in instances:
        count = _see(instance.numbers, granted, size, rays, directions, seen)
        if count:
            parts.append(_find(instance, granted, size, rays, _SeenRays._make(values[:count] for values in seen)))
    found = np.concatenate(parts)
    found = found[np.lexsort([found[name] for name in ("prim_id", "instance_id", "t", "ray")])]
    offsets = np.concatenate(([0], np.cumsum(np.bincount(found["ray"], minlength=len(directions)))))
    fields = (np.ascontiguousarray(found[name]) for name in Intersections._fields[1:-2])
    return Intersections._make((offsets, *fields, *_find_twins(world, found)))


@compiled(error_model="numpy")
def _see(instance, tolerance, size, rays, directions, seen):
    """Write the rays that may meet an instance; return how many there are. The directions are 1 long."""
    count = 0
    for ray in range(len(directions)):
        if rays.masks[ray] & instance.mask == 0:
            continue
        direction = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        x, y, z = subtract(rays.origins[ray], instance.centre)
        origin = x / instance.unit, y / instance.unit, z / instance.unit
        shift = -dot(origin, direction)
        foot = add_scaled(origin, shift, direction)
        more = -dot(foot, direction)
        foot = add_scaled(foot, more, direction)
        blur, local_blur = find_blur(instance, tolerance, np.sqrt(dot(origin, origin)), size)
        if not np.sqrt(dot(foot, foot)) <= instance.radius + blur:
            continue
        for axis in range(3):
            seen.feet[count, axis], seen.directions[count, axis] = foot[axis], direction[axis]
        seen.ids[count], seen.shifts[count], seen.blurs[count] = ray, shift + more, blur
        seen.local_blurs[count] = local_blur
        count += 1
    return count


def _find(instance: Instance, tolerance: Tolerance, size: float, rays: Rays, seen: _SeenRays) -> NDArray[np.void]:
    """Return the intersections of rays with the primitives of an instance."""
    shape, asked = instance.shape, _Asked(instance.numbers, tolerance, size, rays)
    found = np.empty(_FIRST_ROOM * len(seen.ids) + 1, _FOUND)
    while True:
        if isinstance(shape, Mesh):
            corners = shape.local_vertices.astype(np.float64) @ instance.to_world.T
            triangles = np.ascontiguousarray(corners), shape.faces, shape.degenerate_faces
            count = _meet_triangles(*triangles, asked, seen, found)
        else:
            directions = seen.directions @ instance.to_local.T
            stretches = np.linalg.norm(directions, axis=1)
            local = seen._replace(feet=seen.feet @ instance.to_local.T, directions=directions / stretches[:, None])
            spheres = shape.local_centres.astype(np.float64), shape.local_radii.astype(np.float64)
            count = _meet_spheres(*spheres, asked, local, stretches, found)
        if count <= len(found):
            return found[:count]
        found = np.empty(count, _FOUND)


@compiled(error_model="numpy")
def _add(found, count, asked, ray, prim, side, is_sure, distances):
    """Write an intersection that the limits of the ray allow, if there is room; return how many there are with it."""
    instance, tolerance, size, rays = asked
    length, t_min, t_max = rays.lengths[ray], rays.t_min[ray], rays.t_max[ray]
    scale = instance.unit / length
    t, low, high = distances[0] * scale, distances[1] * scale, distances[2] * scale
    slack = min(tolerance.order * abs(t), tolerance.order * _ADVANCED * tolerance.near * size / length)
    if not (high + slack >= t_min and low - slack <= t_max):
        return count
    if count < len(found):
        one = found[count]
        one.ray, one.instance_id, one.geometry_id, one.prim_id = ray, instance.instance_id, instance.geometry_id, prim
        one.t, one.t_low, one.t_high, one.t_slack, one.side = t, low, high, slack, side
        one.is_sure = is_sure and low - slack > t_min and high + slack < t_max
    return count + 1


@compiled
def _meet_triangles(corners, faces, degenerate, asked, seen, found):
    """Write the intersections that there is room for; return how many there are."""
    frame = np.empty((3, 3), np.float64)
    count = 0
    for index in range(len(seen.ids)):
        make_frame(seen.directions[index], frame)
        foot, shift, blur = seen.feet[index], seen.shifts[index], seen.blurs[index]
        for prim in range(len(faces)):
            if degenerate[prim]:
                continue
            a = project(corners, faces[prim, 0], foot, frame)
            b = project(corners, faces[prim, 1], foot, frame)
            c = project(corners, faces[prim, 2], foot, frame)
            sureness, height, low, high = meet_triangle(a, b, c, blur)
            if sureness >= 0:
                distances = shift + height, shift + low, shift + high
                count = _add(found, count, asked, seen.ids[index], prim, 0, sureness > 0, distances)
    return count


@compiled
def _meet_spheres(centres, radii, asked, seen, stretches, found):
    """Write the intersections that there is room for; return how many there are. The rays are local."""
    count = 0
    for index in range(len(stretches)):
        foot, direction, shift = seen.feet[index], seen.directions[index], seen.shifts[index]
        stretch, blur = stretches[index], seen.local_blurs[index]
        for prim in range(len(radii)):
            way = subtract(centres[prim], foot)
            along = dot(way, direction)
            way = add_scaled(way, -along, direction)
            beside, radius = np.sqrt(dot(way, way)), radii[prim]
            if beside > radius + blur:
                continue
            # Half the chord, and what the blur can make of it: much, where the ray is almost a tangent.
            half = _half_chord(radius, beside)
            half_low, half_high = _half_chord(radius - blur, beside + blur), _half_chord(radius + blur, beside - blur)
            for side in (-1, 1):
                one, other = along + side * half_low, along + side * half_high
                low, high = min(one, other) - blur, max(one, other) + blur
                is_sure, ray = beside < radius - blur, seen.ids[index]
                distances = shift + (along + side * half) / stretch, shift + low / stretch, shift + high / stretch
                count = _add(found, count, asked, ray, prim, side, is_sure, distances)
    return count


@compiled
def _half_chord(radius, beside):
    """Return half the chord of a circle at a distance from its centre; 0 beside the circle."""
    beside = max(beside, 0.0)
    return np.sqrt((radius - beside) * (radius + beside)) if beside < radius else 0.0


@compiled
def make_frame(direction, frame):
    """Write an orthonormal frame whose last row is the direction, normalised; return the direction's length."""
    length = np.sqrt((direction**2).sum())
    along = direction / length
    # Any axis that is far from parallel to the ray gives a stable first cross product.
    axis = np.argmin(np.abs(along))
    helper = np.zeros(3)
    helper[axis] = 1.0
    frame[2] = along
    frame[0] = np.cross(helper, along)
    frame[0] /= np.sqrt((frame[0] ** 2).sum())
    frame[1] = np.cross(along, frame[0])
    return length


@compiled
def project(vertices, vertex, origin, frame):
    """Return a corner's coordinates in the ray's frame: two across the ray, one along it."""
    x = vertices[vertex, 0] - origin[0]
    y = vertices[vertex, 1] - origin[1]
    z = vertices[vertex, 2] - origin[2]
    return (
        x * frame[0, 0] + y * frame[0, 1] + z * frame[0, 2],
        x * frame[1, 0] + y * frame[1, 1] + z * frame[1, 2],
        x * frame[2, 0] + y * frame[2, 1] + z * frame[2, 2],
    )


@compiled
def meet_triangle(a, b, c, blur):
    """Test one triangle against the ray along the z axis from zero.

    Parameters
    ----------
    a, b, c : tuples of 3 float64
        The corners in the ray's frame, see `project`.
    blur : float64
        How far the device may see each corner from where it is, across the ray and along it.

    Returns
    -------
    sureness : int
        1 surely hit, 0 too close to call, -1 surely missed.
    distance, low, high : float64
        Along the ray, and the least and the greatest that the device may find; 0 of a triangle that is surely missed.

    Notes
    -----
    While the corners move by up to the blur, a ray that is farther than that from all edges stays on its side of them.
    A point of the moved triangle has moved by no more than the blur either. So a hit is at the height of a point of
    the exact triangle that is as near to the ray, give or take the blur. Both hold for slivers thinner than the blur.
    """
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = a, b, c
    if min(ax, bx, cx) > blur or max(ax, bx, cx) < -blur or min(ay, by, cy) > blur or max(ay, by, cy) < -blur:
        return -1, 0.0, 0.0, 0.0

    # On which side of the edges does the ray pass, and how far from them?
    side_a, side_b, side_c = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
    is_beside = (side_a < 0.0 or side_b < 0.0 or side_c < 0.0) and (side_a > 0.0 or side_b > 0.0 or side_c > 0.0)
    nearest = min(
        _distance_to_segment(bx, by, cx, cy), _distance_to_segment(cx, cy, ax, ay), _distance_to_segment(ax, ay, bx, by)
    )
    if is_beside and nearest > blur:
        return -1, 0.0, 0.0, 0.0
    sureness = 1 if nearest > blur else 0

    # Where does it cross the plane? A triangle that is seen edge-on is crossed anywhere between its corners.
    nx = (by - ay) * (cz - az) - (bz - az) * (cy - ay)
    ny = (bz - az) * (cx - ax) - (bx - ax) * (cz - az)
    nz = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    low, high = min(az, bz, cz), max(az, bz, cz)
    if nz == 0.0:
        return sureness, (low + high) / 2, low - blur, high + blur
    # A shift along the ray, and one across it, which a slanted plane turns into one along it.
    height = (nx * ax + ny * ay + nz * az) / nz
    slant = np.sqrt(nx * nx + ny * ny + nz * nz) / abs(nz)
    slack = blur * (1.0 + slant)
    # Of corners that are nearly in one line, float64 itself rounds the normal off.
    reach = max(abs(ax), abs(ay), abs(bx), abs(by), abs(cx), abs(cy)) + (high - low)
    slack += _NORMAL_ROUNDING * reach * reach / abs(nz) * (1.0 + slant) * reach
    return sureness, min(max(height, low), high), max(height - slack, low - blur), min(height + slack, high + blur)


@compiled
def _distance_to_segment(ax, ay, bx, by):
    """Return the distance of zero from the segment between two points."""
    dx, dy = bx - ax, by - ay
    square = dx * dx + dy * dy
    share = min(max(-(ax * dx + ay * dy) / square, 0.0), 1.0) if square > 0.0 else 0.0
    return np.hypot(ax + share * dx, ay + share * dy)


def _find_twins(world: SceneState, found: NDArray[np.void]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first instance like that of each intersection, and the first primitive like its primitive."""
    transforms = np.ascontiguousarray(world.transforms, np.float64).reshape(-1, 16)
    instances = _first_equal(np.column_stack((np.asarray(world.geometry_ids, np.float64), transforms)))
    prims = np.empty(len(found), np.int64)
    for geometry_id, shape in enumerate(world.shapes):
        if isinstance(shape, Mesh):
            rows = shape.local_vertices[shape.faces].reshape(-1, 9)
        else:
            rows = np.column_stack((shape.local_centres, shape.local_radii))
        mine = found["geometry_id"] == geometry_id
        prims[mine] = _first_equal(rows)[found["prim_id"][mine]]
    return instances[found["instance_id"]], prims


def _first_equal(rows: NDArray[np.floating]) -> NDArray[np.int64]:
    """Return for each row the index of the first one that equals it."""
    if len(rows) == 0:
        return np.empty(0, np.int64)
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return first[inverse.reshape(-1)]
