"""The check of a number that users give."""

from __future__ import annotations

import math
from numbers import Real
from typing import TypeGuard


def is_finite_number(value: object) -> TypeGuard[float]:
    """Return whether a value is a real number that float64 can hold."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # a longer integer
        return False
