"""Where the rays of a camera enter the tree or the scene, tile by tile; see cl/kernels/view_entry_points.cl."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..device.program import build_kernel
from ..device.session import DeviceSession
from ..trace.rays.entry_points import find_entry_points
from ..trace.traced_tree import TracedTree
from .frame import Band

_KERNEL = "view_entry_points"

# The arguments of rays that begin at the root.
AT_THE_ROOT: dict[str, Any] = {"tiles": None, "entry_points": None}


class ViewEntryPoints:
    """Finds the entry points of a camera's rays.

    Parameters
    ----------
    session : DeviceSession
    tree : DeviceTree or DeviceScene
    tile : (int, int)
        Columns and rows of the work-groups that cast the rays.
    margin : float
        Pixels around the centre of each pixel in which its rays are.
    """

    def __init__(self, session: DeviceSession, tree: TracedTree, tile: tuple[int, int], margin: float) -> None:
        self._tree, self._tile, self._margin = tree, tile, np.float32(margin)
        self._kernel = build_kernel(session, _KERNEL, tree.defines) if tree.has_entry_points else None

    def find(self, band: Band) -> dict[str, Any]:
        """Return the arguments of kernels that say where the rays of a band begin, by their names."""
        if self._kernel is None:
            return AT_THE_ROOT
        has_instances = self._tree.has_instances
        others = {} if has_instances else {"top_nodes": None, "instances": None, "tiles": None}
        starts = find_entry_points(
            band.session, self._tree, self._kernel, band.memory.buffer("entry points", for_mapping=False),
            (band.width, band.row_count), self._tile, margin=self._margin,
            tile_buffer=band.memory.buffer("tiles", for_mapping=False) if has_instances else None,
            **others, **band.rows,
        )  # fmt: skip
        return AT_THE_ROOT | starts
