"""The primitives of the leaves, with their corners or as spheres, as all layouts but `bvh8c` store them.

A primitive of `bvh2` is a block of one lane; the wide layouts have blocks of four or eight lanes.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh, Shape
from ..geometry.corners import Bounded
from ..structs import NO_PRIM, SPHERE, SPHERE_BLOCKS, TRIANGLE, TRIANGLE_BLOCKS
from ..support.compiled import compiled
from ..support.host_threads import HostThreads
from ..support.loop_functions import prefetch

# Least blocks of a thread's range: each takes 0.3 us.
_LEAST_BLOCKS = 1 << 10

# Prefetch distance in primitives, of vertices; of faces it is twice as far.
_PRIMS_AHEAD = 32


def block_struct(shape: Bounded, width: int) -> np.dtype:
    """Return the struct of a block of `width` primitives of a shape."""
    return TRIANGLE_BLOCKS.get(width, TRIANGLE) if isinstance(shape, Mesh) else SPHERE_BLOCKS.get(width, SPHERE)


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
        return block_struct(self.shape, self.prims.shape[1])

    @property
    def item_count(self) -> int:
        """Number of blocks."""
        return len(self.prims)

    def write(self, items: NDArray[np.void], threads: HostThreads) -> None:
        """Write the blocks into (G,) structs."""
        shape, lanes = self.shape, items.view(np.float32).reshape(len(items), -1)
        if isinstance(shape, Mesh):
            task: Any = partial(_write_triangles, shape.local_vertices, shape.decisive_vertices, shape.faces)
        else:
            task = partial(_write_spheres, shape.local_centres, shape.local_radii)
        threads.for_ranges(
            len(items),
            lambda begin, end: task(self.prims[begin:end], lanes[begin:end], lanes[begin:end].view(np.int32)),
            least_items=_LEAST_BLOCKS,
        )


@compiled(is_inlined=True)
def is_degenerate(vertices, faces, face):
    """Return whether the corners of a face lie on one line or in one point; see `Mesh.degenerate_faces`."""
    a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
    x, y, z = np.float64(vertices[a, 0]), np.float64(vertices[a, 1]), np.float64(vertices[a, 2])
    ux, uy, uz = vertices[b, 0] - x, vertices[b, 1] - y, vertices[b, 2] - z
    vx, vy, vz = vertices[c, 0] - x, vertices[c, 1] - y, vertices[c, 2] - z
    # Differences of float32 values and their products fit float64, so collinear means equal products; of float64 values
    # as far as they have no more digits.
    return uy * vz == uz * vy and uz * vx == ux * vz and ux * vy == uy * vx


@compiled
def _write_triangles(vertices, decisive, faces, prims, lanes, lane_ints):
    width = prims.shape[1]
    first_prim_id = 9 * width
    for block in range(len(prims)):
        ask_ahead(vertices, faces, prims, block)
        for slot in range(width):
            prim = prims[block, slot]
            lane_ints[block, first_prim_id + slot] = prim
            is_none = prim == NO_PRIM or is_degenerate(decisive, faces, prim)
            for corner in range(3):
                vertex = 0 if is_none else faces[prim, corner]
                for axis in range(3):
                    lanes[block, (3 * corner + axis) * width + slot] = np.nan if is_none else vertices[vertex, axis]


@compiled(is_inlined=True)
def ask_ahead(vertices, faces, prims, block):
    """Ask for the memory of later blocks: their triangles lie anywhere.

    Parameters
    ----------
    vertices : (V, 3) float32
    faces : (F, 3) int32
    prims : (G, width) int32
    block : int
        The one whose turn it is.
    """
    width = prims.shape[1]
    near, far = block + _PRIMS_AHEAD // width, block + 2 * _PRIMS_AHEAD // width
    if far < len(prims):
        for slot in range(width):
            prefetch(faces, 3 * prims[far, slot])
            prim = max(prims[near, slot], 0)
            for corner in range(3):
                prefetch(vertices, 3 * faces[prim, corner])


@compiled
def _write_spheres(centres, radii, prims, lanes, lane_ints):
    width = prims.shape[1]
    for block in range(len(prims)):
        for slot in range(width):
            prim = prims[block, slot]
            is_missing = prim == NO_PRIM
            for axis in range(3):
                lanes[block, axis * width + slot] = np.nan if is_missing else centres[prim, axis]
            lanes[block, 3 * width + slot] = np.nan if is_missing else radii[prim]
            lane_ints[block, 4 * width + slot] = prim
