"""What a ray costs: node steps and triangle tests, counted on the host, step for step as `cl/traverse_bvh2.cl` walks.

A measure of trees that no machine's speed gets into. It needs no OpenCL device. The same boxes, the same order of the
children and the same culling as on the device; every number is float32, as it is there. Only the edge functions are
computed another way, which may change the last bit of `t`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from ..layout import (
    BVH2_COUNT,
    BVH2_FIRST,
    BVH2_LANES,
    BVH2_MAX,
    BVH2_MIN,
    NO_PRIM,
    RAY,
    TRIANGLE_LANES,
    TRIANGLE_PRIM_ID,
)
from ..tree import Bvh
from ..tree.layouts import gather_triangles, make_bvh2_nodes
from .rays import RayBox, pack_rays, read_rays

# `SLAB_SLACK` of cl/aabb.cl: 24 roundings.
_ROUNDING = 2.0**-24
_SLAB_SLACK = np.float32(1.0) + np.float32(24 * _ROUNDING / (1 - 24 * _ROUNDING))

_ZERO, _ONE, _INFINITY = np.float32(0.0), np.float32(1.0), np.float32(np.inf)


@dataclass(frozen=True, eq=False)
class Visits:
    """What each ray did on its way through a tree.

    Attributes
    ----------
    node_steps : (n,) int32
        Interior nodes at which the ray was. Each step tests the boxes of both children.
    leaf_visits : (n,) int32
        Leaves whose box the ray met.
    triangle_tests : (n,) int32
        Triangles in those leaves, up to the end of the search.
    prim_id : (n,) int32
        What the ray hit; -1 on a miss. With `any_hit`, the first one found.
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
        """Node steps and triangle tests of a ray in the mean: with both costs 1, what the SAH cost is about."""
        return self.node_steps_per_ray + self.triangle_tests_per_ray

    @property
    def visits_per_ray(self) -> float:
        """Nodes that a ray visits in the mean: interior ones and leaves."""
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
    """Cast rays on the host and count what they do.

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
    ValueError
        See `Tracer.closest_hit`.

    Notes
    -----
    In this thread: about a million node steps in 10 ms.
    """
    batch = read_rays(origins, directions, t_min, t_max)
    rays = np.empty(len(batch), RAY)
    pack_rays(batch.part(0, len(batch)), RayBox.around(bvh), rays)
    nodes = make_bvh2_nodes(bvh).view(np.float32).reshape(-1, BVH2_LANES)
    triangles = gather_triangles(bvh.mesh, bvh.prim_ids).view(np.float32).reshape(-1, TRIANGLE_LANES)
    counts = np.zeros((4, len(rays)), np.int32)
    _walk(
        nodes, nodes.view(np.int32), triangles, triangles.view(np.int32),
        rays["origin"], rays["direction"], rays["t_min"], rays["t_max"], any_hit, max(1, bvh.depth), counts,
    )  # fmt: skip
    return Visits(*counts)


@njit(cache=True, nogil=True, error_model="numpy")
def _walk(  # type: ignore[no-untyped-def]
    nodes, node_ints, triangles, triangle_ints, origins, directions, t_mins, t_maxs, any_hit, stack_size, counts
):
    """Walk through the tree with every ray; `counts` holds the fields of `Visits`."""
    stack = np.empty(stack_size, np.int64)
    inverse = np.empty(3, np.float32)
    shear = np.empty(3, np.float32)
    lean = np.empty(2, np.float32)
    for ray in range(len(origins)):
        origin, direction = origins[ray], directions[ray]
        t_min, t_max = t_mins[ray], t_maxs[ray]
        for axis in range(3):
            inverse[axis] = _ONE / direction[axis]
        z_axis = _make_shear(origin, direction, shear, lean)
        nearest_t, nearest_prim = _INFINITY, np.int32(NO_PRIM)
        node_steps = leaf_visits = triangle_tests = 0
        waiting = 0
        node = 0
        is_done = False
        while not is_done:
            # Which children does the ray meet, and which first?
            node_steps += 1
            limit = nearest_t if nearest_t < t_max else t_max
            meets_left, entry_left = _meets_child(nodes, node, 0, origin, inverse, t_min, limit)
            meets_right, entry_right = _meets_child(nodes, node, 1, origin, inverse, t_min, limit)
            if meets_left and meets_right:
                first = 1 if entry_right < entry_left else 0
                stack[waiting] = 2 * node + 1 - first
                waiting += 1
                child = 2 * node + first
            elif meets_left or meets_right:
                child = 2 * node + (1 if meets_right else 0)
            elif waiting > 0:
                waiting -= 1
                child = stack[waiting]
            else:
                break

            # Leaves are tested at once, until an interior child comes up.
            while node_ints[child >> 1, BVH2_COUNT + (child & 1)] > 0:
                begin = node_ints[child >> 1, BVH2_FIRST + (child & 1)]
                count = node_ints[child >> 1, BVH2_COUNT + (child & 1)]
                leaf_visits += 1
                triangle_tests += count
                for place in range(begin, begin + count):
                    t = _cross_triangle(triangles, place, origin, z_axis, shear, lean)
                    prim = triangle_ints[place, TRIANGLE_PRIM_ID]
                    if t >= t_min and t <= t_max and (t < nearest_t or (t == nearest_t and prim < nearest_prim)):
                        nearest_t, nearest_prim = t, prim
                is_done = waiting == 0 or (any_hit and nearest_prim != NO_PRIM)
                if is_done:
                    break
                waiting -= 1
                child = stack[waiting]
            node = node_ints[child >> 1, BVH2_FIRST + (child & 1)]
        counts[0, ray], counts[1, ray], counts[2, ray] = node_steps, leaf_visits, triangle_tests
        counts[3, ray] = nearest_prim


