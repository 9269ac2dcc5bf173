"""The cost of rays: node steps and triangle tests, counted on the host, step for step as in `cl/traversal/bvh2.cl`.

A measure of trees that does not depend on a machine's speed, and needs no OpenCL device. Boxes, the order of children
and culling are those of the device, and so is float32. Only the edge functions are computed another way, which may
change the last bit of `t`. In the layouts `bvh4` and `bvh8`, the steps are those of `cl/traversal/wide.cl` from the
root: there are no entry points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...bvh import Bvh
from ...layouts.device_arrays import make_device_arrays
from ...structs import (
    BVH2_COUNT,
    BVH2_FIRST,
    BVH2_LANES,
    BVH2_MAX,
    BVH2_MIN,
    NO_PRIM,
    PACKED_RAY,
    PACKED_RAY_LANES,
    SPHERE,
    TRIANGLE_LANES,
    TRIANGLE_PRIM_ID,
)
from ...support.compiled import compiled
from ...support.host_threads import HostThreads, cut_range
from ..host.lanes import cross_corners, make_host_ray, pick, shear_corner
from ..host.walk import FIELD_COUNT, walk
from ..rays.batch import TreeBox, read_rays
from ..rays.pack import pack_rays
from ..traced_tree import WideArrays

# Rays that a thread takes at a time: rays of one picture differ much in their steps, so threads take many small shares.
_CHUNK_RAYS = 1 << 14

_FIELDS = 4


@dataclass(frozen=True, eq=False)
class Visits:
    """Counts for each ray.

    Attributes
    ----------
    node_steps : (n,) int32
        Interior nodes visited. Each step tests the boxes of both children.
    leaf_visits : (n,) int32
        Leaves visited.
    triangle_tests : (n,) int32
        Triangles tested in those leaves.
    prim_id : (n,) int32
        Face that the ray hits; -1 on a miss. With `any_hit`, the first one found.
    """

    node_steps: NDArray[np.int32]
    leaf_visits: NDArray[np.int32]
    triangle_tests: NDArray[np.int32]
    prim_id: NDArray[np.int32]

    @property
    def node_steps_per_ray(self) -> float:
        """The mean of `node_steps`; 0 without rays, as all means here."""
        return _mean(self.node_steps)

    @property
    def leaf_visits_per_ray(self) -> float:
        """The mean of `leaf_visits`."""
        return _mean(self.leaf_visits)

    @property
    def triangle_tests_per_ray(self) -> float:
        """The mean of `triangle_tests`."""
        return _mean(self.triangle_tests)

    @property
    def tests_per_ray(self) -> float:
        """Mean of node steps plus triangle tests: what the SAH cost estimates, with both costs 1."""
        return self.node_steps_per_ray + self.triangle_tests_per_ray


def _mean(counts: NDArray[np.int32]) -> float:
    return float(counts.mean(dtype=np.float64)) if len(counts) else 0.0


def count_visits(
    bvh: Bvh,
    origins: ArrayLike,
    directions: ArrayLike,
    *,
    t_min: ArrayLike = 0.0,
    t_max: ArrayLike = np.inf,
    any_hit: bool = False,
) -> Visits:
    """Cast rays on the host and count their steps.

    Parameters
    ----------
    bvh : Bvh
    origins, directions, t_min, t_max
        See `Tracer.closest_hit`.
    any_hit : bool, optional
        Stop at the first triangle that is hit, as `Tracer.any_hit` does.

    Returns
    -------
    Visits

    Raises
    ------
    QueryError
        See `Tracer.closest_hit`.

    Notes
    -----
    In this thread: about a million node steps in 10 ms.
    """
    return HostTraversal(bvh).count_visits(origins, directions, t_min=t_min, t_max=t_max, any_hit=any_hit)


class HostTraversal:
    """A tree that is ready to be traversed on the host, by compiled code, in any number of threads.

    Parameters
    ----------
    bvh : Bvh
    """

    def __init__(self, bvh: Bvh) -> None:
        arrays = make_device_arrays(bvh, "bvh2")
        self._trees = HostTrees.join([arrays.nodes], [arrays.blocks], [])
        self._start = TreeStart(0, 0, False, max(1, bvh.depth))
        self._box = TreeBox.around(bvh)

    def count_visits(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        any_hit: bool = False,
        threads: HostThreads | None = None,
    ) -> Visits:
        """Cast rays and count their steps; see the function `count_visits`.

        Parameters
        ----------
        origins, directions, t_min, t_max, any_hit
            See `count_visits`.
        threads : HostThreads, optional
            Threads that share the rays. Without them the calling thread casts all.
        """
        batch, _ = read_rays(origins, directions, t_min, t_max)
        rays = np.empty(batch.ray_count, PACKED_RAY)
        counts = np.zeros((batch.ray_count, _FIELDS), np.int32)
        nearest = np.empty(batch.ray_count, np.float32)

        def cast(begin: int, end: int) -> None:
            part = rays[begin:end]
            pack_rays(batch, batch.part(begin, end), self._box, part)
            packed = PackedRays(part["origin"], part["direction"], part["t_min"], part["t_max"])
            descend(self._trees, self._start, packed, any_hit, counts[begin:end], nearest[begin:end])

        if threads is None:
            cast(0, batch.ray_count)
        else:
            threads.run(cast, cut_range(0, batch.ray_count, -(-batch.ray_count // _CHUNK_RAYS)))
        return Visits(*np.ascontiguousarray(counts.T))


def count_wide_visits(bvh: Bvh, width: int, origins: ArrayLike, directions: ArrayLike) -> Visits:
    """Cast rays on the host through a wide tree, and count their steps.

    Parameters
    ----------
    bvh : Bvh
    width : int
        4 or 8.
    origins, directions
        See `Tracer.closest_hit`.

    Returns
    -------
    Visits
        A node step tests the boxes of all children of one node; a leaf visit is one block of up to `width` triangles.
    """
    batch, _ = read_rays(origins, directions, 0.0, np.inf)
    rays = np.empty(batch.ray_count, PACKED_RAY)
    pack_rays(batch, batch.part(0, batch.ray_count), TreeBox.around(bvh), rays)
    arrays = make_device_arrays(bvh, f"bvh{width}")
    found = np.empty((len(rays), FIELD_COUNT), np.int32)
    tree = WideArrays.of(arrays.nodes, arrays.blocks, width, arrays.stack_size)
    walk(tree, rays.view(np.float32).reshape(-1, PACKED_RAY_LANES), 0, found)
    return Visits(*np.ascontiguousarray(found.T))


_ZERO, _INFINITY = np.float32(0.0), np.float32(np.inf)

_SPHERE_LANES = SPHERE.itemsize // 4
_RADIUS, _SPHERE_PRIM_ID = _SPHERE_LANES - 2, _SPHERE_LANES - 1


class HostTrees(NamedTuple):
    """Trees in the `bvh2` layout, one after the other, as 4-byte lanes: floats, and the same as integers."""

    nodes: NDArray[np.float32]
    node_ints: NDArray[np.int32]
    triangles: NDArray[np.float32]
    triangle_ints: NDArray[np.int32]
    spheres: NDArray[np.float32]
    sphere_ints: NDArray[np.int32]

    @classmethod
    def join(
        cls,
        nodes: Sequence[NDArray[np.void]],
        triangles: Sequence[NDArray[np.void]],
        spheres: Sequence[NDArray[np.void]],
    ) -> Self:
        """Return the trees of these nodes, and of these blocks of either kind."""
        of_nodes, of_triangles, of_spheres = (
            _join_lanes(parts, width)
            for parts, width in ((nodes, BVH2_LANES), (triangles, TRIANGLE_LANES), (spheres, _SPHERE_LANES))
        )
        return cls(
            of_nodes, of_nodes.view(np.int32), of_triangles, of_triangles.view(np.int32), of_spheres,
            of_spheres.view(np.int32),
        )  # fmt: skip


def _join_lanes(parts: Sequence[NDArray[np.void]], width: int) -> NDArray[np.float32]:
    rows = [np.ascontiguousarray(part).view(np.float32).reshape(-1, width) for part in parts]
    return rows[0] if len(rows) == 1 else np.concatenate([np.empty((0, width), np.float32), *rows])


class PackedRays(NamedTuple):
    """The fields of packed rays."""

    origins: NDArray[np.float32]
    directions: NDArray[np.float32]
    t_mins: NDArray[np.float32]
    t_maxs: NDArray[np.float32]


class TreeStart(NamedTuple):
    """Where a tree begins among others, the kind of its primitives, and the length of its stack, at least 1."""

    node: int
    block: int
    is_spheres: bool
    stack_size: int


@compiled(error_model="numpy")
def descend(trees, start, rays, any_hit, counts, nearest):
    """Traverse a tree with every ray.

    Writes t of the hits to `nearest`, (n,), and node steps, leaf visits, primitive tests and the primitive to `counts`,
    (n, 4).
    """
    nodes, node_ints = trees.nodes[start.node :], trees.node_ints[start.node :]
    triangles, triangle_ints = trees.triangles, trees.triangle_ints
    spheres, sphere_ints = trees.spheres, trees.sphere_ints
    stack = np.empty(start.stack_size, np.int64)
    for ray_id in range(len(rays.origins)):
        origin, direction = as_triple(rays.origins[ray_id]), as_triple(rays.directions[ray_id])
        t_min, t_max = rays.t_mins[ray_id], rays.t_maxs[ray_id]
        ray = make_host_ray(origin, direction)
        nearest_t, nearest_prim = _INFINITY, np.int32(NO_PRIM)
        node_steps = leaf_visits = prim_tests = 0
        stack_size = 0
        node = 0
        is_done = False
        while not is_done:
            # Which children does the ray meet, and which first?
            node_steps += 1
            limit = nearest_t if nearest_t < t_max else t_max
            meets_left, t_left = meets_child(nodes, node, 0, ray, t_min, limit)
            meets_right, t_right = meets_child(nodes, node, 1, ray, t_min, limit)
            if meets_left and meets_right:
                first = 1 if t_right < t_left else 0
                stack[stack_size] = 2 * node + 1 - first
                stack_size += 1
                child = 2 * node + first
            elif meets_left or meets_right:
                child = 2 * node + (1 if meets_right else 0)
            elif stack_size > 0:
                stack_size -= 1
                child = stack[stack_size]
            else:
                break

            # Leaves are tested at once, until an interior child comes up.
            while node_ints[child >> 1, BVH2_COUNT + (child & 1)] > 0:
                begin = start.block + node_ints[child >> 1, BVH2_FIRST + (child & 1)]
                count = node_ints[child >> 1, BVH2_COUNT + (child & 1)]
                leaf_visits += 1
                prim_tests += count
                for block in range(begin, begin + count):
                    if start.is_spheres:
                        t = intersect_sphere(spheres, block, origin, direction, t_min, t_max)
                        prim = sphere_ints[block, _SPHERE_PRIM_ID]
                    else:
                        t = intersect_triangle(triangles, block, ray)
                        prim = triangle_ints[block, TRIANGLE_PRIM_ID]
                    if t >= t_min and t <= t_max and (t < nearest_t or (t == nearest_t and prim < nearest_prim)):
                        nearest_t, nearest_prim = t, prim
                is_done = stack_size == 0 or (any_hit and nearest_prim != NO_PRIM)
                if is_done:
                    break
                stack_size -= 1
                child = stack[stack_size]
            node = node_ints[child >> 1, BVH2_FIRST + (child & 1)]
        counts[ray_id, 0], counts[ray_id, 1], counts[ray_id, 2] = node_steps, leaf_visits, prim_tests
        counts[ray_id, 3] = nearest_prim
        nearest[ray_id] = nearest_t


@compiled
def as_triple(vector):
    """Return three numbers of an array as a tuple."""
    return vector[0], vector[1], vector[2]


@compiled(error_model="numpy")
def meets_child(nodes, node, child, ray, t_min, t_max):
    """Return whether the ray meets a child's box, and where it enters; see `meets_aabb` in cl/boxes/aabb.cl."""
    t_near, t_far = t_min, t_max
    for axis in range(2, -1, -1):
        lower = nodes[node, BVH2_MIN + 3 * child + axis]
        upper = nodes[node, BVH2_MAX + 3 * child + axis]
        inverse = pick(ray.inverse, axis)
        is_backward = inverse < _ZERO
        near = ((upper if is_backward else lower) - pick(ray.near_origin, axis)) * inverse
        far = ((lower if is_backward else upper) - pick(ray.far_origin, axis)) * inverse
        t_near = near if near > t_near else t_near
        t_far = far if far < t_far else t_far
    return t_near <= t_far, t_near


