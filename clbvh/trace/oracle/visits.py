"""The cost of rays: node steps and triangle tests, counted on the host, step for step as in `cl/traversal/bvh2.cl`.

A measure of trees that does not depend on a machine's speed, and needs no OpenCL device. Boxes, the order of children
and culling are those of the device, and so is float32. Only the edge functions are computed another way, which may
change the last bit of `t`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...bvh import Bvh
from ...layouts.bvh2 import make_bvh2_nodes
from ...layouts.leaf_blocks import gather_triangles
from ...structs import (
    BVH2_COUNT,
    BVH2_FIRST,
    BVH2_LANES,
    BVH2_MAX,
    BVH2_MIN,
    NO_PRIM,
    PACKED_RAY,
    TRIANGLE_LANES,
    TRIANGLE_PRIM_ID,
)
from ...support.compiled import compiled
from ...support.host_threads import HostThreads
from ...support.ranges import cut_range
from ..rays.batch import TreeBox, read_rays
from ..rays.pack import pack_rays

_ROUNDING = 2.0**-24


def _error_bound(roundings: int) -> np.float32:
    return np.float32(roundings * _ROUNDING / (1 - roundings * _ROUNDING))


# The constants of cl/boxes/padding.cl.
_AXIS_PADDING = _error_bound(14)
_TIME_PADDING = _error_bound(28)
_LARGEST_COORDINATE = np.float32(1.0)
_MIN_SLOPE = np.float32(2.0**-30)

# Rays that a thread takes at a time: rays of one picture differ much in their steps, so threads take many small shares.
_CHUNK_RAYS = 1 << 14

_FIELDS = 4

_ZERO, _ONE, _TWO, _INFINITY = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(np.inf)


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

    @property
    def visits_per_ray(self) -> float:
        """Mean number of nodes visited, interior nodes and leaves."""
        return self.node_steps_per_ray + self.leaf_visits_per_ray


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
        nodes = make_bvh2_nodes(bvh).view(np.float32).reshape(-1, BVH2_LANES)
        triangles = gather_triangles(bvh.mesh, bvh.prim_ids).view(np.float32).reshape(-1, TRIANGLE_LANES)
        self._tree = _Tree(nodes, nodes.view(np.int32), triangles, triangles.view(np.int32), max(1, bvh.depth))
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

        def cast(begin: int, end: int) -> None:
            part = rays[begin:end]
            pack_rays(batch, batch.part(begin, end), self._box, part)
            packed = _Rays(part["origin"], part["direction"], part["t_min"], part["t_max"])
            _walk(self._tree, packed, any_hit, counts[begin:end])

        if threads is None:
            cast(0, batch.ray_count)
        else:
            threads.run(cast, cut_range(0, batch.ray_count, -(-batch.ray_count // _CHUNK_RAYS)))
        return Visits(*np.ascontiguousarray(counts.T))


class _Tree(NamedTuple):
    """A tree in the `bvh2` layout as 4-byte lanes, floats and integers, and the length of its stack."""

    nodes: NDArray[np.float32]
    node_ints: NDArray[np.int32]
    triangles: NDArray[np.float32]
    triangle_ints: NDArray[np.int32]
    stack_size: int


class _Rays(NamedTuple):
    """The fields of packed rays."""

    origins: NDArray[np.float32]
    directions: NDArray[np.float32]
    t_mins: NDArray[np.float32]
    t_maxs: NDArray[np.float32]


@compiled(error_model="numpy")
def _walk(tree, rays, any_hit, counts):
    """Traverse the tree with every ray; `counts`, (n, 4), holds the fields of `Visits` of each."""
    nodes, node_ints, triangles, triangle_ints = tree.nodes, tree.node_ints, tree.triangles, tree.triangle_ints
    stack = np.empty(tree.stack_size, np.int64)
    near_origin = np.empty(3, np.float32)
    far_origin = np.empty(3, np.float32)
    inverse = np.empty(3, np.float32)
    shear = np.empty(3, np.float32)
    perturbation = np.empty(2, np.float32)
    for ray in range(len(rays.origins)):
        origin, direction = rays.origins[ray], rays.directions[ray]
        t_min, t_max = rays.t_mins[ray], rays.t_maxs[ray]
        z_axis = make_shear(origin, direction, shear, perturbation)
        pad_ray(origin, direction, shear, z_axis, near_origin, far_origin, inverse)
        nearest_t, nearest_prim = _INFINITY, np.int32(NO_PRIM)
        node_steps = leaf_visits = triangle_tests = 0
        stack_size = 0
        node = 0
        is_done = False
        while not is_done:
            # Which children does the ray meet, and which first?
            node_steps += 1
            limit = nearest_t if nearest_t < t_max else t_max
            meets_left, t_left = _meets_child(nodes, node, 0, near_origin, far_origin, inverse, t_min, limit)
            meets_right, t_right = _meets_child(nodes, node, 1, near_origin, far_origin, inverse, t_min, limit)
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
                begin = node_ints[child >> 1, BVH2_FIRST + (child & 1)]
                count = node_ints[child >> 1, BVH2_COUNT + (child & 1)]
                leaf_visits += 1
                triangle_tests += count
                for triangle in range(begin, begin + count):
                    t = intersect_triangle(triangles, triangle, origin, z_axis, shear, perturbation)
                    prim = triangle_ints[triangle, TRIANGLE_PRIM_ID]
                    if t >= t_min and t <= t_max and (t < nearest_t or (t == nearest_t and prim < nearest_prim)):
                        nearest_t, nearest_prim = t, prim
                is_done = stack_size == 0 or (any_hit and nearest_prim != NO_PRIM)
                if is_done:
                    break
                stack_size -= 1
                child = stack[stack_size]
            node = node_ints[child >> 1, BVH2_FIRST + (child & 1)]
        counts[ray, 0], counts[ray, 1], counts[ray, 2] = node_steps, leaf_visits, triangle_tests
        counts[ray, 3] = nearest_prim


@compiled(error_model="numpy")
def pad_ray(origin, direction, shear, z_axis, near_origin, far_origin, inverse):
    """Write the origins from which planes are seen, and the inverse of the direction; see `pad_ray` in cl/boxes."""
    longest_reach = abs(origin[z_axis]) + _LARGEST_COORDINATE
    distance = _TWO * _MIN_SLOPE * longest_reach
    time = _TIME_PADDING * longest_reach * abs(shear[2])
    for axis in range(3):
        inverse[axis] = _ONE / direction[axis]
        reach = abs(origin[axis]) + _LARGEST_COORDINATE
        width = _AXIS_PADDING * reach + distance + time * abs(direction[axis])
        ahead = -width if inverse[axis] < _ZERO else width
        near_origin[axis], far_origin[axis] = origin[axis] + ahead, origin[axis] - ahead


@compiled(error_model="numpy")
def _meets_child(nodes, node, child, near_origin, far_origin, inverse, t_min, t_max):
    """Return whether the ray meets a child's box, and where it enters; see `meets_aabb` in cl/boxes/aabb.cl."""
    t_near, t_far = t_min, t_max
    for axis in range(2, -1, -1):
        lower = nodes[node, BVH2_MIN + 3 * child + axis]
        upper = nodes[node, BVH2_MAX + 3 * child + axis]
        is_backward = inverse[axis] < _ZERO
        near = ((upper if is_backward else lower) - near_origin[axis]) * inverse[axis]
        far = ((lower if is_backward else upper) - far_origin[axis]) * inverse[axis]
        t_near = near if near > t_near else t_near
        t_far = far if far < t_far else t_far
    return t_near <= t_far, t_near