@njit(cache=True, nogil=True, error_model="numpy")
def _meets_child(nodes, node, child, origin, inverse, t_min, t_max):  # type: ignore[no-untyped-def]
    """Return whether the ray meets a child's box, and where it enters; see `meets_aabb` in cl/aabb.cl."""
    entry, leave = t_min, t_max
    for axis in range(2, -1, -1):
        lower = nodes[node, BVH2_MIN + 3 * child + axis]
        upper = nodes[node, BVH2_MAX + 3 * child + axis]
        is_backward = inverse[axis] < _ZERO
        near = ((upper if is_backward else lower) - origin[axis]) * inverse[axis]
        far = ((lower if is_backward else upper) - origin[axis]) * inverse[axis]
        entry = near if near > entry else entry
        leave = far if far < leave else leave
    return entry <= leave * _SLAB_SLACK, entry


@njit(cache=True, nogil=True, error_model="numpy")
def _make_shear(origin, direction, shear, lean):  # type: ignore[no-untyped-def]
    """Write the shear that makes the ray the z axis, and to which side it leans; return which axis becomes z.

    See `make_path` in cl/ray.cl.
    """
    x, y, z = abs(direction[0]), abs(direction[1]), abs(direction[2])
    z_axis = (0 if x > z else 2) if x > y else (1 if y > z else 2)
    x_axis, y_axis = (z_axis + 1) % 3, (z_axis + 2) % 3
    along = direction[z_axis]
    shear[0], shear[1], shear[2] = direction[x_axis] / along, direction[y_axis] / along, _ONE / along
    lean[0] = -origin[x_axis] - shear[0] * -origin[z_axis]
    lean[1] = -origin[y_axis] - shear[1] * -origin[z_axis]
    return z_axis


@njit(cache=True, nogil=True, error_model="numpy")
def _cross_triangle(triangles, place, origin, z_axis, shear, lean):  # type: ignore[no-untyped-def]
    """Return where the ray crosses a triangle, NaN if it does not; see `intersect_triangle` in cl/triangle.cl."""
    ax, ay, az = _shear_vertex(triangles, place, 0, origin, z_axis, shear)
    bx, by, bz = _shear_vertex(triangles, place, 1, origin, z_axis, shear)
    cx, cy, cz = _shear_vertex(triangles, place, 2, origin, z_axis, shear)
    edge_a, edge_b, edge_c = _edge(cx, by, cy, bx), _edge(ax, cy, ay, cx), _edge(bx, ay, by, ax)
    area = edge_a + edge_b + edge_c
    side_a = _side_of_edge(edge_a, bx, by, cx, cy, lean)
    side_b = _side_of_edge(edge_b, cx, cy, ax, ay, lean)
    side_c = _side_of_edge(edge_c, ax, ay, bx, by, lean)
    is_left = side_a < _ZERO or side_b < _ZERO or side_c < _ZERO
    is_right = side_a > _ZERO or side_b > _ZERO or side_c > _ZERO
    if (is_left and is_right) or area == _ZERO:
        return np.float32(np.nan)
    return (edge_a * az + edge_b * bz + edge_c * cz) / area


@njit(cache=True, nogil=True, error_model="numpy")
def _side_of_edge(edge, begin_x, begin_y, end_x, end_y, lean):  # type: ignore[no-untyped-def]
    """Return the edge function, and where it is zero, what it is beside the edge."""
    if edge != _ZERO:
        return edge
    along_x, along_y = end_x - begin_x, end_y - begin_y
    leaning = _edge(lean[0], along_y, lean[1], along_x)
    if leaning != _ZERO:
        return leaning
    return along_y if along_y != _ZERO else -along_x


@njit(cache=True, nogil=True, error_model="numpy")
def _shear_vertex(triangles, place, corner, origin, z_axis, shear):  # type: ignore[no-untyped-def]
    x_axis, y_axis = (z_axis + 1) % 3, (z_axis + 2) % 3
    x = triangles[place, 3 * corner + x_axis] - origin[x_axis]
    y = triangles[place, 3 * corner + y_axis] - origin[y_axis]
    z = triangles[place, 3 * corner + z_axis] - origin[z_axis]
    return x - shear[0] * z, y - shear[1] * z, shear[2] * z


@njit(cache=True, nogil=True, error_model="numpy")
def _edge(a, b, c, d):  # type: ignore[no-untyped-def]
    """Return a * b - c * d: products of float32 are exact in float64, so the sign of the difference is right."""
    return np.float32(np.float64(a) * np.float64(b) - np.float64(c) * np.float64(d))
