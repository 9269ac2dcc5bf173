"""The nodes at which the rays of a camera enter the tree, tile by tile; see cl/kernels/view_entry_points.cl."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..device.program import build_kernel
from ..device.session import DeviceSession
from ..trace.rays.entry_points import find_entry_points
from ..trace.traced_tree import TracedTree
from .frame import Band

_KERNEL = "view_entry_points"


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
        # The kernels of pictures begin at the root of a scene.
        has_any = tree.has_entry_points and not tree.has_instances
        self._kernel = build_kernel(session, _KERNEL, tree.defines) if has_any else None

    def find(self, band: Band) -> Any:
        """Return the entry points of a band's tiles, as kernels take them; None where rays begin at the root."""
        if self._kernel is None:
            return None
        starts = find_entry_points(
            band.session, self._tree, self._kernel, band.memory.buffer("entry points", for_mapping=False),
            (band.width, band.row_count), self._tile, margin=self._margin, **band.rows,
        )  # fmt: skip
        return starts["entry_points"]
