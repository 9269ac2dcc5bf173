"""Where the rays of each tile begin: entry points, which a kernel finds before the rays are cast.

See cl/world/starts.cl. Knows nothing of how rays are made: a kernel for rays in memory has `TILE_KERNEL`, and pictures
have their own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...device.kernel import Kernel
from ...device.session import DeviceSession
from ...structs import TILE
from .world import World

# Kernels that find entry points: of rays in memory, and of the rays of a camera.
TILE_KERNEL, VIEW_KERNEL = "tile_entry_points", "view_entry_points"

# The arguments of rays that begin at the root.
AT_THE_ROOT: dict[str, Any] = {"tiles": None, "entry_points": None}

# Tiles of a work-group.
_WORK_GROUP = (16, 1)


def find_entry_points(
    session: DeviceSession,
    world: World,
    kernel: Kernel,
    take: Callable[[str, int], Any],
    work_size: tuple[int, int],
    tile: tuple[int, int],
    **arguments: Any,
) -> dict[str, Any]:
    """Return the buffers that say where the rays of each tile begin, by the names of the kernels' arguments.

    Parameters
    ----------
    session : DeviceSession
    world : World
        In the same session; it has entry points.
    kernel : Kernel
    take : function
        Called with a name and a number of bytes, it returns a buffer, which is valid until its next use.
    work_size : (int, int)
        Columns and rows of the work-items that cast the rays.
    tile : (int, int)
        Columns and rows of their work-groups.
    **arguments
        The kernel's arguments that describe the rays.
    """
    columns, rows = (-(-length // edge) for length, edge in zip(work_size, tile, strict=True))
    tile_count = columns * rows
    written = {
        "entry_points": take("entry points", tile_count * world.node_bytes),
        "tiles": None if world.is_lone else take("tiles", tile_count * TILE.itemsize),
    }
    session.run(
        kernel, (columns, rows), _WORK_GROUP, tile_width=np.int32(tile[0]), tile_height=np.int32(tile[1]),
        **world.arguments, **written, **arguments,
    )  # fmt: skip
    return written
