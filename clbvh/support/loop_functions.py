"""Functions for compiled loops: vectors of three numbers, powers of two, and instructions that numba does not offer.

Vectors are tuples, because slices of arrays would take the compiler seconds. Powers of two are made from the bits of
float64: the library's `frexp` and `ldexp` take 5 ns a call.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
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


ARRAY = None  # among the operands of `instruction`


def instruction(result: Any, *operands: Any) -> Callable[[Callable[..., Any]], Any]:
    """Make a function for compiled loops of one that writes its LLVM: ``write(builder, *values)``.

    Parameters
    ----------
    result : numba type
        A tuple's values are written as a list.
    *operands : numba type, or ARRAY
        Of a C-contiguous array the value is the pointer to its first item.
    """

    def make(write: Callable[..., Any]) -> Any:
        def define(typing_context: Any, *given: Any) -> Any:
            kinds = [kind if operand is ARRAY else operand for operand, kind in zip(operands, given, strict=True)]
            return result(*kinds), lower

        def lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            values = [
                context.make_array(kind)(context, builder, value).data if operand is ARRAY else value
                for operand, kind, value in zip(operands, signature.args, arguments, strict=True)
            ]
            written = write(builder, *values)
            if isinstance(written, list):
                return context.make_tuple(builder, signature.return_type, written)
            return context.get_dummy_value() if written is None else written

        define.__name__, define.__doc__ = write.__name__, write.__doc__
        # The names by which compiled loops may call it; numba drops the first parameter.
        vars(define)["__signature__"] = inspect.signature(write)
        return intrinsic(define)

    return make


@instruction(types.float32, types.float32, types.float32, types.float32)
def fused(builder, a, b, c):
    """Return a * b + c in float32, rounded once."""
    return builder.fma(a, b, c)


_INT = ir.IntType(32)
_BYTES = ir.IntType(8).as_pointer()

# Arguments of LLVM's prefetch: reading, high locality, data.
_TO_READ_INTO_ALL_CACHES = (0, 3, 1)


@instruction(types.void, ARRAY, types.intp)
def prefetch(builder, array, index):
    """Ask for element `index` of a C-contiguous array before it is needed; any index is allowed."""
    pointer = builder.bitcast(builder.gep(array, [index]), _BYTES)
    types_of_call = ir.FunctionType(ir.VoidType(), [_BYTES, _INT, _INT, _INT])
    ask = builder.module.declare_intrinsic("llvm.prefetch", [_BYTES], types_of_call)
    builder.call(ask, [pointer, *(ir.Constant(_INT, value) for value in _TO_READ_INTO_ALL_CACHES)])


@instruction(types.int64, ARRAY, types.int64)
def add_atomically(builder, counter, amount):
    """Add to word 0 of an int64 array, undivided by any other thread or process; return what was there."""
    return builder.atomic_rmw("add", counter, amount, "seq_cst")
