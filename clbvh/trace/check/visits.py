"""The cost of rays: node steps and primitive tests, counted on the host, step for step as in `cl/traversal/bvh2.cl`.

A measure of trees that does not depend on a machine's speed, and needs no OpenCL device. Boxes, the order of children
and culling are those of the device, and so is float32. Only the edge functions are computed another way, which may
change the last bit of `t`. In the layouts `bvh4` and `bvh8`, the steps are those of `cl/traversal/wide.cl` from the
root: there are no entry points.

In a scene, the steps through both levels are those of `cl/instances/traverse.cl`. Rays enter instances in float64 here,
and in pairs of float32 on the device: in the last bit they may differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...bvh import Bvh
from ...errors import SceneError
from ...geometry import Mesh
from ...layouts.device_arrays import DeviceArrays, list_prims, make_bvh2_nodes, make_device_arrays
from ...scene.state import SceneState
from ...structs import (
    BVH2_COUNT,
    BVH2_FIRST,
    BVH2_LANES,
    BVH2_MAX,
    BVH2_MIN,
    FAR_RADII,
    NO_PRIM,
    PACKED_RAY,
    PACKED_RAY_LANES,
    PRIM_KINDS,
    RAY_LOW,
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
from ..world.surface_arrays import make_surface_arrays
from ..world.top_tree import make_records
from ..world.trees import WideArrays

# Rays that a thread takes at a time: rays of one picture differ much in their steps, so threads take many small shares.
_CHUNK_RAYS = 1 << 12

_NODE_STEPS, _LEAF_VISITS, _PRIM_TESTS, _PRIM_ID, _INSTANCE_VISITS, _INSTANCE_ID, _FIELDS = range(7)


@dataclass(frozen=True, eq=False)
class Visits:
    """Counts for each ray.

    Attributes
    ----------
    node_steps : (n,) int32
        Interior nodes visited, those over the instances and those of the geometries. Each step tests the boxes of both
        children.
    leaf_visits : (n,) int32
        Leaves of primitives visited.
    triangle_tests : (n,) int32
        Triangles and spheres tested in those leaves.
    prim_id : (n,) int32
        What the ray hits; -1 on a miss. With `any_hit`, the first one found.
    instance_visits : (n,) int32, or None
        Instances entered; None of a tree without instances.
    instance_id : (n,) int32, or None
        Of what the ray hits; -1 on a miss.
    """

    node_steps: NDArray[np.int32]
    leaf_visits: NDArray[np.int32]
    triangle_tests: NDArray[np.int32]
    prim_id: NDArray[np.int32]
    instance_visits: NDArray[np.int32] | None = None
    instance_id: NDArray[np.int32] | None = None

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
    """A tree, or a scene, that is ready to be traversed on the host, by compiled code, in any number of threads.

    Parameters
    ----------
    bvh : Bvh
    """

    def __init__(self, bvh: Bvh) -> None:
        arrays = make_device_arrays(bvh, "bvh2")
        self._trees = HostTrees.join([arrays.nodes], [arrays.blocks], [])
        self._stack_size = max(1, bvh.depth)
        self._instances: _Instances | None = None
        self._box = TreeBox.around(bvh)

    @classmethod
    def of_scene(cls, state: SceneState, trees: Sequence[Bvh], top: Bvh) -> Self:
        """Return the traversal of a scene of at least one instance, given its trees and the one over the instances."""
        arrays = arrange_geometries(state, trees, "bvh2")
        ranges = list_ranges(state, arrays)
        blocks = blocks_by_kind(ranges, arrays)
        surface = make_surface_arrays(state.shapes, state.geometry_ids, state.transforms)
        records = make_records(surface, ranges, state.masks, top)
        made = cls.__new__(cls)
        made._trees = HostTrees.join([each.nodes for each in arrays], blocks["triangles"], blocks["spheres"])
        made._stack_size = max(1, *(bvh.depth for bvh in trees))
        made._instances = _Instances(
            HostTrees.join([make_bvh2_nodes(top)], [], []),
            max(1, top.depth),
            records["to_object"].astype(np.float64),
            records["centre"].astype(np.float64) + records["centre_low"],
            records["radius"].astype(np.float64),
            np.column_stack([records[name] for name in _START_FIELDS]),
            records["mask"] != 0,
        )
        made._box = TreeBox.around(top)
        return made

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
        origins, directions, t_min, t_max
            See `count_visits`. In a scene, rays see all instances but those with the mask 0.
        any_hit : bool, optional
            See `count_visits`; not of a scene.
        threads : HostThreads, optional
            Threads that share the rays. Without them the calling thread casts all.
        """
        batch, _ = read_rays(origins, directions, t_min, t_max)
        rays, instances = np.empty(batch.ray_count, PACKED_RAY), self._instances
        lows = np.zeros(0 if instances is None else batch.ray_count, RAY_LOW)
        counts, nearest = np.zeros((batch.ray_count, _FIELDS), np.int32), np.empty(batch.ray_count, np.float32)
        start = TreeStart(0, 0, False, self._stack_size)

        def cast(begin: int, end: int) -> None:
            part, own_lows = rays[begin:end], lows[begin:end]
            pack_rays(batch, batch.part(begin, end), self._box, part, lows=None if instances is None else own_lows)
            if instances is None:
                descend(self._trees, start, _as_packed(part), any_hit, counts[begin:end], nearest[begin:end])
            else:
                exact = part["origin"] + own_lows["origin"].astype(np.float64)
                inside = _as_packed(np.empty(1, PACKED_RAY))
                _walk(instances, self._trees, start, _as_packed(part), exact, inside, counts[begin:end])

        if threads is None:
            cast(0, batch.ray_count)
        else:
            threads.run(cast, cut_range(0, batch.ray_count, -(-batch.ray_count // _CHUNK_RAYS)))
        fields = np.ascontiguousarray(counts.T)
        return Visits(*fields[: _FIELDS - 2 if instances is None else _FIELDS])


def _as_packed(rays: NDArray[np.void]) -> PackedRays:
    return PackedRays(rays["origin"], rays["direction"], rays["t_min"], rays["t_max"])


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
    (n, 4 or more).
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
        while node >= 0:
            node_steps += 1
            limit = nearest_t if nearest_t < t_max else t_max
            child, stack_size = choose_child(nodes, node, ray, t_min, limit, stack, stack_size)
            # Leaves are tested at once, until an interior child comes up.
            while child >= 0 and node_ints[child >> 1, BVH2_COUNT + (child & 1)] > 0:
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
                is_done = any_hit and nearest_prim != NO_PRIM
                child, stack_size = (-1, 0) if is_done else pop(stack, stack_size)
            node = node_ints[child >> 1, BVH2_FIRST + (child & 1)] if child >= 0 else -1
        counts[ray_id, _NODE_STEPS], counts[ray_id, _LEAF_VISITS] = node_steps, leaf_visits
        counts[ray_id, _PRIM_TESTS], counts[ray_id, _PRIM_ID] = prim_tests, nearest_prim
        nearest[ray_id] = nearest_t


@compiled
def pop(stack, stack_size):
    """Return the child on top of a stack, -1 of an empty one, and the size of the stack without it."""
    return (stack[stack_size - 1], stack_size - 1) if stack_size > 0 else (-1, 0)


@compiled(error_model="numpy")
def choose_child(nodes, node, ray, t_min, limit, stack, stack_size):
    """Return the child of a node to visit next and the size of the stack, on which the farther child may come.

    A child is twice the index of its node, plus 1 for the right one; that of neither is on top of the stack.
    """
    meets_left, t_left = meets_child(nodes, node, 0, ray, t_min, limit)
    meets_right, t_right = meets_child(nodes, node, 1, ray, t_min, limit)
    if meets_left and meets_right:
        first = 1 if t_right < t_left else 0
        stack[stack_size] = 2 * node + 1 - first
        return 2 * node + first, stack_size + 1
    if meets_left or meets_right:
        return 2 * node + (1 if meets_right else 0), stack_size
    return pop(stack, stack_size)


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


# The constants of cl/instances/instance.cl.
_FAR_RADII, _RADII_BEFORE, _SHARE_BEFORE = float(FAR_RADII), 4.0, 2.0**-20

# More than float32 rounds off t on the way into an instance and back.
_T_SLACK = 2.0**-22

# The columns of `_Instances.starts`.
_START_FIELDS = ("first_node", "first_block", "kind", "instance_id")
_FIRST_NODE, _FIRST_BLOCK, _KIND, _ID = range(len(_START_FIELDS))


class _Instances(NamedTuple):
    """The tree over the instances, and the instances in the order of the leaves.

    `starts`, (n, 4) int32, holds the fields of their records that `_START_FIELDS` names.
    """

    top: HostTrees
    stack_size: int
    to_object: NDArray[np.float64]
    centre: NDArray[np.float64]
    radius: NDArray[np.float64]
    starts: NDArray[np.int32]
    is_visible: NDArray[np.bool_]


@compiled(error_model="numpy")
def _walk(instances, trees, lone, rays, exact_origins, inside, counts):
    """Traverse a scene with every ray; `counts`, (n, 6), holds the fields of `Visits` of each."""
    nodes, node_ints, starts = instances.top.nodes, instances.top.node_ints, instances.starts
    stack = np.empty(instances.stack_size, np.int64)
    own_counts = np.empty((1, 4), np.int32)
    own_t = np.empty(1, np.float32)
    for ray_id in range(len(rays.origins)):
        direction, exact = as_triple(rays.directions[ray_id]), exact_origins[ray_id]
        t_min, t_max = rays.t_mins[ray_id], rays.t_maxs[ray_id]
        ray = make_host_ray(as_triple(rays.origins[ray_id]), direction)
        count = counts[ray_id]
        count[_INSTANCE_ID] = count[_PRIM_ID] = NO_PRIM
        nearest_t = np.float32(np.inf)
        stack_size = 0
        node = 0
        while node >= 0:
            count[_NODE_STEPS] += 1
            limit = nearest_t if nearest_t < t_max else t_max
            child, stack_size = choose_child(nodes, node, ray, t_min, limit, stack, stack_size)
            # The instances of leaves are visited at once, until an interior child comes up.
            while child >= 0 and node_ints[child >> 1, BVH2_COUNT + (child & 1)] > 0:
                begin = node_ints[child >> 1, BVH2_FIRST + (child & 1)]
                for index in range(begin, begin + node_ints[child >> 1, BVH2_COUNT + (child & 1)]):
                    if not instances.is_visible[index]:
                        continue
                    limit = np.float32(nearest_t + nearest_t * _T_SLACK)
                    limit = limit if limit < t_max else t_max
                    shift = _enter(instances, index, exact, direction, t_min, limit, inside)
                    start = TreeStart(
                        np.int64(starts[index, _FIRST_NODE]),
                        np.int64(starts[index, _FIRST_BLOCK]),
                        starts[index, _KIND] != 0,
                        lone.stack_size,
                    )
                    descend(trees, start, inside, False, own_counts, own_t)
                    for field in (_NODE_STEPS, _LEAF_VISITS, _PRIM_TESTS):
                        count[field] += own_counts[0, field]
                    count[_INSTANCE_VISITS] += 1
                    t = np.float32(own_t[0] + shift)
                    prim_id, instance_id = own_counts[0, _PRIM_ID], starts[index, _ID]
                    if prim_id != NO_PRIM and (t < nearest_t or (t == nearest_t and instance_id < count[_INSTANCE_ID])):
                        nearest_t = t
                        count[_INSTANCE_ID], count[_PRIM_ID] = instance_id, prim_id
                child, stack_size = pop(stack, stack_size)
            node = node_ints[child >> 1, BVH2_FIRST + (child & 1)] if child >= 0 else -1


@compiled(error_model="numpy")
def _enter(instances, index, origin, direction, t_min, t_max, inside):
    """Write the ray in an instance's local coordinates; return by how much its t is less than outside."""
    centre, to_object = instances.centre[index], instances.to_object[index]
    x, y, z = origin[0] - centre[0], origin[1] - centre[1], origin[2] - centre[2]
    dx, dy, dz = np.float64(direction[0]), np.float64(direction[1]), np.float64(direction[2])
    shift = 0.0
    radius = instances.radius[index]
    if max(abs(x), abs(y), abs(z)) > _FAR_RADII * radius:
        t_closest = -(x * dx + y * dy + z * dz) / (dx * dx + dy * dy + dz * dz)
        advance = t_closest - t_closest * _SHARE_BEFORE - _RADII_BEFORE * radius
        if advance > 0.0:
            x, y, z = x + advance * dx, y + advance * dy, z + advance * dz
            shift = advance
    for row in range(3):
        a, b, c = to_object[row, 0], to_object[row, 1], to_object[row, 2]
        inside.origins[0, row] = a * x + b * y + c * z
        inside.directions[0, row] = a * dx + b * dy + c * dz
    inside.t_mins[0] = max(t_min - shift, 0.0)
    inside.t_maxs[0] = t_max - shift
    return shift


def arrange_geometries(state: SceneState, trees: Sequence[Bvh] | None, layout: str) -> list[DeviceArrays]:
    """Return the arrays of each geometry; without trees, those have none, whatever the layout."""
    if trees is None:
        return [list_prims(shape) for shape in state.shapes]
    return [make_device_arrays(bvh, layout) for bvh, shape in zip(trees, state.shapes, strict=True)]


def list_ranges(state: SceneState, arrays: Sequence[DeviceArrays]) -> NDArray[np.int32]:
    """Return where the arrays of `arrange_geometries` are in the joined ones, (n, 4), see `make_records`.

    Raises
    ------
    SceneError
        More nodes or blocks than int32 counts.
    """
    rows = []
    first_node, first_blocks = 0, [0] * len(PRIM_KINDS)
    for shape, own in zip(state.shapes, arrays, strict=True):
        kind = PRIM_KINDS["triangles" if isinstance(shape, Mesh) else "spheres"]
        rows.append((first_node, first_blocks[kind], len(own.blocks), kind))
        first_node += len(own.nodes)
        first_blocks[kind] += len(own.blocks)
    most = np.iinfo(np.int32).max
    if max(first_node, *first_blocks) > most:
        raise SceneError(f"the scene has {first_node:,} nodes, and the device counts up to {most:,}")
    return np.array(rows, np.int32)


def blocks_by_kind(ranges: NDArray[np.int32], arrays: Sequence[DeviceArrays]) -> dict[str, list[NDArray[np.void]]]:
    """Return the blocks of all arrays by the kind of their primitives, see `structs.PRIM_KINDS`."""
    blocks: dict[str, list[NDArray[np.void]]] = {name: [] for name in PRIM_KINDS}
    names = list(PRIM_KINDS)
    for own, kind in zip(arrays, ranges[:, 3].tolist(), strict=True):
        blocks[names[kind]].append(own.blocks)
    return blocks
