"""The topology of a tree's device arrays: all that stays the same while vertices or spheres move.

Owns which children each node has, and which primitives each leaf. `refit_arrays.py` puts corners and boxes around it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..structs import LAYOUT_WIDTHS

# A child that a node does not have.
NO_CHILD = np.iinfo(np.int32).min

# Lanes of one child's box in a node. Links come behind them; the primitives of a block are its last lanes.
BOX_LANES_OF_CHILD = 6


class Topology(NamedTuple):
    """The links of a tree on a device, and the primitives of its leaves.

    Attributes
    ----------
    children : (N, width) int32
        Index of a node behind this one, ``~leaf``, or `NO_CHILD`.
    links : (N, k) int32
        The lanes of each node behind its boxes, as the device has them.
    leaves : (L, 2) int32
        Begin and end of each leaf's blocks. A leaf of the wide layouts is one block.
    prims : (B, block width) int32
        Faces of the mesh, or spheres, in each block, `NO_PRIM` in the lanes that are left over.
    """

    children: NDArray[np.int32]
    links: NDArray[np.int32]
    leaves: NDArray[np.int32]
    prims: NDArray[np.int32]


def read_topology(nodes: NDArray[np.void], blocks: NDArray[np.void], layout: str) -> Topology:
    """Return the topology of device arrays; it shares no memory with them.

    Parameters
    ----------
    nodes, blocks : arrays of structs
        See `DeviceArrays`; not changed.
    layout : str
        One of `structs.LAYOUT_WIDTHS`.
    """
    width = LAYOUT_WIDTHS[layout]
    block_width = 1 if width == 2 else width
    links = _lanes(nodes)[:, BOX_LANES_OF_CHILD * width :].copy()
    prims = _lanes(blocks)[:, -block_width:].copy()
    least, most = nodes["aabb_min"], nodes["aabb_max"]
    if block_width == 1:
        first, count = np.hsplit(links, 2)
        is_missing = least[:, :, 0] > most[:, :, 0]
        is_leaf = (count > 0) & ~is_missing
        children, begins, counts = first.copy(), first[is_leaf], count[is_leaf]
        children[is_leaf] = ~np.arange(len(begins), dtype=np.int32)
    else:
        is_missing = least[:, 0] > most[:, 0]
        children, begins, counts = links.copy(), np.arange(len(prims), dtype=np.int32), np.ones(len(prims), np.int32)
    # A missing child has an inverted box.
    children[is_missing] = NO_CHILD
    leaves = np.stack((begins, begins + counts), axis=1)
    return Topology(children, links, leaves, prims)


def _lanes(structs: NDArray[np.void]) -> NDArray[np.int32]:
    """Return structs as rows of 4-byte lanes."""
    return structs.view(np.int32).reshape(len(structs), -1)
