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
from numba.extending import models, register_model

from ..structs import BOX_LANES, BOX_TAG, BOX_TALLY
from ..support.loop_functions import ARRAY, instruction

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


def _row_pointer(builder: Any, rows: Any, row: Any) -> Any:
    """Return a pointer to one row of a C-contiguous (n, 8) float32 array."""
    lanes = builder.bitcast(rows, _FLOAT.as_pointer())
    first_lane = builder.mul(row, ir.Constant(row.type, BOX_LANES))
    return builder.bitcast(builder.gep(lanes, [first_lane]), _ROW.as_pointer())


def _shuffle(builder: Any, value: Any, lanes: list[int]) -> Any:
    mask = ir.Constant(ir.VectorType(_INT, len(lanes)), lanes)
    return builder.shuffle_vector(value, ir.Constant(value.type, ir.Undefined), mask)


def _splat(builder: Any, value: Any) -> Any:
    """Return a row with the same float in every lane."""
    first = builder.insert_element(ir.Constant(_ROW, ir.Undefined), value, ir.Constant(_INT, 0))
    return _shuffle(builder, first, [0] * BOX_LANES)


@instruction(BOX, ARRAY, types.intp)
def load_box(builder, rows, row):
    """Return `rows[row]` as a box."""
    return builder.load(_row_pointer(builder, rows, row), align=_BYTES_PER_LANE)


@instruction(BOX, ARRAY, types.intp)
def load_point(builder, points, point):
    """Return row `point` of a C-contiguous (n, 3) float32 array as a box without extent; it holds no negative zero."""
    first = builder.gep(points, [builder.mul(point, ir.Constant(point.type, _AXES))])
    half = ir.Constant(ir.VectorType(_FLOAT, _HALF), [0.0] * _HALF)
    for axis in range(_AXES):
        coordinate = builder.load(builder.gep(first, [ir.Constant(point.type, axis)]), align=_BYTES_PER_LANE)
        half = builder.insert_element(half, coordinate, ir.Constant(_INT, axis))
    both = builder.shuffle_vector(half, builder.fneg(half), ir.Constant(_INT_ROW, list(range(BOX_LANES))))
    return builder.fadd(both, ir.Constant(_ROW, [0.0] * BOX_LANES))  # -0.0 + 0.0 is 0.0


@instruction(types.void, ARRAY, types.intp, BOX)
def store_box(builder, rows, row, box):
    """Write a box to `rows[row]`, bit by bit: the tag lane may hold an integer."""
    builder.store(box, _row_pointer(builder, rows, row), align=_BYTES_PER_LANE)


@instruction(BOX, BOX, BOX)
def unite(builder, left, right):
    """Return the box of two boxes."""
    return builder.select(builder.fcmp_ordered("<", left, right), left, right)


@instruction(types.void, ARRAY, types.intp, BOX)
def add_to_box(builder, rows, row, box):
    """Unite a box into `rows[row]`, and count it in the row's tally."""
    pointer = _row_pointer(builder, rows, row)
    before = builder.load(pointer, align=_BYTES_PER_LANE)
    united = builder.select(builder.fcmp_ordered("<", box, before), box, before)
    counted = builder.add(builder.bitcast(before, _INT_ROW), ir.Constant(_INT_ROW, [1] * BOX_LANES))
    result = builder.shuffle_vector(united, builder.bitcast(counted, _ROW), ir.Constant(_INT_ROW, _LAST_OF_OTHER))
    builder.store(result, pointer, align=_BYTES_PER_LANE)


@instruction(types.intp, BOX)
def tally_of(builder, box):
    """Return the tally of a row."""
    lanes = builder.bitcast(box, _INT_ROW)
    return builder.zext(builder.extract_element(lanes, ir.Constant(_INT, BOX_TALLY)), ir.IntType(64))


