"""A mesh and its tree in a device's memory, ready for a traversal kernel."""

from __future__ import annotations

import math
from copy import copy
from typing import Any, Self

import numpy as np

from ..bvh import Bvh
from ..device.session import DeviceSession
from ..errors import ConfigError
from ..geometry import Mesh
from ..layouts.device_arrays import DeviceArrays, make_device_arrays
from ..layouts.leaf_blocks import gather_triangles
from ..structs import BVH2_NODE, ENTRY_POINT_LAYOUTS, LAYOUT_WIDTHS, LAYOUTS
from .tree_buffers import TreeBuffers

BRUTE = "brute"

# Trees of up to a million triangles share one compiled kernel for each layout: a compilation takes a second or two on
# PoCL. The dragon's tree needs 29, 48 and 72 entries. A longer stack costs no time: on PoCL 3.0 the bunny's kernels
# with 16 to 128 entries perform alike. Deeper trees get the next multiple of the step.
_COMMON_STACK = {"bvh2": 32, "bvh4": 64, "bvh8": 96}
_STACK_STEP = 16

# A tree that needs a longer stack is refused: it would not fit a work-item's private memory. The trees of our builders,
# at most 64 levels deep, need less in any layout.
_LONGEST_STACK = 1024


class DeviceTree:
    """The buffers and the compile-time constants of one tree.

    Parameters
    ----------
    session : DeviceSession
        Owns the buffers.
    mesh : Mesh
    bvh : Bvh or None
        The tree over `mesh`; None for no tree at all.
    layout : str
        ``"auto"`` takes what suits the device. Without a tree the layout is ``"brute"``, whatever is asked.

    Raises
    ------
    ConfigError
        An unknown layout, or a tree that is too deep.
    DeviceError
        The tree does not fit the device.

    Attributes
    ----------
    layout : str
    arguments : dict of str to argument
        Arguments of every traversal kernel by name: nodes, blocks, block_count.
    defines : dict of str to int
        Macros of every traversal kernel.
    has_entry_points : bool
        Whether rays may begin elsewhere than at the root, see cl/traversal/entry_point.cl.
    node_bytes, memory_bytes : int
        Size of a node, and of all buffers.
    mesh : Mesh
    buffers : TreeBuffers
    sah_growth : float
        The SAH cost of the tree on the device, divided by that of the tree that was built; see `Tracer.sah_growth`.
    """

    def __init__(self, session: DeviceSession, mesh: Mesh, bvh: Bvh | None, layout: str = "auto") -> None:
        self.mesh = mesh
        self.sah_growth = 1.0
        self.layout = _resolve_layout(layout, session, bvh)
        if bvh is None:
            order = np.arange(mesh.face_count, dtype=np.int32)
            arrays = DeviceArrays(np.empty(0, BVH2_NODE), gather_triangles(mesh, order), 0)
        else:
            arrays = make_device_arrays(bvh, self.layout)
            if arrays.stack_size > _LONGEST_STACK:
                raise ConfigError(
                    f"the tree is {bvh.depth} levels deep: as {self.layout} it needs a stack of {arrays.stack_size} "
                    f"entries, and the traversal's holds {_LONGEST_STACK}"
                )
        self.buffers = TreeBuffers(session, arrays)
        self.arguments: dict[str, Any] = {**self.buffers.arguments, "block_count": np.int32(len(arrays.blocks))}
        common = _COMMON_STACK.get(self.layout, _STACK_STEP)
        stack_size = max(common, _STACK_STEP * math.ceil(arrays.stack_size / _STACK_STEP))
        self.defines = {"LAYOUT": LAYOUTS[self.layout], "STACK_SIZE": stack_size}
        self.has_entry_points = self.layout in ENTRY_POINT_LAYOUTS
        self.node_bytes = arrays.nodes.itemsize
        self.memory_bytes = self.buffers.byte_count

    def moved(self, mesh: Mesh, buffers: TreeBuffers, sah_growth: float) -> Self:
        """Return the tree over a moved mesh, whose arrays `buffers` already hold; this tree does not change."""
        moved = copy(self)
        moved.mesh, moved.buffers, moved.sah_growth = mesh, buffers, sah_growth
        moved.arguments = self.arguments | buffers.arguments
        return moved


def check_layout(layout: str) -> None:
    """Raise `ConfigError` unless this is ``"auto"`` or the layout of a tree."""
    known = ("auto", *LAYOUT_WIDTHS)
    if layout not in known:
        raise ConfigError(f"layout must be one of {', '.join(known)}, not '{layout}'")


def _resolve_layout(layout: str, session: DeviceSession, bvh: Bvh | None) -> str:
    check_layout(layout)
    if bvh is None:
        return BRUTE
    return session.settings.layout if layout == "auto" else layout
