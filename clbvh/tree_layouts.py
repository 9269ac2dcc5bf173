"""The layouts of a tree in a device's memory, one record each, and the structs of their nodes and blocks.

All else derives from the list `LAYOUTS`: macros and typedefs of the kernels (`structs.py`), the host's variants of
kernels, the arrays of a tree, stacks, the choice among layouts, command line and tests. A new layout is a record here,
a branch in cl/traversal/traverse.cl and in cl/nearest/nearest.cl, and a way to make its arrays in `clbvh/layouts/`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Self

import numpy as np

# A node of the `bvh2` layout: 64 bytes, one cache line, with both child boxes in the parent, so that one load serves
# the tests of two children. Index 0 is the left child, 1 the right one. `count[i] > 0`: child i is a leaf over the
# triangles first[i] to first[i] + count[i]; `count[i] == 0`: child i is the node at first[i].
BVH2_NODE = np.dtype([("aabb_min", "f4", (2, 3)), ("aabb_max", "f4", (2, 3)), ("first", "i4", 2), ("count", "i4", 2)])

# A triangle of the `bvh2` layout, in leaf order; NaN if it is degenerate.
TRIANGLE = np.dtype([("a", "f4", 3), ("b", "f4", 3), ("c", "f4", 3), ("prim_id", "i4")])

# A sphere of the `bvh2` layout, in leaf order.
SPHERE = np.dtype([("centre", "f4", 3), ("radius", "f4"), ("prim_id", "i4")])

# Blocks of triangles in the `bvh8c` layout have any number of these units; see `layouts/shared_blocks.py`.
SHARED_UNIT = np.dtype([("words", "u4", 4)])


@cache
def wide_node(width: int) -> np.dtype:
    """Return a node of the wide layouts: each coordinate of all child boxes side by side, for a vector unit.

    `child[i] >= 0` is the index of a node; otherwise `~child[i]` is the index of a block. A missing child has an
    inverted box.
    """
    return np.dtype([("aabb_min", "f4", (3, width)), ("aabb_max", "f4", (3, width)), ("child", "i4", width)])


@cache
def triangle_block(width: int) -> np.dtype:
    """Return the struct of `width` triangles of a leaf, side by side; of one, `TRIANGLE`.

    `corners[i][axis]` is one coordinate of corner i of all triangles. Lanes without a triangle and lanes of degenerate
    triangles are NaN, which no ray hits.
    """
    return TRIANGLE if width == 1 else np.dtype([("corners", "f4", (3, 3, width)), ("prim_id", "i4", width)])


@cache
def sphere_block(width: int) -> np.dtype:
    """Return the struct of `width` spheres of a leaf, side by side; of one, `SPHERE`.

    `centre[axis]` is one coordinate of all spheres. Lanes without a sphere are NaN, which no ray hits.
    """
    if width == 1:
        return SPHERE
    return np.dtype([("centre", "f4", (3, width)), ("radius", "f4", width), ("prim_id", "i4", width)])


@dataclass(frozen=True)
class Layout:
    """A layout of a tree in a device's memory.

    Attributes
    ----------
    name : str
    number : int
        The macro LAYOUT of kernels.
    width : int
        Most children of a node; 0: there is no tree.
    node : dtype
    triangles, spheres : dtype
        The structs that the blocks of a mesh and of spheres consist of.
    common_stack : int
        Entries of a traversal's stack. Trees of up to a million triangles share one compiled kernel for each layout:
        a compilation takes a second or two on PoCL. The dragon's tree needs 29, 48 and 72 entries in `bvh2`, `bvh4`
        and `bvh8`. A longer stack costs no time: on PoCL 3.0 the bunny's kernels with 16 to 128 entries perform alike.
    least_bytes : int
        Bytes of a triangle in the largest buffer, at least.
    """

    name: str
    number: int
    width: int
    node: np.dtype
    triangles: np.dtype
    spheres: np.dtype
    common_stack: int
    least_bytes: int = TRIANGLE.itemsize

    @classmethod
    def wide(cls, name: str, number: int, width: int, *, triangles: np.dtype | None = None, **others: Any) -> Self:
        """Return a wide layout: with the usual blocks of triangles, unless others are given."""
        blocks = triangle_block(width) if triangles is None else triangles
        return cls(name, number, width, wide_node(width), blocks, sphere_block(width), **others)

    @property
    def is_wide(self) -> bool:
        """Whether a leaf is a block of primitives, and a tile's rays may begin at an entry point.

        Two children are too few for one, see cl/traversal/entry_point.cl.
        """
        return self.width > 2

    @property
    def block_width(self) -> int:
        """Primitives of a block."""
        return self.width if self.is_wide else 1

    @property
    def entry_stack(self) -> int:
        """Children that an entry point can push, at most, and a descent from the root would not."""
        return self.width - 1 if self.is_wide else 0

    @property
    def shares_vertices(self) -> bool:
        """Whether a block of triangles has each vertex once."""
        return self.triangles == SHARED_UNIT


LAYOUTS = {
    layout.name: layout
    for layout in (
        Layout("bvh2", 0, 2, BVH2_NODE, TRIANGLE, SPHERE, common_stack=32),
        # A list of primitives.
        Layout("brute", 1, 0, BVH2_NODE, TRIANGLE, SPHERE, common_stack=16),
        Layout.wide("bvh4", 2, 4, common_stack=64),
        Layout.wide("bvh8", 3, 8, common_stack=96),
        # Half the memory.
        Layout.wide("bvh8c", 4, 8, common_stack=96, triangles=SHARED_UNIT, least_bytes=15),
    )
}

# The names of those with a tree, and of the wide ones; and the widths of those, ascending.
TREE_LAYOUTS = tuple(layout.name for layout in LAYOUTS.values() if layout.width)
WIDE_LAYOUTS = tuple(layout.name for layout in LAYOUTS.values() if layout.is_wide)
WIDE_WIDTHS = tuple(sorted({LAYOUTS[name].width for name in WIDE_LAYOUTS}))

# The structs by their C names, in the order of their declarations.
LAYOUT_STRUCTS = {
    "bvh2_node_t": BVH2_NODE,
    "triangle_t": TRIANGLE,
    **{f"bvh{width}_node_t": wide_node(width) for width in WIDE_WIDTHS},
    **{f"block{width}_t": triangle_block(width) for width in WIDE_WIDTHS},
    "shared_unit_t": SHARED_UNIT,
    "sphere_t": SPHERE,
    **{f"sphere{width}_t": sphere_block(width) for width in WIDE_WIDTHS},
}
