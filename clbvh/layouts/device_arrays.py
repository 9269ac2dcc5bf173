"""What a device gets of a tree in each layout."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..layout import BVH2_NODE, GROUPS, LAYOUT_WIDTHS, TRIANGLE
from .bvh import Bvh
from .layouts import gather_triangles, make_bvh2_nodes
from .wide import gather_groups, widen


@dataclass(frozen=True, eq=False)
class DeviceArrays:
    """The arrays of one tree in one layout.

    Attributes
    ----------
    nodes, groups : arrays of structs
        See `clbvh.layout`. A group of `bvh2` is one triangle.
    waiting : int
        How many children can wait at once while a ray goes through the tree, at most.
    """

    nodes: NDArray[np.void]
    groups: NDArray[np.void]
    waiting: int


def make_device_arrays(bvh: Bvh, layout: str) -> DeviceArrays:
    """Return a tree in the layout of that name, one of `layout.LAYOUT_WIDTHS`."""
    width = LAYOUT_WIDTHS[layout]
    if width == 2:
        return DeviceArrays(make_bvh2_nodes(bvh), gather_triangles(bvh.mesh, bvh.prim_ids), bvh.depth)
    tree = widen(bvh, width)
    # The children of a tile's entry, see cl/entry.cl, stand for those on the way to them, which may be fewer.
    waiting = width - 1 + tree.waiting
    return DeviceArrays(tree.nodes, gather_groups(bvh.mesh, tree.groups), waiting)


def measure_device_bytes(bvh: Bvh, layout: str) -> int:
    """Return the size of the arrays, without making the groups."""
    width = LAYOUT_WIDTHS[layout]
    if width == 2:
        # A tree that is one leaf still has one node on the device.
        return max(1, bvh.node_count // 2) * BVH2_NODE.itemsize + len(bvh.prim_ids) * TRIANGLE.itemsize
    tree = widen(bvh, width)
    return int(tree.nodes.nbytes) + len(tree.groups) * GROUPS[width].itemsize
