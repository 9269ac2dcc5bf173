"""The tree over the instances of a scene, and their records on the device.

Everything is computed in float64 from the 4 x 4 matrices; see `structs.INSTANCE` for what is kept in float32.

Queries of points may choose any instances with each call. To build a tree over half of them takes four times as long as
to prune the tree over all; and to hide the rest there makes a point look for the chosen ones everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...errors import SceneError
from ...geometry.corners import Boxes
from ...geometry.local_frame import find_bounds
from ...layouts.device_arrays import make_bvh2_nodes
from ...structs import INSTANCE, NODE, NODE_COUNT, NODE_FIRST, NODE_LANES, NODE_MAX
from ...support.compiled import compiled
from .surface_arrays import SurfaceArrays


@dataclass(frozen=True, eq=False)
class TopTree:
    """The tree over the instances, as the device takes it.

    Attributes
    ----------
    nodes : (m,) `structs.BVH2_NODE`
    instances : (n,) `structs.INSTANCE`
        In the order of the leaves.
    bvh : Bvh
        Its primitives are the instances.
    """

    nodes: NDArray[np.void]
    instances: NDArray[np.void]
    bvh: Bvh

    @classmethod
    def build(cls, arrays: SurfaceArrays, ranges: NDArray[np.int32], masks: NDArray[np.uint32]) -> TopTree:
        """Build the tree over the instances of a scene; see `make_records`.

        Raises
        ------
        SceneError
            An instance is too small beside the scene.
        """
        # Imported here: a lone shape needs no builder.
        from ...builders.build import build_top

        bvh = build_top(Boxes.from_arrays(*find_boxes(arrays), "the instances"))
        return cls(make_bvh2_nodes(bvh), make_records(arrays, ranges, masks, bvh), bvh)


# An instance's box grows by this share of its own size, times the condition of its matrix, up to its whole size: more
# than a ray loses by entering it in float32. A ray begins up to 36 radii away when it is rounded, and each of its
# components is a sum of three products. And by the other share of all boxes: more than float32 rounds off the ray with
# which the boxes are tested.
_OWN_GROWTH = 2.0**-15
_SCENE_GROWTH = 2.0**-19

# Bounds that are computed in float64 and kept in float32 have this much room.
_ROOM = 1.0 + 2.0**-20

# The device scales directions by the inverse of an instance's size in the scene; float32 has room for 2^60.
_MOST_INVERSE = 2.0**60

_LANES = INSTANCE.itemsize // 4


def _lane(name: str) -> int:
    return int(INSTANCE.fields[name][1]) // 4  # type: ignore[index]


_TO_OBJECT, _TO_WORLD = _lane("to_object"), _lane("to_world")
_CENTRE, _CENTRE_LOW, _RADIUS = _lane("centre"), _lane("centre_low"), _lane("radius")
_FIRST_NODE, _FIRST_BLOCK, _BLOCK_COUNT = _lane("first_node"), _lane("first_block"), _lane("block_count")
_KIND, _MASK, _ID = _lane("kind"), _lane("mask"), _lane("instance_id")


def find_boxes(arrays: SurfaceArrays) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners of the instances' boxes in the scene's coordinates, each (n, 3) float64.

    A ray that hits an instance meets its box, as far as float32 can tell.
    """
    lower, upper = np.empty(arrays.offset.shape), np.empty(arrays.offset.shape)
    _find_boxes(arrays, lower, upper)
    growth = _SCENE_GROWTH * float(np.max(find_bounds(upper)[1] / 2 - find_bounds(lower)[0] / 2))
    lower -= growth
    upper += growth
    return lower, upper


def make_records(
    arrays: SurfaceArrays, ranges: NDArray[np.int32], masks: NDArray[np.uint32], top: Bvh
) -> NDArray[np.void]:
    """Return the instances as the device takes them, in the order of the leaves of the tree over them.

    Parameters
    ----------
    arrays : SurfaceArrays
        Of n instances.
    ranges : (geometries, 4) int32
        First node, first block, number of blocks and kind of primitives of each geometry, see `structs.INSTANCE`.
    masks : (n,) uint32
    top : Bvh

    Returns
    -------
    (n,) `structs.INSTANCE`

    Raises
    ------
    SceneError
        An instance is too small or too flat beside the scene.
    """
    lanes = np.zeros((len(masks), _LANES), np.float32)
    centre, scale = top.shape.origin, float(top.shape.scale)
    bad = _write_records(arrays, ranges, masks.view(np.int32), top.prim_ids, centre, scale, lanes, lanes.view(np.int32))
    if bad >= 0:
        raise SceneError(
            f"the instance {bad} is smaller than {1 / _MOST_INVERSE:.0e} of the scene, at least "
            "in one direction: leave it out, or make it larger"
        )
    return lanes.view(INSTANCE).reshape(-1)


@compiled
def _find_boxes(arrays, lower, upper):
    linear, origin, half_size = arrays.linear, arrays.origin, arrays.half_size
    for instance in range(len(lower)):
        geometry = arrays.geometry_id[instance]
        condition = _condition(arrays, instance)
        for row in range(3):
            middle, half = arrays.offset[instance, row], 0.0
            for column in range(3):
                factor = linear[instance, row, column]
                middle += factor * origin[geometry, column]
                half += abs(factor) * half_size[geometry, column]
            half += half * min(_OWN_GROWTH * condition, 1.0)
            lower[instance, row], upper[instance, row] = middle - half, middle + half


