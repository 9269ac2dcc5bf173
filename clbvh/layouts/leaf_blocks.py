"""The primitives of the leaves, with their corners or as spheres, as all layouts but `bvh8c` store them.

A primitive of `bvh2` is a block of one lane; the wide layouts have blocks of four or eight lanes.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..device.host.library import HostKernel, open_library
from ..device.host.variants import block_macros
from ..geometry import Mesh, Shape
from ..geometry.spheres import join_numbers
from ..kinds import TRIANGLES, Kind
from ..support.host_threads import HostThreads

# Least blocks of a thread's range: each takes 0.3 us.
_LEAST_BLOCKS = 1 << 10

# Work-items of a work-group of the kernel.
_GROUP_SIZE = 64


class LeafBlocks(NamedTuple):
    """Blocks that are written when it is known where they go.

    Lanes without a primitive are NaN, and so are degenerate triangles.

    Attributes
    ----------
    shape : Mesh or Spheres
    prims : (G, width) int32
        Faces of the mesh, or spheres: of a `WideTree`, or one in each block, as `bvh2` has them.
    """

    shape: Shape
    prims: NDArray[np.int32]

    @property
    def struct(self) -> np.dtype:
        """Of a block."""
        return self.shape.kind.block(self.prims.shape[1])

    @property
    def item_count(self) -> int:
        """Number of blocks."""
        return len(self.prims)

    def write(self, items: NDArray[np.void], threads: HostThreads) -> None:
        """Write the blocks into (G,) structs, by the kernel that writes those of a device."""
        shape = self.shape
        sources: dict[str, Any] = dict.fromkeys(("points", "corners", "degenerate", "boxes"))
        if isinstance(shape, Mesh):
            sources |= {"points": shape.local_vertices, "corners": shape.faces}
            if shape.spans_scales:
                sources["degenerate"] = shape.degenerate_faces
        sources["numbers"] = join_numbers(shape, "local_")
        finds_degenerate = shape.kind is TRIANGLES and sources["degenerate"] is None
        kernel = _find_kernel(shape.kind, self.prims.shape[1], finds_degenerate)
        group_count = -(-len(items) // _GROUP_SIZE)
        launch = kernel.bind(
            (group_count, 1, _GROUP_SIZE, 1),
            sources | {"prims": self.prims, "blocks": items, "block_count": len(items), "first_block": 0},
        )
        threads.for_ranges(
            group_count, lambda begin, end: kernel.entry(launch, begin, end), least_items=_LEAST_BLOCKS // _GROUP_SIZE
        )


@cache
def _find_kernel(kind: Kind, width: int, finds_degenerate: bool) -> HostKernel:
    return open_library().kernels("write_blocks", block_macros(kind, width, finds_degenerate))["write_blocks"]
