"""The layouts of a tree in a device's memory, one record each, and the structs of their nodes.

All else derives from the list `LAYOUTS`: macros and typedefs of the kernels (`structs.py`), the host's variants of
kernels, the arrays of a tree, stacks, the choice among layouts, command line and tests. A new layout is a record here,
a branch in cl/traversal/traverse.cl and in cl/nearest/nearest.cl, and a way to make its arrays in `clbvh/layouts/`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from .kinds import KINDS, TRIANGLE, TRIANGLES, Kind

# A node of the `bvh2` layout: 64 bytes, one cache line, with both child boxes in the parent, so that one load serves
# the tests of two children. Index 0 is the left child, 1 the right one. `count[i] > 0`: child i is a leaf over the
# triangles first[i] to first[i] + count[i]; `count[i] == 0`: child i is the node at first[i].
BVH2_NODE = np.dtype([("aabb_min", "f4", (2, 3)), ("aabb_max", "f4", (2, 3)), ("first", "i4", 2), ("count", "i4", 2)])

# Blocks of triangles in the `bvh8c` layout have any number of these units; see `layouts/shared_blocks.py`.
SHARED_UNIT = np.dtype([("words", "u4", 4)])


@cache
def wide_node(width: int) -> np.dtype:
    """Return a node of the wide layouts: each coordinate of all child boxes side by side, for a vector unit.

    `child[i] >= 0` is the index of a node; otherwise `~child[i]` is the index of a block. A missing child has an
    inverted box.
    """
    return np.dtype([("aabb_min", "f4", (3, width)), ("aabb_max", "f4", (3, width)), ("child", "i4", width)])


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
    common_stack : int
        Entries of a traversal's stack. Trees of up to a million triangles share one compiled kernel for each layout:
        a compilation takes a second or two on PoCL. The dragon's tree needs 29, 48 and 72 entries in `bvh2`, `bvh4`
        and `bvh8`. A longer stack costs no time: on PoCL 3.0 the bunny's kernels with 16 to 128 entries perform alike.
    shares_vertices : bool
        Whether a block of triangles has each vertex once.
    least_bytes : int
        Bytes of a triangle in the largest buffer, at least.
    """

    name: str
    number: int
    width: int
    node: np.dtype
    common_stack: int
    shares_vertices: bool = False
    least_bytes: int = TRIANGLE.itemsize

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

    def block(self, kind: Kind) -> np.dtype:
        """Return the struct that the blocks of primitives consist of."""
        return SHARED_UNIT if self.shares_vertices and kind is TRIANGLES else kind.block(self.block_width)


LAYOUTS = {
    layout.name: layout
    for layout in (
        Layout("bvh2", 0, 2, BVH2_NODE, common_stack=32),
        # A list of primitives.
        Layout("brute", 1, 0, BVH2_NODE, common_stack=16),
        Layout("bvh4", 2, 4, wide_node(4), common_stack=64),
        Layout("bvh8", 3, 8, wide_node(8), common_stack=96),
        # Half the memory.
        Layout("bvh8c", 4, 8, wide_node(8), common_stack=96, shares_vertices=True, least_bytes=15),
    )
}

# The names of those with a tree, and of the wide ones; and the widths of those, ascending.
TREE_LAYOUTS = tuple(layout.name for layout in LAYOUTS.values() if layout.width)
WIDE_LAYOUTS = tuple(layout.name for layout in LAYOUTS.values() if layout.is_wide)
WIDE_WIDTHS = tuple(sorted({LAYOUTS[name].width for name in WIDE_LAYOUTS}))

# The structs by their C names, in the order of their declarations.
LAYOUT_STRUCTS = {
    "bvh2_node_t": BVH2_NODE,
    **{f"bvh{width}_node_t": wide_node(width) for width in WIDE_WIDTHS},
    "shared_unit_t": SHARED_UNIT,
    **{f"{kind.prim}_t": kind.block(1) for kind in KINDS.values()},
    **{f"{kind.prim}{width}_t": kind.block(width) for kind in KINDS.values() for width in WIDE_WIDTHS},
}
