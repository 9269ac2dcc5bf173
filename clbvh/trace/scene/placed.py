"""Instances as numbers: the boxes of placed geometries, and the records that the device reads.

Everything is computed in float64 from the 4 x 4 matrices; see `structs.INSTANCE` for what is kept in float32.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError
from ...structs import INSTANCE
from ...support.compiled import compiled
from ..hits.scene_arrays import SceneArrays

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


_TO_OBJECT, _TO_SCENE = _lane("to_object"), _lane("to_scene")
_CENTRE, _CENTRE_LOW, _RADIUS = _lane("centre"), _lane("centre_low"), _lane("radius")
_FIRST_NODE, _FIRST_BLOCK, _BLOCK_COUNT = _lane("first_node"), _lane("first_block"), _lane("block_count")
_KIND, _MASK = _lane("kind"), _lane("mask")
_PRIM_BITS, _ID = _lane("prim_bits"), _lane("instance_id")


class RecordFields(NamedTuple):
    """What `structs.INSTANCE` says of n instances beside their placement.

    Attributes
    ----------
    masks, instance_ids, prim_bits : (n,) int32
    """

    masks: NDArray[np.int32]
    instance_ids: NDArray[np.int32]
    prim_bits: NDArray[np.int32]


class LocalFrame(NamedTuple):
    """The scene's local coordinates, ``(point - centre) * scale``; centre is (3,) float64."""

    centre: NDArray[np.float64]
    scale: float


def find_boxes(arrays: SceneArrays) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners of the instances' boxes in the scene's coordinates, each (n, 3) float64.

    A ray that hits an instance meets its box, as far as float32 can tell.
    """
    lower, upper = np.empty(arrays.offset.shape), np.empty(arrays.offset.shape)
    _find_boxes(arrays, lower, upper)
    growth = _SCENE_GROWTH * float(np.max(upper.max(axis=0) / 2 - lower.min(axis=0) / 2))
    lower -= growth
    upper += growth
    return lower, upper


def make_records(
    arrays: SceneArrays,
    parts: NDArray[np.int32],
    fields: RecordFields,
    order: NDArray[np.int32],
    frame: LocalFrame,
) -> NDArray[np.void]:
    """Return the instances as the device takes them.

    Parameters
    ----------
    arrays : SceneArrays
        Of n instances.
    parts : (geometries, 4) int32
        First node, first block, number of blocks and kind of primitives of each geometry, see `structs.INSTANCE`.
    fields : RecordFields
    order : (n,) int32
        Instances in the order of the leaves of the tree over them.
    frame : LocalFrame

    Returns
    -------
    (n,) `structs.INSTANCE`

    Raises
    ------
    SceneError
        An instance is too small or too flat beside the scene.
    """
    lanes = np.zeros((len(order), _LANES), np.float32)
    bad = _write_records(arrays, parts, fields, order, frame, lanes, lanes.view(np.int32))
    if bad >= 0:
        raise SceneError(
            f"the instance {fields.instance_ids[bad]} is smaller than {1 / _MOST_INVERSE:.0e} of the scene, at least "
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
def _write_records(arrays, parts, fields, order, frame, lanes, ints):
    """Write the records; return the first instance that is too small, or -1."""
    linear, inverse, origin, half_size = arrays.linear, arrays.inverse, arrays.origin, arrays.half_size
    centre, scale = frame.centre, frame.scale
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
                lanes[slot, _TO_SCENE + 3 * row + column] = entry / own_scale * scale
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
        ints[slot, _FIRST_NODE], ints[slot, _FIRST_BLOCK] = parts[geometry, 0], parts[geometry, 1]
        ints[slot, _BLOCK_COUNT], ints[slot, _KIND] = parts[geometry, 2], parts[geometry, 3]
        ints[slot, _MASK] = fields.masks[instance]
        ints[slot, _PRIM_BITS], ints[slot, _ID] = fields.prim_bits[instance], fields.instance_ids[instance]
    return -1
