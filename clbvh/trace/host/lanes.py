"""One ray on the host, to the last bit as on the device: its shear, its padding, and the boxes and triangles it meets.

The steps for all children of a node, or all triangles of a block, are vector instructions, as in `cl/math/lanes.cl`.
The compiler leaves loops over lanes that lie in arrays one by one, because the arrays might overlap. Comparisons with
NaN are false, as on the device.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from ...support.compiled import compiled
from ...support.loop_functions import fused

_FLOAT, _INT = ir.FloatType(), ir.IntType(32)

# Lanes are aligned as single numbers.
_ALIGNMENT = 4


@intrinsic
def meet_boxes(
    typing_context, slots, nodes, near_indices, far_indices, near_origin, far_origin, inverse, limits, t_nears
):
    """Return the bits of the boxes that a ray meets, and write where it enters each, as `meets_aabb` in cl/boxes.

    Parameters
    ----------
    slots : tuple of int
        As many as there are lanes.
    nodes : (n,) float32
    near_indices, far_indices : 3 uint64
        Of the first lane of the near and the far planes, per axis.
    near_origin, far_origin, inverse : 3 float32
        Per axis; see `pad_ray`.
    limits : 2 float32
        The ray's t_min, and the t beyond which nothing is looked for.
    t_nears : (lanes,) uint32, written
        The bits of float32.
    """
    width = len(slots)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lanes = _Lanes(context, builder, width)
        data = lanes.data_of(signature.args[1], arguments[1])
        near_indices, far_indices, near_origin, far_origin, inverse, limits = (
            lanes.unpack(values) for values in arguments[2:8]
        )
        t_near, t_far = lanes.spread(limits[0]), lanes.spread(limits[1])
        for axis in (2, 1, 0):
            slope = lanes.spread(inverse[axis])
            near = lanes.load(data, near_indices[axis])
            near = builder.fmul(builder.fsub(near, lanes.spread(near_origin[axis])), slope)
            far = lanes.load(data, far_indices[axis])
            far = builder.fmul(builder.fsub(far, lanes.spread(far_origin[axis])), slope)
            t_near = builder.select(builder.fcmp_ordered(">", near, t_near), near, t_near)
            t_far = builder.select(builder.fcmp_ordered("<", far, t_far), far, t_far)
        lanes.store(t_near, lanes.data_of(signature.args[8], arguments[8]))
        return lanes.bits(builder.fcmp_ordered("<=", t_near, t_far))

    triple, pair = types.UniTuple(types.float32, 3), types.UniTuple(types.float32, 2)
    indices = types.UniTuple(types.uint64, 3)
    return types.uint32(slots, nodes, indices, indices, triple, triple, triple, pair, t_nears), generate


@intrinsic
def pass_edges(typing_context, slots, blocks, first_index, axes, origin, shear):
    """Return the bits of the triangles of a block that plain edge functions do not reject; see cl/triangles/block.cl.

    Parameters
    ----------
    slots : tuple of int
        As many as there are lanes.
    blocks : (n,) float32
    first_index : uint64
        Of the block's first lane.
    axes : 3 uint64
        Those that become x, y and z.
    origin : 3 float32
        Permuted in the same way.
    shear : 2 float32
    """
    width = len(slots)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lanes = _Lanes(context, builder, width)
        data = lanes.data_of(signature.args[1], arguments[1])
        axes, origin, shear = (lanes.unpack(values) for values in arguments[3:6])
        index_type = arguments[2].type
        corners = []
        for corner in range(3):
            x, y, z = (
                builder.fsub(
                    lanes.load(
                        data,
                        builder.add(
                            arguments[2],
                            builder.mul(
                                builder.add(axes[axis], ir.Constant(index_type, 3 * corner)),
                                ir.Constant(index_type, width),
                            ),
                        ),
                    ),
                    lanes.spread(origin[axis]),
                )
                for axis in range(3)
            )
            corners.append(
                (
                    builder.fsub(x, builder.fmul(lanes.spread(shear[0]), z)),
                    builder.fsub(y, builder.fmul(lanes.spread(shear[1]), z)),
                )
            )
        (ax, ay), (bx, by), (cx, cy) = corners
        edges = [
            builder.fsub(builder.fmul(one_x, other_y), builder.fmul(one_y, other_x))
            for one_x, one_y, other_x, other_y in ((cx, cy, bx, by), (ax, ay, cx, cy), (bx, by, ax, ay))
        ]
        zero = lanes.spread(ir.Constant(_FLOAT, 0.0))
        left, right = (
            lanes.all_of([builder.fcmp_ordered(sign, edge, zero) for edge in edges]) for sign in (">=", "<=")
        )
        return lanes.bits(builder.or_(left, right))

    indices = types.UniTuple(types.uint64, 3)
    triple, pair = types.UniTuple(types.float32, 3), types.UniTuple(types.float32, 2)
    return types.uint32(slots, blocks, types.uint64, indices, triple, pair), generate


@intrinsic
def count_others(typing_context, slots, numbers, first_index, value):
    """Return how many lanes are not a value.

    Parameters
    ----------
    slots : tuple of int
        As many as there are lanes.
    numbers : (n,) int32
    first_index : uint64
        Of the first lane.
    value : int32
    """
    width = len(slots)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lanes = _Lanes(context, builder, width, _INT)
        found = lanes.load(lanes.data_of(signature.args[1], arguments[1]), arguments[2])
        return builder.ctpop(lanes.bits(builder.icmp_signed("!=", found, lanes.spread(arguments[3]))))

    return types.uint32(slots, numbers, types.uint64, types.int32), generate


@intrinsic
def lowest_bit(typing_context, bits):
    """Return the index of the lowest bit that is set, of a number that is not 0."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        index = builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))
        return builder.zext(index, ir.IntType(64))

    return types.uint64(types.uint32), generate