@compiled(error_model="numpy")
def intersect_triangle(triangles, triangle, ray):
    """Return t where the ray crosses a triangle, NaN if it does not; see cl/triangles/triangle.cl."""
    a = shear_corner(_load_corner(triangles, triangle, 0, ray.axes), ray)
    b = shear_corner(_load_corner(triangles, triangle, 1, ray.axes), ray)
    c = shear_corner(_load_corner(triangles, triangle, 2, ray.axes), ray)
    return cross_corners(a, b, c, ray.perturbation)


@compiled(error_model="numpy")
def _load_corner(triangles, triangle, corner, axes):
    first = 3 * corner
    return (
        triangles[triangle, first + axes[0]],
        triangles[triangle, first + axes[1]],
        triangles[triangle, first + axes[2]],
    )


@compiled(error_model="numpy")
def intersect_sphere(spheres, sphere, origin, direction, t_min, t_max):
    """Return the first t from t_min to t_max where the ray crosses a sphere, NaN if it does not.

    In float64, which does what `cl/spheres/sphere.cl` needs its care for.
    """
    length_squared = along = 0.0
    for axis in range(3):
        step = np.float64(direction[axis])
        length_squared += step * step
        along += step * (np.float64(spheres[sphere, axis]) - np.float64(origin[axis]))
    middle = along / length_squared
    distance_squared = 0.0
    for axis in range(3):
        beside = np.float64(origin[axis]) + middle * direction[axis] - np.float64(spheres[sphere, axis])
        distance_squared += beside * beside
    radius = np.float64(spheres[sphere, _RADIUS])
    left = radius * radius - distance_squared
    if not left >= 0.0:
        return np.float32(np.nan)
    half = np.sqrt(left / length_squared)
    t_in, t_out = np.float32(middle - half), np.float32(middle + half)
    return t_in if t_in >= t_min and t_in <= t_max else t_out
