"""What Morton codes of three coordinates are made of, for compiled loops."""

from __future__ import annotations

import numpy as np

MAX_AXIS_BITS = 10

# The bits of a coordinate, each three places from the next.
SPREAD_BITS = np.array(
    [sum((number >> bit & 1) << 3 * bit for bit in range(MAX_AXIS_BITS)) for number in range(1 << MAX_AXIS_BITS)],
    np.int32,
)
