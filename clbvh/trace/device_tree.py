"""A mesh and its tree in a device's memory, ready for a traversal kernel."""

from __future__ import annotations

import math

import numpy as np

from ..device.session import DeviceSession
from ..errors import ConfigError
from ..geometry import Mesh
from ..layout import BVH2_NODE, ENTRY_LAYOUTS, LAYOUT_WIDTHS, LAYOUTS
from ..tree import Bvh
from ..tree.device_arrays import DeviceArrays, make_device_arrays
from ..tree.layouts import gather_triangles

BRUTE = "brute"

# Stack sizes are rounded up to this many entries, so that most trees share one compiled kernel: a compilation takes
# a second on PoCL.
_STACK_STEP = 16

# A tree that needs more is not traversed: its stack would not fit a work-item's private memory. Those of our builders,
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

    Attributes
    ----------
    arguments : tuple
        What every traversal kernel takes first: nodes, groups, group count.
    defines : dict of str to int
        Macros that every traversal kernel needs.
    entry_bytes : int
        What a tile's entry takes, see `TileEntries`; 0 if the layout has none.
    memory_bytes : int
        Size of all buffers.
    """

    def __init__(self, session: DeviceSession, mesh: Mesh, bvh: Bvh | None, layout: str = "auto") -> None:
        self.layout = _resolve_layout(layout, session, bvh)
        if bvh is None:
            order = np.arange(mesh.face_count, dtype=np.int32)
            arrays = DeviceArrays(np.empty(0, BVH2_NODE), gather_triangles(mesh, order), 0)
        else:
            arrays = make_device_arrays(bvh, self.layout)
            if arrays.waiting > _LONGEST_STACK:
                raise ConfigError(
                    f"the tree is {bvh.depth} levels deep: as {self.layout} it needs a stack of {arrays.waiting} "
                    f"entries, and the traversal's holds {_LONGEST_STACK}"
                )
        self.arguments = (session.upload(arrays.nodes), session.upload(arrays.groups), np.int32(len(arrays.groups)))
        stack_size = _STACK_STEP * max(1, math.ceil(arrays.waiting / _STACK_STEP))
        self.defines = {"LAYOUT": LAYOUTS[self.layout], "STACK_SIZE": stack_size}
        self.entry_bytes = arrays.nodes.itemsize if self.layout in ENTRY_LAYOUTS else 0
        self.memory_bytes = arrays.nodes.nbytes + arrays.groups.nbytes


def check_layout(layout: str) -> None:
    """Raise `ConfigError` unless this is ``"auto"`` or the layout of a tree."""
    known = ("auto", *LAYOUT_WIDTHS)
    if layout not in known:
        raise ConfigError(f"layout must be one of {', '.join(known)}, not '{layout}'")


def _resolve_layout(layout: str, session: DeviceSession, bvh: Bvh | None) -> str:
    check_layout(layout)
    if bvh is None:
        return BRUTE
    return session.info.layout if layout == "auto" else layout
