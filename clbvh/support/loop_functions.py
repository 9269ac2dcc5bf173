"""Functions for compiled loops: vectors of three numbers, powers of two, and instructions that numba does not offer.

Vectors are tuples, because slices of arrays would take the compiler seconds. Powers of two are made from the bits of
float64: the library's `frexp` and `ldexp` take 5 ns a call.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from .compiled import compiled


@compiled
def dot(one, other):
    """Return the dot product."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


@compiled
def cross(one, other):
    """Return the cross product."""
    return (
        one[1] * other[2] - one[2] * other[1],
        one[2] * other[0] - one[0] * other[2],
        one[0] * other[1] - one[1] * other[0],
    )


@compiled
def subtract(one, other):
    """Return the difference."""
    return one[0] - other[0], one[1] - other[1], one[2] - other[2]


@compiled
def add_scaled(one, factor, other):
    """Return ``one + factor * other``."""
    return one[0] + factor * other[0], one[1] + factor * other[1], one[2] + factor * other[2]


# Bits of a float64: those of its fraction, and the exponent's mask and bias above them.
_FRACTION_BITS, _EXPONENT_MASK, _EXPONENT_BIAS = 52, 0x7FF, 1023

# Exponents of the powers of two that are normal numbers.
_LEAST_NORMAL, _MOST_NORMAL = -1022, 1023


@compiled
def exponent_of(value):
    """Return e with 2^e <= abs(value) < 2^(e + 1); -1 for zero, and anything for infinity and NaN."""
    exponent = ((np.float64(value).view(np.int64) >> _FRACTION_BITS) & _EXPONENT_MASK) - _EXPONENT_BIAS
    # Zero and the numbers below the normal ones share an exponent.
    return exponent if exponent >= _LEAST_NORMAL else math.frexp(value)[1] - 1


@compiled
def power_of_two(exponent):
    """Return 2^exponent; assumes that it is a normal number."""
    return np.int64((exponent + _EXPONENT_BIAS) << _FRACTION_BITS).view(np.float64)


@compiled
def times_power_of_two(value, exponent):
    """Return value * 2^exponent for any exponent, rounded once if it is no normal number."""
    if _LEAST_NORMAL <= exponent <= _MOST_NORMAL:
        return value * power_of_two(exponent)
    return math.ldexp(value, exponent)


@intrinsic
def fused(typing_context, a, b, c):
    """Return a * b + c in float32, rounded once."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float32(types.float32, types.float32, types.float32), generate


_INT = ir.IntType(32)
_BYTES = ir.IntType(8).as_pointer()

# Arguments of LLVM's prefetch: reading, high locality, data.
_TO_READ_INTO_ALL_CACHES = (0, 3, 1)


@intrinsic
def prefetch(typing_context, array, index):
    """Ask for element `index` of a C-contiguous array before it is needed; any index is allowed."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array, index = arguments
        data = context.make_array(signature.args[0])(context, builder, array).data
        pointer = builder.bitcast(builder.gep(data, [index]), _BYTES)
        types_of_call = ir.FunctionType(ir.VoidType(), [_BYTES, _INT, _INT, _INT])
        ask = builder.module.declare_intrinsic("llvm.prefetch", [_BYTES], types_of_call)
        builder.call(ask, [pointer, *(ir.Constant(_INT, value) for value in _TO_READ_INTO_ALL_CACHES)])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate


@intrinsic
def add_atomically(typing_context, counter, amount):
    """Add to word 0 of an int64 array, undivided by any other thread or process; return what was there."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        word = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.atomic_rmw("add", word, arguments[1], "seq_cst")

    return types.int64(counter, types.int64), generate
