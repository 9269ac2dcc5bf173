"""Boxes as eight float lanes that stay in one register, for compiled loops.

The only hand-written LLVM besides `support/loop_functions.py`: numba's optimiser neither finds the eight-lane minimum
nor keeps a running box in a register. Must not know of meshes or trees.

A row of an (n, 8) float32 array is ``(min_x, min_y, min_z, tag, -max_x, -max_y, -max_z, tally)``. The maximum is kept
negated, so that one eight-lane minimum unites two boxes. A minimum leaves garbage in the tag and in the tally; only
`add_to_box` keeps the tally, an integer.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, models, register_model

from ..structs import BOX_LANES, BOX_TAG, BOX_TALLY

_HALF = 4
_AXES = 3
_BYTES_PER_LANE = 4

_FLOAT = ir.FloatType()
_DOUBLE = ir.DoubleType()
_INT = ir.IntType(32)
_ROW = ir.VectorType(_FLOAT, BOX_LANES)
_INT_ROW = ir.VectorType(_INT, BOX_LANES)

# The two halves of a row, swapped.
_SWAPPED = [4, 5, 6, 7, 0, 1, 2, 3]
# All lanes of one row but the last, which comes from another row.
_LAST_OF_OTHER = [0, 1, 2, 3, 4, 5, 6, BOX_LANES + BOX_TALLY]
# The lower half of one row and the upper half of another.
_UPPER_HALF_OF_OTHER = [0, 1, 2, 3, 12, 13, 14, 15]
# The three axes in half a row; the fourth lane repeats one, so that it holds a number.
_LOWER_AXES = [0, 1, 2, 2]
_UPPER_AXES = [4, 5, 6, 6]


class _BoxType(types.Type):
    """A row in a register."""

    def __init__(self) -> None:
        super().__init__(name="Box8")


BOX = _BoxType()


@register_model(_BoxType)
class _BoxModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _ROW)


def _row_pointer(context: Any, builder: Any, array_type: Any, array: Any, row: Any) -> Any:
    """Return a pointer to one row of a C-contiguous (n, 8) float32 array."""
    data = context.make_array(array_type)(context, builder, array).data
    lanes = builder.bitcast(data, _FLOAT.as_pointer())
    first_lane = builder.mul(row, ir.Constant(row.type, BOX_LANES))
    return builder.bitcast(builder.gep(lanes, [first_lane]), _ROW.as_pointer())


def _shuffle(builder: Any, value: Any, lanes: list[int]) -> Any:
    mask = ir.Constant(ir.VectorType(_INT, len(lanes)), lanes)
    return builder.shuffle_vector(value, ir.Constant(value.type, ir.Undefined), mask)


def _splat(builder: Any, value: Any) -> Any:
    """Return a row with the same float in every lane."""
    first = builder.insert_element(ir.Constant(_ROW, ir.Undefined), value, ir.Constant(_INT, 0))
    return _shuffle(builder, first, [0] * BOX_LANES)


@intrinsic
def load_box(typing_context, rows, row):
    """Return `rows[row]` as a box."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_row_pointer(context, builder, signature.args[0], *arguments), align=_BYTES_PER_LANE)

    return BOX(rows, types.intp), generate


@intrinsic
def load_point(typing_context, points, point):
    """Return row `point` of a C-contiguous (n, 3) float32 array as a box without extent; it holds no negative zero."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        points, point = arguments
        data = context.make_array(signature.args[0])(context, builder, points).data
        first = builder.gep(data, [builder.mul(point, ir.Constant(point.type, _AXES))])
        half: Any = ir.Constant(ir.VectorType(_FLOAT, _HALF), [0.0] * _HALF)
        for axis in range(_AXES):
            coordinate = builder.load(builder.gep(first, [ir.Constant(point.type, axis)]), align=_BYTES_PER_LANE)
            half = builder.insert_element(half, coordinate, ir.Constant(_INT, axis))
        both = builder.shuffle_vector(half, builder.fneg(half), ir.Constant(_INT_ROW, list(range(BOX_LANES))))
        return builder.fadd(both, ir.Constant(_ROW, [0.0] * BOX_LANES))  # -0.0 + 0.0 is 0.0

    return BOX(points, types.intp), generate


@intrinsic
def store_box(typing_context, rows, row, box):
    """Write a box to `rows[row]`, bit by bit: the tag lane may hold an integer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _row_pointer(context, builder, signature.args[0], *arguments[:2])
        builder.store(arguments[2], pointer, align=_BYTES_PER_LANE)
        return context.get_dummy_value()

    return types.void(rows, types.intp, BOX), generate


@intrinsic
def unite(typing_context, left, right):
    """Return the box of two boxes."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        left, right = arguments
        return builder.select(builder.fcmp_ordered("<", left, right), left, right)

    return BOX(BOX, BOX), generate


@intrinsic
def add_to_box(typing_context, rows, row, box):
    """Unite a box into `rows[row]`, and count it in the row's tally."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _row_pointer(context, builder, signature.args[0], *arguments[:2])
        row, box = builder.load(pointer, align=_BYTES_PER_LANE), arguments[2]
        united = builder.select(builder.fcmp_ordered("<", box, row), box, row)
        counted = builder.add(builder.bitcast(row, _INT_ROW), ir.Constant(_INT_ROW, [1] * BOX_LANES))
        mask = ir.Constant(_INT_ROW, _LAST_OF_OTHER)
        result = builder.shuffle_vector(united, builder.bitcast(counted, _ROW), mask)
        builder.store(result, pointer, align=_BYTES_PER_LANE)
        return context.get_dummy_value()

    return types.void(rows, types.intp, BOX), generate


