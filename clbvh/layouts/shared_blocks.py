"""The triangles of the leaves in the layout `bvh8c`: a block has each vertex of its triangles once.

A block, in words of 4 bytes, padded to units of 16 bytes:

    3           the vertices of corners a, b and c of all triangles: 4 bits for each triangle, from the lowest on
    1           numbers of vertices V and of triangles T, 8 bits each; then the units to the leaf's next block, or 0
    V, V, V     the coordinates of the vertices along x, y and z, float32
    T           the faces

Six neighbouring triangles have seven vertices, not 18: a triangle takes half the memory that it does in `bvh8`, with
the same coordinates. Processors that permute vector lanes make the rows of corners from those of vertices as fast as
they would load them. A vertex is known by its coordinates, so a mesh may repeat it for each triangle. A leaf with more
vertices than four bits count gets another block behind the first. Compare Benthin et al., "Compressed-leaf bounding
volume hierarchies", 2018.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ..device.host.loops import Loops
from ..errors import MeshError
from ..geometry import Mesh
from ..structs import MOST_SHARED_VERTICES, SHARED_HEADER
from ..support.host_threads import HostThreads
from ..tree_layouts import SHARED_UNIT

_WIDTH = 8
_UNIT_WORDS = SHARED_UNIT.itemsize // 4

# Rows of 16 coordinates are loaded, whatever their length: zeros behind the last block.
_PADDING_UNITS = MOST_SHARED_VERTICES // _UNIT_WORDS

# Of a leaf without common vertices: a block of five triangles and one of three.
_MOST_WORDS = 2 * SHARED_HEADER + 3 * 3 * _WIDTH + _WIDTH + 2 * (_UNIT_WORDS - 1)

# A triangle has the number 8 * unit + lane, of 32 bits.
_MOST_UNITS = 1 << 29

# Least leaves of a thread's range: each takes 0.2 us.
_LEAST_LEAVES = 1 << 11

_LOOPS = Loops("layouts/shared")


class SharedBlocks(NamedTuple):
    """Blocks of leaves.

    Attributes
    ----------
    parts : list of (n,) `SHARED_UNIT`
        The blocks of ranges of leaves, one behind the other.
    """

    parts: list[NDArray[np.void]]

    @classmethod
    def make(cls, mesh: Mesh, prims: NDArray[np.int32], nodes: NDArray[np.void], threads: HostThreads) -> Self:
        """Return the blocks of leaves, and let the children of nodes name them.

        Parameters
        ----------
        mesh : Mesh
        prims : (G, 8) int32
            Faces of each leaf, see `WideTree.blocks`.
        nodes : (N,) `wide_node(8)`, changed
            The child ``~g``, the leaf g, becomes ``~unit``.
        threads : HostThreads

        Raises
        ------
        MeshError
            The blocks have more units than a triangle's number counts: about 300 million triangles.
        """
        begins = np.empty(len(prims), np.int64)
        degenerate = mesh.degenerate_faces if mesh.spans_scales else None

        def make_part(begin: int, end: int) -> NDArray[np.void]:
            words = np.empty((end - begin) * _MOST_WORDS, np.int32)  # memory that is never written is never taken
            unit_count = _LOOPS.write_leaves(
                mesh.local_vertices, mesh.faces, degenerate, prims[begin:end], begins[begin:end], words
            )
            return words[: _UNIT_WORDS * unit_count].view(SHARED_UNIT)

        ranges = threads.ranges(len(prims), _LEAST_LEAVES)
        parts = threads.run(make_part, ranges)
        unit_count = 0
        for (begin, end), part in zip(ranges, parts, strict=True):
            begins[begin:end] += unit_count
            unit_count += len(part)
        if unit_count > _MOST_UNITS:
            raise MeshError(f"{mesh.name}: {mesh.face_count:,} triangles are too many for the layout bvh8c")
        threads.for_ranges(len(nodes), lambda begin, end: _LOOPS.name_leaves(begins, nodes[begin:end]))
        return cls([*parts, np.zeros(_PADDING_UNITS, SHARED_UNIT)])

    @property
    def struct(self) -> np.dtype:
        """Of a unit."""
        return SHARED_UNIT

    @property
    def item_count(self) -> int:
        """Number of units."""
        return sum(map(len, self.parts))

    def write(self, items: NDArray[np.void], threads: HostThreads) -> None:
        """Write the blocks into units."""
        ends = np.cumsum([len(part) for part in self.parts])
        threads.run(np.copyto, list(zip(np.split(items, ends[:-1]), self.parts, strict=True)))
