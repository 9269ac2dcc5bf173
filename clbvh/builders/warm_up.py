"""The smallest input that takes a builder through all its steps: it loads compiled code before time is taken."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh
from ..structs import BOX_LANES
from .prim_refs import Bounds
from .sah.exhaustive_split import MAX_EXHAUSTIVE

# The fewest from which the default builder makes more than one range.
_TRIANGLES = MAX_EXHAUSTIVE + 1


def make_small_mesh() -> Mesh:
    """Return a mesh of a few triangles."""
    corners = np.arange(9 * _TRIANGLES).reshape(-1, 3)
    faces = np.arange(3 * _TRIANGLES, dtype=np.int32).reshape(-1, 3)
    return Mesh.from_arrays(corners, faces)


def make_small_bounds() -> Bounds:
    """Return the bounds of the primitives of `make_small_arrays`."""
    return np.zeros((2, BOX_LANES), np.float32)


def make_small_arrays() -> dict[str, NDArray[Any]]:
    """Return the arrays that the steps of `sah` and `hlbvh` share, for as many primitives, without extent."""
    return {
        "prim_refs": np.zeros((2, _TRIANGLES, BOX_LANES), np.float32),
        "prim_ids": np.zeros(_TRIANGLES, np.int32),
    }
