"""Every intersection of every ray with every primitive of a world that there can be, and how sure each of them is.

The device rounds, so a ray that passes an edge, a sphere's outline, or one of its own limits closer than the tolerance
may hit a primitive or miss it: such an intersection is listed, but is not sure. One that is not listed cannot be.

Triangles are met in an orthonormal frame of the ray, instead of the device's shear, and spheres in their own space.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...device.host.loops import Loops
from ...geometry.mesh import Mesh
from ...geometry.spheres import join_numbers
from ...scene.state import SceneState
from .instances import Instance, Tolerance, find_instances, world_radius

ORACLE = Loops("check/oracle")

# Intersections that there is room for at first, for each ray of an instance.
_FIRST_ROOM = 4

# An intersection; `intersection_t` of cl/host/check/oracle.cl.
_INTERSECTION = np.dtype(
    [("ray", "i8"), ("instance_id", "i8"), ("geometry_id", "i8"), ("prim_id", "i8"), ("t", "f8"), ("t_low", "f8"),
     ("t_high", "f8"), ("t_slack", "f8"), ("side", "i8"), ("is_sure", "i8"), ("twin_instance", "i8"),
     ("twin_prim", "i8")],
)  # fmt: skip
_WORDS = _INTERSECTION.itemsize // 8


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
        return cls._make(np.ascontiguousarray(values) for values in (one, other, least, most, masks, lengths))


class Intersections(NamedTuple):
    """Intersections that there can be, ray by ray, each ray's in the order of (t, instance, primitive).

    Attributes
    ----------
    offsets : (rays + 1,) int64
        The intersections of ray i are those from ``offsets[i]`` to ``offsets[i + 1]``.
    found : (m,) structured
        ``ray``, ``instance_id``, ``geometry_id``, ``prim_id`` : int64
        ``t`` : float64
        ``t_low``, ``t_high`` : float64
            Where the device may find it. A t beyond the limits of the ray is reported as the limit.
        ``t_slack`` : float64
            By how much t may be off besides, where it is compared with t of other instances.
        ``side`` : int64
            -1 where the ray enters a sphere, 1 where it leaves it, 0 of triangles.
        ``is_sure`` : int64
            1 where the device must find it, else 0.
        ``twin_instance``, ``twin_prim`` : int64
            The first instance that is placed as this one, and the first primitive of the geometry that equals this
            one: the device sees them at exactly the same t.
    """

    offsets: NDArray[np.int64]
    found: NDArray[np.void]

    @property
    def words(self) -> NDArray[np.int64]:
        """(m, 12) int64: what is found as loops take it."""
        return self.found.view(np.int64).reshape(-1, _WORDS)

    @property
    def sure_counts(self) -> NDArray[np.int64]:
        """(rays,) int64: the least number of hits of each ray; the greatest is that of the intersections."""
        return np.bincount(self.found["ray"][self.found["is_sure"] != 0], minlength=len(self.offsets) - 1)


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
    seen, parts = _SeenRays.make(len(directions)), [np.empty(0, _INTERSECTION)]
    for instance in instances:
        view = instance.view(granted, size)
        count = ORACLE.see_rays(view, rays.origins, directions, rays.masks, *seen)
        if count:
            parts.append(_find(instance, view, rays, _SeenRays._make(values[:count] for values in seen)))
    found = np.concatenate(parts)
    found = found[np.lexsort([found[name] for name in ("prim_id", "instance_id", "t", "ray")])]
    found["twin_instance"], found["twin_prim"] = _find_twins(world, found)
    offsets = np.concatenate(([0], np.cumsum(np.bincount(found["ray"], minlength=len(directions)))))
    return Intersections(offsets, found)


def _find(instance: Instance, view: NDArray[np.float64], rays: Rays, seen: _SeenRays) -> NDArray[np.void]:
    """Return the intersections of rays with the primitives of an instance."""
    shape, limits = instance.shape, (view, rays.t_min, rays.t_max, rays.lengths)
    found = np.empty(_FIRST_ROOM * len(seen.ids) + 1, _INTERSECTION)
    while True:
        words = found.view(np.int64).reshape(-1, _WORDS)
        if isinstance(shape, Mesh):
            vertices = np.ascontiguousarray(shape.local_vertices.astype(np.float64) @ instance.to_world.T)
            triangles = vertices, shape.faces, shape.degenerate_faces
            count = ORACLE.meet_triangles(*limits, *seen[:-1], *triangles, words)
        else:
            feet, directions = seen.feet @ instance.to_local.T, seen.directions @ instance.to_local.T
            stretches = np.linalg.norm(directions, axis=1)
            local = seen.ids, feet, directions / stretches[:, None], seen.shifts, seen.local_blurs, stretches
            spheres = shape.local_centres.astype(np.float64), shape.local_radii.astype(np.float64)
            count = ORACLE.meet_spheres(*limits, *local, *spheres, words)
        if count <= len(found):
            return found[:count]
        found = np.empty(count, _INTERSECTION)


def _find_twins(world: SceneState, found: NDArray[np.void]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first instance like that of each intersection, and the first primitive like its primitive."""
    transforms = np.ascontiguousarray(world.transforms, np.float64).reshape(-1, 16)
    instances = _first_equal(np.column_stack((np.asarray(world.geometry_ids, np.float64), transforms)))
    prims = np.empty(len(found), np.int64)
    for geometry_id, shape in enumerate(world.shapes):
        rows = join_numbers(shape, "local_")
        if rows is None:
            corners = shape.find_corners()
            rows = corners.points[corners.ids].reshape(-1, 9)
        mine = found["geometry_id"] == geometry_id
        prims[mine] = _first_equal(rows)[found["prim_id"][mine]]
    return instances[found["instance_id"]], prims


def _first_equal(rows: NDArray[np.floating]) -> NDArray[np.int64]:
    """Return for each row the index of the first one that equals it."""
    if len(rows) == 0:
        return np.empty(0, np.int64)
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return first[inverse.reshape(-1)]
