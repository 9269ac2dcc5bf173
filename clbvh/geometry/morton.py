"""The table from which compiled loops make Morton codes of three coordinates."""

from __future__ import annotations

import numpy as np

MAX_AXIS_BITS = 10

# For each coordinate, its bits at every third position.
SPREAD_BITS = np.array(
    [sum((number >> bit & 1) << 3 * bit for bit in range(MAX_AXIS_BITS)) for number in range(1 << MAX_AXIS_BITS)],
    np.int32,
)
