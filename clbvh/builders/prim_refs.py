"""Primitive references: the box and the id of each primitive, computed once before the build.

A primitive reference is a row of `structs.BOX`, 32 bytes, whose tag is the primitive's id. The builder moves whole
references, so that each range lies contiguous in memory. A primitive's centroid is taken as min + max, twice the centre
of its box: the factor does not matter for binning.

No lane holds a negative zero: -0.0 equals 0.0, so the minimum of the two would be whichever came first, and the bytes
of the tree would depend on how many workers shared the work.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..device.host.loops import Loops
from ..structs import BOX_LANES

if TYPE_CHECKING:
    from ..geometry.corners import Corners

# The bounds of a set of primitives: (2, 8) float32, the box of the primitives and that of their centroids.
Bounds = NDArray[np.float32]

SUBTREES = Loops("builders/subtrees")


def fill_slice(corners: Corners, begin: int, end: int, prim_refs: NDArray[np.float32]) -> Bounds:
    """Write the references of primitives `begin` to `end` into (n, 8) `prim_refs`; return their bounds."""
    bounds = np.empty((2, BOX_LANES), np.float32)
    SUBTREES.fill_prim_refs(*corners, begin, end, prim_refs, bounds)
    return bounds