@compiled
def _condition(arrays, instance):
    """Return by how much rounding can grow on the way into an instance and back; 1 for a map along the axes."""
    linear, inverse = arrays.linear, arrays.inverse
    most = 0.0
    for row in range(3):
        total = 0.0
        for middle in range(3):
            for column in range(3):
                total += abs(linear[instance, row, middle] * inverse[instance, middle, column])
        most = max(most, total)
    return most


@compiled(error_model="numpy")
def _write_records(arrays, ranges, masks, order, centre, scale, lanes, ints):
    """Write the records; return the first instance that is too small, or -1."""
    linear, inverse, origin, half_size = arrays.linear, arrays.inverse, arrays.origin, arrays.half_size
    for slot in range(len(order)):
        instance = order[slot]
        geometry = arrays.geometry_id[instance]
        own_scale = arrays.scale[geometry]
        squared_radius = 0.0
        for row in range(3):
            place, extent = arrays.offset[instance, row], 0.0
            for column in range(3):
                entry = linear[instance, row, column]
                place += entry * origin[geometry, column]
                extent += abs(entry) * half_size[geometry, column]
                lanes[slot, _TO_WORLD + 3 * row + column] = entry / own_scale * scale
                inverse_entry = inverse[instance, row, column] / scale * own_scale
                # Written so that NaN is too large.
                if not abs(inverse_entry) <= _MOST_INVERSE:
                    return instance
                lanes[slot, _TO_OBJECT + 3 * row + column] = inverse_entry
            squared_radius += (extent * scale) * (extent * scale)
            local = (place - centre[row]) * scale
            lanes[slot, _CENTRE + row] = local
            lanes[slot, _CENTRE_LOW + row] = local - np.float64(lanes[slot, _CENTRE + row])
        lanes[slot, _RADIUS] = np.sqrt(squared_radius) * _ROOM
        ints[slot, _FIRST_NODE], ints[slot, _FIRST_BLOCK] = ranges[geometry, 0], ranges[geometry, 1]
        ints[slot, _BLOCK_COUNT], ints[slot, _KIND] = ranges[geometry, 2], ranges[geometry, 3]
        ints[slot, _MASK], ints[slot, _ID] = masks[instance], instance
    return -1


def prune_top(top: TopTree, instance_ids: NDArray[np.integer]) -> dict[str, NDArray[np.void]]:
    """Return the arrays of the tree over some instances, by the names of the kernels' arguments.

    Parameters
    ----------
    top : TopTree
    instance_ids : (n,) int
        Without any, the tree is over one instance that nothing sees.

    Notes
    -----
    O(instances of the scene), in this thread: 0.1 to 0.6 ms for 10,000. Leaves keep their boxes; those of interior
    nodes shrink.
    """
    is_chosen = np.zeros(len(top.instances), np.bool_)
    is_chosen[instance_ids] = True
    is_left = is_chosen[top.instances["instance_id"]]
    is_empty = not is_left.any()
    if is_empty:
        is_left[0] = True
    instances = top.instances[is_left]
    if is_empty:
        instances["mask"] = 0
    nodes = np.ascontiguousarray(top.bvh.nodes).view(np.float32).reshape(-1, NODE_LANES)
    pruned = np.empty((2 * len(instances) - 1, NODE_LANES), np.float32)
    count = _prune(nodes, nodes.view(np.int32), is_left, pruned, pruned.view(np.int32))
    # Only the links and the boxes are read, not the primitives.
    bvh = Bvh(pruned[:count].view(NODE).reshape(-1), top.bvh.prim_ids, top.bvh.shape)
    return {"top_nodes": make_bvh2_nodes(bvh), "instances": instances}


@compiled
def _prune(nodes, node_ints, is_left, pruned, pruned_ints):
    """Write the nodes over the primitives that are left, children behind their parents; return their number."""
    left_before = np.zeros(len(is_left) + 1, np.int32)
    for prim in range(len(is_left)):
        left_before[prim + 1] = left_before[prim] + is_left[prim]
    has_any = np.empty(len(nodes), np.bool_)
    for node in range(len(nodes) - 1, -1, -1):
        first, count = node_ints[node, NODE_FIRST], node_ints[node, NODE_COUNT]
        if count > 0:
            has_any[node] = left_before[first + count] > left_before[first]
        else:
            has_any[node] = has_any[first] or has_any[first + 1]

    sources = np.empty(len(pruned), np.int32)
    sources[0] = 0
    pruned_count, target = 1, 0
    while target < pruned_count:
        # A node one of whose children is empty is nothing but the other one.
        node = sources[target]
        while node_ints[node, NODE_COUNT] == 0:
            child = node_ints[node, NODE_FIRST]
            if has_any[child] and has_any[child + 1]:
                break
            node = child if has_any[child] else child + 1
        first, count = node_ints[node, NODE_FIRST], node_ints[node, NODE_COUNT]
        for lane in range(nodes.shape[1]):
            pruned[target, lane] = nodes[node, lane]
        if count > 0:
            pruned_ints[target, NODE_FIRST] = left_before[first]
            pruned_ints[target, NODE_COUNT] = left_before[first + count] - left_before[first]
        else:
            pruned_ints[target, NODE_FIRST] = pruned_count
            sources[pruned_count], sources[pruned_count + 1] = first, first + 1
            pruned_count += 2
        target += 1

    for node in range(pruned_count - 1, -1, -1):
        if pruned_ints[node, NODE_COUNT] == 0:
            child = pruned_ints[node, NODE_FIRST]
            for axis in range(3):
                pruned[node, axis] = min(pruned[child, axis], pruned[child + 1, axis])
                pruned[node, NODE_MAX + axis] = max(pruned[child, NODE_MAX + axis], pruned[child + 1, NODE_MAX + axis])
    return pruned_count