@compiled(error_model="numpy")
def make_shear(origin, direction, shear, perturbation):
    """Write the shear that makes the ray the z axis, and the perturbation; return the axis that becomes z.

    See `make_ray` in cl/rays/ray.cl.
    """
    x, y, z = abs(direction[0]), abs(direction[1]), abs(direction[2])
    z_axis = (0 if x > z else 2) if x > y else (1 if y > z else 2)
    x_axis, y_axis = (z_axis + 1) % 3, (z_axis + 2) % 3
    along = direction[z_axis]
    shear[0], shear[1], shear[2] = direction[x_axis] / along, direction[y_axis] / along, _ONE / along
    perturbation[0] = -origin[x_axis] - shear[0] * -origin[z_axis]
    perturbation[1] = -origin[y_axis] - shear[1] * -origin[z_axis]
    return z_axis


@compiled(error_model="numpy")
def intersect_triangle(triangles, triangle, origin, z_axis, shear, perturbation):
    """Return t where the ray crosses a triangle, NaN if it does not; see cl/triangles/triangle.cl."""
    ax, ay, az = _shear_vertex(triangles, triangle, 0, origin, z_axis, shear)
    bx, by, bz = _shear_vertex(triangles, triangle, 1, origin, z_axis, shear)
    cx, cy, cz = _shear_vertex(triangles, triangle, 2, origin, z_axis, shear)
    edge_a, edge_b, edge_c = _edge(cx, by, cy, bx), _edge(ax, cy, ay, cx), _edge(bx, ay, by, ax)
    area = edge_a + edge_b + edge_c
    side_a = _side_of_edge(edge_a, bx, by, cx, cy, perturbation)
    side_b = _side_of_edge(edge_b, cx, cy, ax, ay, perturbation)
    side_c = _side_of_edge(edge_c, ax, ay, bx, by, perturbation)
    is_left = side_a < _ZERO or side_b < _ZERO or side_c < _ZERO
    is_right = side_a > _ZERO or side_b > _ZERO or side_c > _ZERO
    if (is_left and is_right) or area == _ZERO:
        return np.float32(np.nan)
    return (edge_a * az + edge_b * bz + edge_c * cz) / area


@compiled(error_model="numpy")
def _side_of_edge(edge, begin_x, begin_y, end_x, end_y, perturbation):
    """Return the edge function, and where it is zero, that of the perturbed ray."""
    if edge != _ZERO:
        return edge
    along_x, along_y = end_x - begin_x, end_y - begin_y
    perturbed = _edge(perturbation[0], along_y, perturbation[1], along_x)
    if perturbed != _ZERO:
        return perturbed
    return along_y if along_y != _ZERO else -along_x


@compiled(error_model="numpy")
def _shear_vertex(triangles, triangle, corner, origin, z_axis, shear):
    x_axis, y_axis = (z_axis + 1) % 3, (z_axis + 2) % 3
    x = triangles[triangle, 3 * corner + x_axis] - origin[x_axis]
    y = triangles[triangle, 3 * corner + y_axis] - origin[y_axis]
    z = triangles[triangle, 3 * corner + z_axis] - origin[z_axis]
    return x - shear[0] * z, y - shear[1] * z, shear[2] * z


@compiled(error_model="numpy")
def _edge(a, b, c, d):
    """Return a * b - c * d: products of float32 are exact in float64, so the sign of the difference is right."""
    return np.float32(np.float64(a) * np.float64(b) - np.float64(c) * np.float64(d))
