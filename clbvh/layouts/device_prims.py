"""The primitives of a shape on a device: what builds read, and the blocks of a tree's leaves, written there.

The blocks have the bytes of `leaf_blocks.py`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..device.host.variants import block_macros
from ..device.session import DeviceSession, ReusableBuffer
from ..geometry import Mesh, Shape
from ..geometry.spheres import join_numbers
from ..kinds import TRIANGLES
from .device_mesh import DeviceMesh

_WORK_GROUP = (64,)


class DevicePrims:
    """The primitives of one shape on a device, and of others that follow it, of as many primitives.

    Parameters
    ----------
    owner : DeviceSession
        Owns the buffers.
    session : DeviceSession
        The owner, or a branch of it for this thread.
    shape : Mesh or Spheres

    Attributes
    ----------
    points : buffer of (m, 3) float32
    corners : buffer of (n, 3) int32
        See `geometry.corners.Corners`.
    shape : Mesh or Spheres
        The one that was put last.
    """

    def __init__(self, owner: DeviceSession, session: DeviceSession, shape: Shape) -> None:
        self._buffers = {name: ReusableBuffer(owner) for name in ("points", "corners", "numbers", "degenerate")}
        self.put(session, shape)

    @property
    def memory_bytes(self) -> int:
        """Bytes of its buffers."""
        return sum(buffer.size for buffer in self._buffers.values())

    def put(self, session: DeviceSession, shape: Shape) -> None:
        """Put a shape into the buffers; the corners of a mesh, its faces, are there already after the first."""
        points = None
        ids: Any = getattr(self, "corners", None) if isinstance(shape, Mesh) else None
        if isinstance(shape, DeviceMesh):
            # Its buffers on this device are used as they are.
            points = shape.buffer_on(session, "local_vertices")
            ids = ids or shape.buffer_on(session, "faces")
        if points is None or ids is None:
            corners = shape.find_corners()
            points = points or self._write(session, "points", corners.points)
            ids = ids or self._write(session, "corners", corners.ids)
        self.points, self.corners = points, ids
        degenerate, numbers = None, join_numbers(shape, "local_")
        if isinstance(shape, Mesh) and (shape.spans_scales or not session.info.has_fp64):
            degenerate = shape.degenerate_faces.view(np.uint8)
        self._sources = {
            name: None if array is None else self._write(session, name, array)
            for name, array in (("degenerate", degenerate), ("numbers", numbers))
        }
        self.shape = shape

    def write_blocks(
        self,
        session: DeviceSession,
        block_width: int,
        prims: Any,
        block_count: int,
        blocks: Any,
        *,
        first_block: int = 0,
        boxes: Any = None,
    ) -> None:
        """Write blocks, and the boxes around them.

        Parameters
        ----------
        session : DeviceSession
        block_width : int
            Primitives of a block, see `LeafBlocks`.
        prims : buffer of (block_count, block_width) int32
        block_count : int
        blocks : buffer of structs, written
        first_block : int
            Where in `blocks` those begin.
        boxes : buffer of (block_count, 8) float32, optional, written
            Rows of the lower corner, a number that means nothing, the upper corner, and another such number.
        """
        finds_degenerate = self.shape.kind is TRIANGLES and self._sources["degenerate"] is None
        session.run(
            session.kernel("write_blocks", block_macros(self.shape.kind, block_width, finds_degenerate)),
            (block_count,),
            _WORK_GROUP,
            points=self.points,
            corners=self.corners,
            **self._sources,
            prims=prims,
            blocks=blocks,
            boxes=boxes,
            block_count=np.int32(block_count),
            first_block=np.int32(first_block),
        )

    def make_blocks(self, session: DeviceSession, block_width: int, prims: Any, block_count: int) -> Any:
        """Return a new buffer of the blocks."""
        blocks = session.allocate(block_count * self.shape.kind.block(block_width).itemsize)
        self.write_blocks(session, block_width, prims, block_count, blocks)
        return blocks

    def _write(self, session: DeviceSession, name: str, array: NDArray[Any]) -> Any:
        buffer = self._buffers[name].take(max(1, array.nbytes))
        session.write(buffer, array)
        return buffer
