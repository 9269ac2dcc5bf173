"""Entry points: the nodes where the rays of each tile enter the tree, found on the device before the rays are cast.

See cl/traversal/entry_point.cl.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...device.kernel import Kernel
from ...device.reusable_buffer import ReusableBuffer
from ...device.session import DeviceSession
from ...structs import SCENE_TILE
from ..traced_tree import TracedTree

# Kernels that find the entry points of rays in memory: in a tree, and in a scene.
ENTRY_POINT_KERNEL = "tile_entry_points"
SCENE_ENTRY_POINT_KERNEL = f"scene_{ENTRY_POINT_KERNEL}"

# Tiles of a work-group.
_WORK_GROUP = (16, 1)


def find_entry_points(
    session: DeviceSession,
    tree: TracedTree,
    kernel: Kernel,
    buffer: ReusableBuffer,
    work_size: tuple[int, int],
    tile: tuple[int, int],
    *,
    tile_buffer: ReusableBuffer | None = None,
    **arguments: Any,
) -> dict[str, Any]:
    """Return the buffers that say where the rays of each tile begin, by the names of the kernels' arguments.

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
    tile_buffer : ReusableBuffer, optional
        Where the instances that each tile meets go; of a scene only.
    **arguments
        The kernel's arguments that describe the rays.
    """
    columns, rows = (-(-length // edge) for length, edge in zip(work_size, tile, strict=True))
    tile_count = columns * rows
    written = {"entry_points": buffer.take(tile_count * tree.node_bytes)}
    read = {"nodes": tree.arguments["nodes"]}
    if tile_buffer is not None:
        written["tiles"] = tile_buffer.take(tile_count * SCENE_TILE.itemsize)
        read |= {name: tree.arguments[name] for name in ("top_nodes", "instances")}
    session.run(
        kernel, (columns, rows), _WORK_GROUP,
        tile_width=np.int32(tile[0]), tile_height=np.int32(tile[1]), **read, **written, **arguments,
    )  # fmt: skip
    return written
