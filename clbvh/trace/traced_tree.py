"""What queries need of a tree on a device, whether it is that of a mesh or of a scene.

Its members, its wide form as compiled functions take it, and the entry points of rays, see
cl/traversal/entry_point.cl. Knows nothing of numba, so that it costs nothing to import.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from ..device.context import Kernel
from ..device.session import DeviceSession, ReusableBuffer
from ..structs import TILE


class TracedTree(Protocol):
    """A `DeviceTree`, a `DeviceScene` or a `LoneSpheres`."""

    @property
    def layout(self) -> str:
        """Name of the layout."""

    @property
    def arguments(self) -> dict[str, Any]:
        """Arguments of every traversal kernel by name."""

    @property
    def defines(self) -> dict[str, int]:
        """Macros of every traversal kernel."""

    @property
    def has_entry_points(self) -> bool:
        """Whether rays may begin elsewhere than at the root, see cl/traversal/entry_point.cl."""

    @property
    def has_instances(self) -> bool:
        """Whether the kernels are those of scenes."""

    @property
    def ray_tree(self) -> Any:
        """The tree for rays alone, a `LoneSpheres`; None: this one."""

    @property
    def hit_dtype(self) -> np.dtype:
        """Of hits on the device: `structs.HIT`, or `structs.WORLD_HIT` with ids of instances."""

    @property
    def advances_rays(self) -> bool:
        """Whether the device advances rays to instances; False of a mesh."""

    @property
    def node_bytes(self) -> int:
        """Size of a node."""

    @property
    def memory_bytes(self) -> int:
        """Bytes of all buffers."""

    @property
    def mesh(self) -> Any:
        """The mesh; None of a scene."""

    @property
    def scene_surface(self) -> Any:
        """What hits keep of the scene; None of a mesh."""

    @property
    def surface(self) -> Any:
        """What hits are refined on, `SurfaceArrays`."""

    @property
    def most_crossings(self) -> int:
        """Most crossings that a ray can have."""

    def on_host(self) -> Any:
        """Return the tree as the host sees it, a `WideArrays`, for calls that are running; None where it does not."""


class WideArrays(NamedTuple):
    """A tree in the layout `bvh4` or `bvh8` as 4-byte lanes: floats, and the same as integers.

    Attributes
    ----------
    nodes : (N * 7 * width,) float32
    node_ints : (N * 7 * width,) int32
    blocks : (G * 10 * width,) float32
    block_ints : (G * 10 * width,) int32
    slots : tuple of int
        0 to width - 1: the type tells the compiler the width, so that loops over children become vector instructions.
    stack_size : int
    """

    nodes: NDArray[np.float32]
    node_ints: NDArray[np.int32]
    blocks: NDArray[np.float32]
    block_ints: NDArray[np.int32]
    slots: tuple[int, ...]
    stack_size: int

    @classmethod
    def of(cls, nodes: NDArray[Any], blocks: NDArray[Any], width: int, stack_size: int) -> Self:
        """Return views of `structs.WIDE_NODES[width]` and `structs.TRIANGLE_BLOCKS[width]`, or of their bytes."""
        node_lanes, block_lanes = (items.view(np.float32).reshape(-1) for items in (nodes, blocks))
        for lanes in (node_lanes, block_lanes):
            lanes.flags.writeable = False
        return cls(
            node_lanes, node_lanes.view(np.int32), block_lanes, block_lanes.view(np.int32), tuple(range(width)),
            stack_size,
        )  # fmt: skip


# The kernel that finds the entry points of rays in memory.
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
    written["tiles"] = None if tile_buffer is None else tile_buffer.take(tile_count * TILE.itemsize)
    session.run(
        kernel, (columns, rows), _WORK_GROUP,
        tile_width=np.int32(tile[0]), tile_height=np.int32(tile[1]), **tree.arguments, **written, **arguments,
    )  # fmt: skip
    return written
