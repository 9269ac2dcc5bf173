"""Entry points: the nodes where the rays of each tile enter the tree, found on the device before the rays are cast.

See cl/traversal/entry_point.cl.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...device.kernel import Kernel
from ...device.reusable_buffer import ReusableBuffer
from ...device.session import DeviceSession
from ..traced_tree import TracedTree

# Kernel that finds the entry points of rays in memory.
ENTRY_POINT_KERNEL = "tile_entry_points"

# Tiles of a work-group.
_WORK_GROUP = (16, 1)


def find_entry_points(
    session: DeviceSession,
    tree: TracedTree,
    kernel: Kernel,
    buffer: ReusableBuffer,
    work_size: tuple[int, int],
    tile: tuple[int, int],
    **arguments: Any,
) -> Any:
    """Return the buffer of the tiles' entry points, as kernels take it.

    Parameters
    ----------
    session : DeviceSession
    tree : TracedTree
        In the same session; it has entry points.
    kernel : Kernel
    buffer : ReusableBuffer
        Where the entry points go; valid until its next use.
    work_size : (int, int)
        Columns and rows of the work-items that cast the rays.
    tile : (int, int)
        Columns and rows of their work-groups.
    **arguments
        The kernel's arguments that describe the rays.
    """
    columns, rows = (-(-length // edge) for length, edge in zip(work_size, tile, strict=True))
    entry_points = buffer.take(columns * rows * tree.node_bytes)
    session.run(
        kernel, (columns, rows), _WORK_GROUP,
        nodes=tree.arguments["nodes"], entry_points=entry_points,
        tile_width=np.int32(tile[0]), tile_height=np.int32(tile[1]), **arguments,
    )  # fmt: skip
    return entry_points