class _Lanes:
    """Writes the instructions for vectors of `width` numbers of 4 bytes."""

    def __init__(self, context: Any, builder: Any, width: int, number: Any = _FLOAT) -> None:
        self._context, self._builder, self._width = context, builder, width
        self._vector = ir.VectorType(number, width)

    def data_of(self, array_type: Any, array: Any) -> Any:
        return self._context.make_array(array_type)(self._context, self._builder, array).data

    def unpack(self, values: Any) -> list[Any]:
        return [self._builder.extract_value(values, index) for index in range(values.type.count)]

    def load(self, data: Any, index: Any) -> Any:
        pointer = self._builder.bitcast(self._builder.gep(data, [index]), self._vector.as_pointer())
        return self._builder.load(pointer, align=_ALIGNMENT)

    def store(self, vector: Any, data: Any) -> None:
        self._builder.store(vector, self._builder.bitcast(data, self._vector.as_pointer()), align=_ALIGNMENT)

    def spread(self, number: Any) -> Any:
        """Return a vector of the same number."""
        undefined, first = ir.Constant(self._vector, ir.Undefined), ir.Constant(_INT, 0)
        one = self._builder.insert_element(undefined, number, first)
        zeros = ir.Constant(ir.VectorType(_INT, self._width), [0] * self._width)
        return self._builder.shuffle_vector(one, undefined, zeros)

    def all_of(self, conditions: Sequence[Any]) -> Any:
        one, other, third = conditions
        return self._builder.and_(self._builder.and_(one, other), third)

    def bits(self, condition: Any) -> Any:
        """Return a condition of each lane as the bits of one number."""
        return self._builder.zext(self._builder.bitcast(condition, ir.IntType(self._width)), _INT)


_ROUNDING = 2.0**-24


def _error_bound(roundings: int) -> np.float32:
    return np.float32(roundings * _ROUNDING / (1 - roundings * _ROUNDING))


# The constants of cl/boxes/padding.cl.
_AXIS_PADDING = _error_bound(14)
_TIME_PADDING = _error_bound(28)
_LARGEST_COORDINATE = np.float32(1.0)
_MIN_SLOPE = np.float32(2.0**-30)

_ZERO, _ONE, _TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)


class HostRay(NamedTuple):
    """A ray made ready for boxes and triangles; three float32 each, per axis, unless stated.

    Attributes
    ----------
    near_origin, far_origin : where the near and the far planes of boxes are seen from
    inverse : of the direction
    axes : 3 int64, those that become x, y and z
    origin : permuted by `axes`
    shear : makes the ray the z axis
    perturbation : 2 float32
    """

    near_origin: tuple[Any, Any, Any]
    far_origin: tuple[Any, Any, Any]
    inverse: tuple[Any, Any, Any]
    axes: tuple[int, int, int]
    origin: tuple[Any, Any, Any]
    shear: tuple[Any, Any, Any]
    perturbation: tuple[Any, Any]


