"""The cost of rays in a scene: the steps through both levels, counted on the host as in `cl/instances/traverse.cl`.

Rays enter instances in float64 here, and in pairs of float32 on the device: in the last bit they may differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...bvh import Bvh
from ...layouts.device_arrays import make_bvh2_nodes
from ...scene.state import SceneState
from ...structs import BVH2_COUNT, BVH2_FIRST, FAR_RADII, NO_PRIM, PACKED_RAY, SCENE_LOW
from ...support.compiled import compiled
from ...support.host_threads import HostThreads, cut_range
from ..hits.scene_arrays import make_scene_arrays
from ..host.lanes import make_host_ray
from ..rays.batch import TreeBox, read_rays
from ..rays.pack import pack_rays
from ..scene.device_scene import arrange_geometries, blocks_by_kind, list_ranges
from ..scene.top_tree import make_records
from .visits import HostTrees, PackedRays, TreeStart, as_triple, descend, meets_child

# The constants of cl/instances/instance.cl.
_FAR_RADII, _RADII_BEFORE, _SHARE_BEFORE = float(FAR_RADII), 4.0, 2.0**-20

# More than float32 rounds off t on the way into an instance and back.
_T_SLACK = 2.0**-22

# Rays that a thread takes at a time: rays of one picture differ much in their steps, so threads take many small shares.
_CHUNK_RAYS = 1 << 12

# The columns of `_HostScene.starts`.
_START_FIELDS = ("first_node", "first_block", "kind", "instance_id")
_FIRST_NODE, _FIRST_BLOCK, _KIND, _ID = range(len(_START_FIELDS))

_NODE_STEPS, _INSTANCE_VISITS, _LEAF_VISITS, _PRIM_TESTS, _INSTANCE_ID, _PRIM_ID, _FIELDS = range(7)


@dataclass(frozen=True, eq=False)
class SceneVisits:
    """Counts for each ray.

    Attributes
    ----------
    node_steps : (n,) int32
        Interior nodes visited, those over the instances and those of the geometries. Each step tests two boxes.
    instance_visits : (n,) int32
        Instances entered.
    leaf_visits : (n,) int32
        Leaves of geometries visited.
    prim_tests : (n,) int32
        Triangles and spheres tested in those leaves.
    instance_id, prim_id : (n,) int32
        What the ray hits; -1 on a miss.
    """

    node_steps: NDArray[np.int32]
    instance_visits: NDArray[np.int32]
    leaf_visits: NDArray[np.int32]
    prim_tests: NDArray[np.int32]
    instance_id: NDArray[np.int32]
    prim_id: NDArray[np.int32]


class SceneTraversal:
    """A scene that is ready to be traversed on the host, by compiled code, in any number of threads.

    Parameters
    ----------
    state : SceneState
        At least one instance.
    trees : sequence of Bvh
        One for each geometry.
    top : Bvh
        Over the instances.
    """

    def __init__(self, state: SceneState, trees: Sequence[Bvh], top: Bvh) -> None:
        arrays = arrange_geometries(state, trees, "bvh2")
        ranges = list_ranges(state, arrays)
        blocks = blocks_by_kind(ranges, arrays)
        surface = make_scene_arrays(state.shapes, state.geometry_ids, state.transforms)
        records = make_records(surface, ranges, state.masks, top)
        self._scene = _HostScene(
            HostTrees.join([make_bvh2_nodes(top)], [], []),
            HostTrees.join([each.nodes for each in arrays], blocks["triangles"], blocks["spheres"]),
            max(1, top.depth),
            max(1, *(bvh.depth for bvh in trees)),
            records["to_object"].astype(np.float64),
            records["centre"].astype(np.float64) + records["centre_low"],
            records["radius"].astype(np.float64),
            np.column_stack([records[name] for name in _START_FIELDS]),
            records["mask"] != 0,
        )  # fmt: skip
        self._box = TreeBox.around(top)

    def count_visits(
        self, origins: ArrayLike, directions: ArrayLike, *, threads: HostThreads | None = None
    ) -> SceneVisits:
        """Cast rays and count their steps on the way to the closest hit.

        Parameters
        ----------
        origins, directions
            See `Tracer.closest_hit`. They see all instances but those with the mask 0.
        threads : HostThreads, optional
            Threads that share the rays. Without them the calling thread casts all.
        """
        batch, _ = read_rays(origins, directions, 0.0, np.inf)
        rays, lows = np.empty(batch.ray_count, PACKED_RAY), np.empty(batch.ray_count, SCENE_LOW)
        counts = np.zeros((batch.ray_count, _FIELDS), np.int32)

        def cast(begin: int, end: int) -> None:
            part = rays[begin:end]
            pack_rays(batch, batch.part(begin, end), self._box, part, lows=lows[begin:end])
            exact = part["origin"] + lows["origin"][begin:end].astype(np.float64)
            inside = np.empty(1, PACKED_RAY)
            _walk(self._scene, _as_packed(part), exact, _as_packed(inside), counts[begin:end])

        if threads is None:
            cast(0, batch.ray_count)
        else:
            threads.run(cast, cut_range(0, batch.ray_count, -(-batch.ray_count // _CHUNK_RAYS)))
        return SceneVisits(*np.ascontiguousarray(counts.T))


class _HostScene(NamedTuple):
    """The trees of both levels, and the instances in the order of the leaves.

    `starts`, (n, 4) int32, holds the fields of their records that `_START_FIELDS` names.
    """

    top: HostTrees
    trees: HostTrees
    top_stack_size: int
    stack_size: int
    to_object: NDArray[np.float64]
    centre: NDArray[np.float64]
    radius: NDArray[np.float64]
    starts: NDArray[np.int32]
    is_visible: NDArray[np.bool_]


def _as_packed(rays: NDArray[np.void]) -> PackedRays:
    return PackedRays(rays["origin"], rays["direction"], rays["t_min"], rays["t_max"])


@compiled(error_model="numpy")
def _walk(scene, rays, exact_origins, inside, counts):
    """Traverse the scene with every ray; `counts`, (n, 6), holds the fields of `SceneVisits` of each."""
    nodes, node_ints, starts = scene.top.nodes, scene.top.node_ints, scene.starts
    stack = np.empty(scene.top_stack_size, np.int64)
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
        while True:
            # Which children does the ray meet, and which first?
            count[_NODE_STEPS] += 1
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

            # The instances of leaves are visited at once, until an interior child comes up.
            is_done = False
            while node_ints[child >> 1, BVH2_COUNT + (child & 1)] > 0:
                begin = node_ints[child >> 1, BVH2_FIRST + (child & 1)]
                for index in range(begin, begin + node_ints[child >> 1, BVH2_COUNT + (child & 1)]):
                    if not scene.is_visible[index]:
                        continue
                    limit = np.float32(nearest_t + nearest_t * _T_SLACK)
                    limit = limit if limit < t_max else t_max
                    shift = _enter(scene, index, exact, direction, t_min, limit, inside)
                    start = TreeStart(
                        np.int64(starts[index, _FIRST_NODE]),
                        np.int64(starts[index, _FIRST_BLOCK]),
                        starts[index, _KIND] != 0,
                        scene.stack_size,
                    )
                    descend(scene.trees, start, inside, False, own_counts, own_t)
                    count[_NODE_STEPS] += own_counts[0, 0]
                    count[_INSTANCE_VISITS] += 1
                    count[_LEAF_VISITS] += own_counts[0, 1]
                    count[_PRIM_TESTS] += own_counts[0, 2]
                    t = np.float32(own_t[0] + shift)
                    prim_id, instance_id = own_counts[0, 3], starts[index, _ID]
                    if prim_id != NO_PRIM and (t < nearest_t or (t == nearest_t and instance_id < count[_INSTANCE_ID])):
                        nearest_t = t
                        count[_INSTANCE_ID], count[_PRIM_ID] = instance_id, prim_id
                is_done = stack_size == 0
                if is_done:
                    break
                stack_size -= 1
                child = stack[stack_size]
            if is_done:
                break
            node = node_ints[child >> 1, BVH2_FIRST + (child & 1)]


@compiled(error_model="numpy")
def _enter(scene, index, origin, direction, t_min, t_max, inside):
    """Write the ray in an instance's local coordinates; return by how much its t is less than outside."""
    x, y, z = (
        origin[0] - scene.centre[index, 0], origin[1] - scene.centre[index, 1], origin[2] - scene.centre[index, 2]
    )  # fmt: skip
    dx, dy, dz = np.float64(direction[0]), np.float64(direction[1]), np.float64(direction[2])
    shift = 0.0
    radius = scene.radius[index]
    if max(abs(x), abs(y), abs(z)) > _FAR_RADII * radius:
        t_closest = -(x * dx + y * dy + z * dz) / (dx * dx + dy * dy + dz * dz)
        advance = t_closest - t_closest * _SHARE_BEFORE - _RADII_BEFORE * radius
        if advance > 0.0:
            x, y, z = x + advance * dx, y + advance * dy, z + advance * dz
            shift = advance
    for row in range(3):
        a, b, c = scene.to_object[index, row, 0], scene.to_object[index, row, 1], scene.to_object[index, row, 2]
        inside.origins[0, row] = a * x + b * y + c * z
        inside.directions[0, row] = a * dx + b * dy + c * dz
    inside.t_mins[0] = max(t_min - shift, 0.0)
    inside.t_maxs[0] = t_max - shift
    return shift
