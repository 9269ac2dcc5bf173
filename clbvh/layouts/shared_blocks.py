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

from ..errors import MeshError
from ..geometry import Mesh
from ..structs import MOST_SHARED_VERTICES, NO_PRIM, SHARED_HEADER, SHARED_UNIT, SHARED_VERTEX_BITS
from ..support.compiled import compiled
from ..support.host_threads import HostThreads
from .leaf_blocks import ask_ahead, is_degenerate

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

# Vertex number and coordinate of all corners of a degenerate triangle.
_NO_VERTEX = -1
_NAN_BITS = int(np.float32(np.nan).view(np.int32))


class SharedBlocks(NamedTuple):
    """Blocks of leaves.

    Attributes
    ----------
    parts : list of (n,) `structs.SHARED_UNIT`
        The blocks of ranges of leaves, one behind the other.
    """

    parts: list[NDArray[np.void]]

    @classmethod
    def make(cls, mesh: Mesh, prims: NDArray[np.int32], children: NDArray[np.int32], threads: HostThreads) -> Self:
        """Return the blocks of leaves, and let the children of nodes name them.

        Parameters
        ----------
        mesh : Mesh
        prims : (G, 8) int32
            Faces of each leaf, see `WideTree.blocks`.
        children : (N, 8) int32, changed
            Nodes, or ``~g`` of the leaf g, which becomes ``~unit``.
        threads : HostThreads

        Raises
        ------
        MeshError
            The blocks have more units than a triangle's number counts: about 300 million triangles.
        """
        begins = np.empty(len(prims), np.int64)

        def make_part(begin: int, end: int) -> NDArray[np.void]:
            words = np.empty((end - begin) * _MOST_WORDS, np.int32)  # memory that is never written is never taken
            unit_count = _write_leaves(
                mesh.local_vertices, mesh.decisive_vertices, mesh.faces, prims[begin:end], begins[begin:end], words
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
        threads.for_ranges(len(children), lambda begin, end: _name_leaves(begins, children[begin:end]))
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


@compiled
def _write_leaves(vertices, decisive, faces, prims, begins, words):
    """Write the blocks of leaves, and return the number of their units.

    Parameters
    ----------
    vertices : (V, 3) float32
    decisive : (V, 3) float
        See `Mesh.decisive_vertices`.
    faces : (F, 3) int32
    prims : (G, 8) int32
    begins : (G,) int64, written
        The first unit of each leaf.
    words : (n,) int32, written
    """
    bits = vertices.view(np.int32)
    # The block's vertices, with their numbers in the mesh, and those of its triangles' corners.
    known, shared = np.empty(MOST_SHARED_VERTICES, np.int32), np.empty((MOST_SHARED_VERTICES, 3), np.int32)
    corners = np.empty((_WIDTH, 3), np.int32)
    unit = 0
    for leaf in range(len(prims)):
        begins[leaf] = unit
        ask_ahead(vertices, faces, prims, leaf)
        end = 0
        while end < _WIDTH and prims[leaf, end] != NO_PRIM:
            begin = end
            end, vertex_count = _share(decisive, bits, faces, prims[leaf], begin, known, shared, corners)
            size = (SHARED_HEADER + 3 * vertex_count + end - begin + _UNIT_WORDS - 1) // _UNIT_WORDS
            is_last = end == _WIDTH or prims[leaf, end] == NO_PRIM
            own = words[_UNIT_WORDS * unit : _UNIT_WORDS * (unit + size)]
            own[SHARED_HEADER - 1] = vertex_count | (end - begin) << 8 | (0 if is_last else size) << 16
            _write_block(prims[leaf, begin:end], shared[:vertex_count], corners, own)
            unit += size
    return unit


@compiled(is_inlined=True)
def _share(decisive, bits, faces, prims, begin, known, shared, corners):
    """Find the vertices of a block's triangles; return the end of these, and the number of vertices.

    Parameters
    ----------
    decisive : (V, 3) float
    bits : (V, 3) int32
        Those of the local vertices.
    faces : (F, 3) int32
    prims : (8,) int32
        Of the leaf; the block's triangles begin at `begin`.
    begin : int
    known : (16,) int32, written
        The mesh's number of each vertex.
    shared : (16, 3) int32, written
        The coordinates of each vertex.
    corners : (8, 3) int32, written
        The vertices of each triangle.
    """
    end, vertex_count = begin, 0
    while end < _WIDTH and prims[end] != NO_PRIM:
        prim, count = prims[end], vertex_count
        is_none = is_degenerate(decisive, faces, prim)
        for corner in range(3):
            vertex = _NO_VERTEX if is_none else faces[prim, corner]
            index = 0
            while index < count and known[index] != vertex:
                index += 1
            if index == count:
                x = _NAN_BITS if is_none else bits[vertex, 0]
                y = _NAN_BITS if is_none else bits[vertex, 1]
                z = _NAN_BITS if is_none else bits[vertex, 2]
                index = 0
                while index < count and not (shared[index, 0] == x and shared[index, 1] == y and shared[index, 2] == z):
                    index += 1
                if index == MOST_SHARED_VERTICES:
                    return end, vertex_count
                if index == count:
                    known[index] = vertex
                    shared[index, 0], shared[index, 1], shared[index, 2] = x, y, z
                    count += 1
            corners[end - begin, corner] = index
        vertex_count = count
        end += 1
    return end, vertex_count


@compiled(is_inlined=True)
def _write_block(prims, shared, corners, words):
    """Write all of a block but its sizes."""
    for corner in range(3):
        row = np.uint32(0)
        for slot in range(len(prims)):
            row |= np.uint32(corners[slot, corner]) << np.uint32(SHARED_VERTEX_BITS * slot)
        words[corner] = np.int32(row)
    at = SHARED_HEADER
    for axis in range(3):
        for vertex in range(len(shared)):
            words[at] = shared[vertex, axis]
            at += 1
    for slot in range(len(prims)):
        words[at] = prims[slot]
        at += 1
    words[at:] = 0


@compiled
def _name_leaves(begins, children):
    for node in range(len(children)):
        for slot in range(children.shape[1]):
            child = children[node, slot]
            if child < 0:
                children[node, slot] = ~np.int32(begins[~child])
