"""Powers of two in compiled loops, by the bits of float64: the library's `frexp` and `ldexp` take 5 ns a call."""

from __future__ import annotations

import math

import numpy as np

from .compiled import compiled

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
