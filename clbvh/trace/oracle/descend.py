"""The way of rays through one tree on the host, step for step as in `cl/traversal/bvh2.cl`, with the steps counted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ...structs import (
    BVH2_COUNT,
    BVH2_FIRST,
    BVH2_LANES,
    BVH2_MAX,
    BVH2_MIN,
    NO_PRIM,
    SPHERE,
    TRIANGLE_LANES,
    TRIANGLE_PRIM_ID,
)
from ...support.compiled import compiled
from ..host.ray import cross_corners, make_host_ray, pick, shear_corner

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
