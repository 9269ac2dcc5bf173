"""The arguments of kernels that cast at a tree or at a scene alike; see cl/world/world.cl."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..trace.traced_tree import TracedTree

# Those that a mesh without a scene, or a scene, has none of.
_NONE: dict[str, Any] = {"top_nodes": None, "instances": None, "spheres": None, "block_count": np.int32(0)}


def world_arguments(tree: TracedTree) -> dict[str, Any]:
    """Return the arguments by their names."""
    return _NONE | tree.arguments