@compiled(error_model="numpy", is_inlined=True)
def make_host_ray(origin, direction):
    """Return a `HostRay` of 3 float32 each; see `make_ray` in cl/rays/ray.cl and `pad_ray` in cl/boxes.

    Everything is a number or a tuple of them, which stay in registers.
    """
    x, y, z = abs(direction[0]), abs(direction[1]), abs(direction[2])
    z_axis = (0 if x > z else 2) if x > y else (1 if y > z else 2)
    x_axis = 0 if z_axis == 2 else z_axis + 1
    y_axis = 0 if x_axis == 2 else x_axis + 1
    along = pick(direction, z_axis)
    shear = pick(direction, x_axis) / along, pick(direction, y_axis) / along, _ONE / along
    point = pick(origin, x_axis), pick(origin, y_axis), pick(origin, z_axis)
    perturbation = -point[0] - shear[0] * -point[2], -point[1] - shear[1] * -point[2]

    longest_reach = abs(point[2]) + _LARGEST_COORDINATE
    distance = _TWO * _MIN_SLOPE * longest_reach
    time = _TIME_PADDING * longest_reach * abs(shear[2])
    near_x, far_x, inverse_x = _pad_axis(origin[0], direction[0], distance, time)
    near_y, far_y, inverse_y = _pad_axis(origin[1], direction[1], distance, time)
    near_z, far_z, inverse_z = _pad_axis(origin[2], direction[2], distance, time)
    return HostRay(
        (near_x, near_y, near_z), (far_x, far_y, far_z), (inverse_x, inverse_y, inverse_z), (x_axis, y_axis, z_axis),
        point, shear, perturbation,
    )  # fmt: skip


@compiled(error_model="numpy")
def _pad_axis(origin, direction, distance, time):
    """Return the origins from which near and far planes are seen on one axis, and the inverse of the direction."""
    inverse = _ONE / direction
    width = _AXIS_PADDING * (abs(origin) + _LARGEST_COORDINATE) + distance + time * abs(direction)
    ahead = -width if inverse < _ZERO else width
    return origin + ahead, origin - ahead, inverse


@compiled(error_model="numpy")
def pick(values, axis):
    """Return one of three numbers: selections, where an index would become branches."""
    return values[0] if axis == 0 else values[1] if axis == 1 else values[2]


@compiled(error_model="numpy", is_inlined=True)
def shear_corner(corner, ray):
    """Return a corner of a triangle, whose axes are permuted as the ray's, as the ray sees it."""
    x, y, z = corner[0] - ray.origin[0], corner[1] - ray.origin[1], corner[2] - ray.origin[2]
    return x - ray.shear[0] * z, y - ray.shear[1] * z, ray.shear[2] * z


@compiled(error_model="numpy", is_inlined=True)
def cross_corners(a, b, c, perturbation):
    """Return t where the ray crosses the triangle of three sheared corners, NaN if it does not: the device's bits."""
    edge_a, edge_b, edge_c = _edge(c[0], b[1], c[1], b[0]), _edge(a[0], c[1], a[1], c[0]), _edge(b[0], a[1], b[1], a[0])
    area = edge_a + edge_b + edge_c
    side_a = _side_of_edge(edge_a, b, c, perturbation)
    side_b = _side_of_edge(edge_b, c, a, perturbation)
    side_c = _side_of_edge(edge_c, a, b, perturbation)
    is_left = side_a < _ZERO or side_b < _ZERO or side_c < _ZERO
    is_right = side_a > _ZERO or side_b > _ZERO or side_c > _ZERO
    if (is_left and is_right) or area == _ZERO:
        return np.float32(np.nan)
    return (edge_a * a[2] + edge_b * b[2] + edge_c * c[2]) / area


@compiled(error_model="numpy")
def _side_of_edge(edge, begin, end, perturbation):
    """Return the edge function, and where it is zero, that of the perturbed ray."""
    if edge != _ZERO:
        return edge
    along_x, along_y = end[0] - begin[0], end[1] - begin[1]
    perturbed = _edge(perturbation[0], along_y, perturbation[1], along_x)
    if perturbed != _ZERO:
        return perturbed
    return along_y if along_y != _ZERO else -along_x


@compiled(error_model="numpy")
def _edge(a, b, c, d):
    """Return a * b - c * d as `difference_of_products` in cl/triangles/triangle.cl."""
    rounded = c * d
    return fused(a, b, -rounded) + fused(-c, d, rounded)