@intrinsic
def tally_of(typing_context, box):
    """Return the tally of a row."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lanes = builder.bitcast(arguments[0], _INT_ROW)
        return builder.zext(builder.extract_element(lanes, ir.Constant(_INT, BOX_TALLY)), ir.IntType(64))

    return types.intp(BOX), generate


@intrinsic
def as_node(typing_context, box, first, count):
    """Return a box with a positive maximum, and two int32 in the tag and in the tally: a row of `structs.NODE`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        box, *numbers = arguments
        zero = ir.Constant(_ROW, [0.0] * BOX_LANES)
        # Subtracted from 0 instead of negated, which could make -0.0.
        positive = builder.fsub(zero, box)
        row = builder.shuffle_vector(box, positive, ir.Constant(_INT_ROW, _UPPER_HALF_OF_OTHER))
        lanes = builder.bitcast(row, _INT_ROW)
        for lane, number in zip((BOX_TAG, BOX_TALLY), numbers, strict=True):
            lanes = builder.insert_element(lanes, builder.trunc(number, _INT), ir.Constant(_INT, lane))
        return builder.bitcast(lanes, _ROW)

    return BOX(BOX, types.intp, types.intp), generate


@intrinsic
def box_of_node(typing_context, node):
    """Return the box of a row of `structs.NODE`, the inverse of `as_node`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        mask = ir.Constant(_INT_ROW, _UPPER_HALF_OF_OTHER)
        return builder.shuffle_vector(arguments[0], builder.fneg(arguments[0]), mask)

    return BOX(BOX), generate


@intrinsic
def empty_box(typing_context):
    """Return the neutral element of `unite`; its tally is 0."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return ir.Constant(_ROW, [float("inf")] * BOX_TALLY + [0.0])

    return BOX(), generate


@intrinsic
def centroid_of(typing_context, box):
    """Return the box that holds only the doubled centroid, min + max."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        # Minus the swapped halves: min - (-max) in the lower half, -max - min in the upper one.
        swapped = _shuffle(builder, arguments[0], _SWAPPED)
        return builder.fsub(arguments[0], swapped)

    return BOX(BOX), generate


@intrinsic
def half_area(typing_context, box):
    """Return half the surface area of a box that is not empty, as float64."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        # In float64: areas of a mesh that is 1e20 units wide do not fit float32.
        wide = ir.VectorType(_DOUBLE, _HALF)
        lower = builder.fpext(_shuffle(builder, arguments[0], _LOWER_AXES), wide)
        upper = builder.fpext(_shuffle(builder, arguments[0], _UPPER_AXES), wide)
        size = builder.fadd(lower, upper)  # negative, which cancels in the products
        products = builder.fmul(size, _shuffle(builder, size, [1, 2, 0, 0]))
        x, y, z = (builder.extract_element(products, ir.Constant(_INT, axis)) for axis in range(3))
        return builder.fadd(builder.fadd(x, y), z)

    return types.float64(BOX), generate


@intrinsic
def scales_of(typing_context, bounds, bin_count, smallest_extent):
    """Return the factors ``bin_count / extent`` of a box in the first three lanes; 0 on an axis that is flat.

    Parameters
    ----------
    bounds : box
    bin_count : float32
    smallest_extent : float32
        An extent that is not above this is flat.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bounds, bin_count, smallest = arguments
        swapped = _shuffle(builder, bounds, _SWAPPED)
        extent = builder.fneg(builder.fadd(bounds, swapped))
        flat = builder.fcmp_unordered("<=", extent, _splat(builder, smallest))
        scale = builder.fdiv(_splat(builder, bin_count), extent)
        return builder.select(flat, ir.Constant(_ROW, [0.0] * BOX_LANES), scale)

    return BOX(BOX, types.float32, types.float32), generate


@intrinsic
def lane_of(typing_context, box, lane):
    """Return one lane of a box."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.extract_element(arguments[0], builder.trunc(arguments[1], _INT))

    return types.float32(BOX, types.intp), generate


@intrinsic
def bins_of(typing_context, box, lower, scale):
    """Return the bins of a box's centroid on the three axes, each ``int((centroid - lower) * scale)``."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        box, lower, scale = arguments
        centroid = builder.fsub(_shuffle(builder, box, _LOWER_AXES), _shuffle(builder, box, _UPPER_AXES))
        distance = builder.fsub(centroid, _shuffle(builder, lower, _LOWER_AXES))
        position = builder.fmul(distance, _shuffle(builder, scale, _LOWER_AXES))
        whole = builder.fptosi(position, ir.VectorType(_INT, _HALF))
        axes = [builder.zext(builder.extract_element(whole, ir.Constant(_INT, a)), ir.IntType(64)) for a in range(3)]
        return context.make_tuple(builder, signature.return_type, axes)

    return types.UniTuple(types.intp, 3)(BOX, BOX, BOX), generate
