"""The primitives of the leaves, with their corners or as spheres, as all layouts but `bvh8c` store them.

A primitive of `bvh2` is a block of one lane; the wide layouts have blocks of four or eight lanes.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..device.host.library import HostKernel, open_library
from ..geometry import Mesh, Shape
from ..geometry.spheres import find_numbers
from ..kinds import KINDS, TRIANGLES, Kind
from ..support.host_threads import HostThreads

# Least blocks of a thread's range: each takes 0.3 us.
_LEAST_BLOCKS = 1 << 10

# Work-items of a work-group of the kernel.
_GROUP_SIZE = 64


# What the kernel reads of a shape of any kind.
SOURCES = ("points", "corners", "degenerate", *(name for kind in KINDS.values() for name in kind.numbers))


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
        sources: dict[str, Any] = dict.fromkeys((*SOURCES, "boxes")) | find_numbers(shape, "local_")
        if isinstance(shape, Mesh):
            sources |= {"points": shape.local_vertices, "corners": shape.faces}
            if shape.spans_scales:
                sources["degenerate"] = shape.degenerate_faces
        kernel = _find_kernel(*make_block_defines(shape.kind, self.prims.shape[1], sources).items())
        group_count = -(-len(items) // _GROUP_SIZE)
        launch = kernel.bind(
            (group_count, 1, _GROUP_SIZE, 1),
            sources | {"prims": self.prims, "blocks": items, "block_count": len(items), "first_block": 0},
        )
        threads.for_ranges(
            group_count, lambda begin, end: kernel.entry(launch, begin, end), least_items=_LEAST_BLOCKS // _GROUP_SIZE
        )


def make_block_defines(kind: Kind, width: int, sources: Mapping[str, Any]) -> dict[str, int]:
    """Return the macros of the kernel: degenerate triangles that nobody tells are found in float64."""
    has_fp64 = kind is TRIANGLES and sources["degenerate"] is None
    return {"BLOCK_WIDTH": width, "KINDS": kind.bit, "HAS_FP64": int(has_fp64)}


@cache
def _find_kernel(*defines: tuple[str, int]) -> HostKernel:
    return open_library().kernels("write_blocks", dict(defines))["write_blocks"]
