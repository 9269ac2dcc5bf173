"""The kinds of primitives, one record each, and the structs of their blocks on a device.

All else derives from the list `KINDS`: constants, macros and typedefs of the kernels (`structs.py`), the host's
variants of kernels, the buffers of blocks. A new kind is a record here, a shape in `clbvh/geometry/`, a folder of its
functions in `cl/`, and a branch in each function of `cl/prims/`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

# A triangle of the `bvh2` layout, in leaf order; NaN if it is degenerate.
TRIANGLE = np.dtype([("a", "f4", 3), ("b", "f4", 3), ("c", "f4", 3), ("prim_id", "i4")])

# A sphere of the `bvh2` layout, in leaf order.
SPHERE = np.dtype([("centre", "f4", 3), ("radius", "f4"), ("prim_id", "i4")])


@cache
def triangle_block(width: int) -> np.dtype:
    """Return the struct of `width` triangles of a leaf, side by side; of one, `TRIANGLE`.

    `corners[i][axis]` is one coordinate of corner i of all triangles. Lanes without a triangle and lanes of degenerate
    triangles are NaN, which no ray hits.
    """
    return TRIANGLE if width == 1 else np.dtype([("corners", "f4", (3, 3, width)), ("prim_id", "i4", width)])


@cache
def sphere_block(width: int) -> np.dtype:
    """Return the struct of `width` spheres of a leaf, side by side; of one, `SPHERE`.

    `centre[axis]` is one coordinate of all spheres. Lanes without a sphere are NaN, which no ray hits.
    """
    if width == 1:
        return SPHERE
    return np.dtype([("centre", "f4", (3, width)), ("radius", "f4", width), ("prim_id", "i4", width)])


@dataclass(frozen=True)
class Kind:
    """A kind of primitives; all of one shape have the same.

    Attributes
    ----------
    name : str
    prim : str
        One of them.
    number : int
        Its constant in kernels, such as KIND_SPHERES, and its bit of their macro KINDS.
    buffer : str
        The argument of kernels that has the blocks, see cl/world/world.cl.
    block : function
        Returns the struct of a block of one, four or eight primitives.
    most_hits : int
        Of a ray with a primitive.
    arrays : tuple of str
        The arrays of a shape that have its primitives, if these have no corners: attributes of the shape, and with the
        prefix ``local_`` the same in local coordinates. Their rows, side by side, are the numbers of a primitive, in
        the order of a block.
    """

    name: str
    prim: str
    number: int
    buffer: str
    block: Callable[[int], np.dtype]
    most_hits: int
    arrays: tuple[str, ...] = ()

    @property
    def bit(self) -> int:
        """The macro KINDS of kernels that meet this kind alone."""
        return 1 << self.number


TRIANGLES = Kind("triangles", "triangle", 0, "blocks", triangle_block, most_hits=1)
SPHERES = Kind("spheres", "sphere", 1, "spheres", sphere_block, most_hits=2, arrays=("centres", "radii"))

KINDS = {kind.name: kind for kind in (TRIANGLES, SPHERES)}
ALL_KINDS = sum(kind.bit for kind in KINDS.values())