@instruction(BOX, BOX, types.intp, types.intp)
def as_node(builder, box, first, count):
    """Return a box with a positive maximum, and two int32 in the tag and in the tally: a row of `structs.NODE`."""
    zero = ir.Constant(_ROW, [0.0] * BOX_LANES)
    # Subtracted from 0 instead of negated, which could make -0.0.
    positive = builder.fsub(zero, box)
    row = builder.shuffle_vector(box, positive, ir.Constant(_INT_ROW, _UPPER_HALF_OF_OTHER))
    lanes = builder.bitcast(row, _INT_ROW)
    for lane, number in ((BOX_TAG, first), (BOX_TALLY, count)):
        lanes = builder.insert_element(lanes, builder.trunc(number, _INT), ir.Constant(_INT, lane))
    return builder.bitcast(lanes, _ROW)


@instruction(BOX, BOX)
def box_of_node(builder, node):
    """Return the box of a row of `structs.NODE`, the inverse of `as_node`."""
    return builder.shuffle_vector(node, builder.fneg(node), ir.Constant(_INT_ROW, _UPPER_HALF_OF_OTHER))


@instruction(BOX)
def empty_box(builder):
    """Return the neutral element of `unite`; its tally is 0."""
    return ir.Constant(_ROW, [float("inf")] * BOX_TALLY + [0.0])


@instruction(BOX, BOX)
def centroid_of(builder, box):
    """Return the box that holds only the doubled centroid, min + max."""
    # Minus the swapped halves: min - (-max) in the lower half, -max - min in the upper one.
    return builder.fsub(box, _shuffle(builder, box, _SWAPPED))


@instruction(types.float64, BOX)
def half_area(builder, box):
    """Return half the surface area of a box that is not empty, as float64."""
    # In float64: areas of a mesh that is 1e20 units wide do not fit float32.
    wide = ir.VectorType(_DOUBLE, _HALF)
    lower = builder.fpext(_shuffle(builder, box, _LOWER_AXES), wide)
    upper = builder.fpext(_shuffle(builder, box, _UPPER_AXES), wide)
    size = builder.fadd(lower, upper)  # negative, which cancels in the products
    products = builder.fmul(size, _shuffle(builder, size, [1, 2, 0, 0]))
    x, y, z = (builder.extract_element(products, ir.Constant(_INT, axis)) for axis in range(3))
    return builder.fadd(builder.fadd(x, y), z)


@instruction(BOX, BOX, types.float32, types.float32)
def scales_of(builder, bounds, bin_count, smallest_extent):
    """Return the factors ``bin_count / extent`` of a box in the first three lanes; 0 on an axis that is flat.

    Parameters
    ----------
    bounds : box
    bin_count : float32
    smallest_extent : float32
        An extent that is not above this is flat.
    """
    extent = builder.fneg(builder.fadd(bounds, _shuffle(builder, bounds, _SWAPPED)))
    flat = builder.fcmp_unordered("<=", extent, _splat(builder, smallest_extent))
    scale = builder.fdiv(_splat(builder, bin_count), extent)
    return builder.select(flat, ir.Constant(_ROW, [0.0] * BOX_LANES), scale)


@instruction(types.float32, BOX, types.intp)
def lane_of(builder, box, lane):
    """Return one lane of a box."""
    return builder.extract_element(box, builder.trunc(lane, _INT))


@instruction(types.UniTuple(types.intp, 3), BOX, BOX, BOX)
def bins_of(builder, box, lower, scale):
    """Return the bins of a box's centroid on the three axes, each ``int((centroid - lower) * scale)``."""
    centroid = builder.fsub(_shuffle(builder, box, _LOWER_AXES), _shuffle(builder, box, _UPPER_AXES))
    distance = builder.fsub(centroid, _shuffle(builder, lower, _LOWER_AXES))
    position = builder.fmul(distance, _shuffle(builder, scale, _LOWER_AXES))
    whole = builder.fptosi(position, ir.VectorType(_INT, _HALF))
    return [builder.zext(builder.extract_element(whole, ir.Constant(_INT, axis)), ir.IntType(64)) for axis in range(3)]
