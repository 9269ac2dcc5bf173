"""A mesh and its tree in a device's memory, ready for a traversal kernel."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..device.session import DeviceSession
from ..errors import ConfigError
from ..geometry import Mesh
from ..layout import BVH2_NODE, LAYOUTS
from ..tree import Bvh
from ..tree.layouts import gather_triangles, make_bvh2_nodes

BRUTE = "brute"

# Stack sizes are rounded up to this many entries, so that most trees share one compiled kernel: a compilation takes
# a second on PoCL.
_STACK_STEP = 16

# A deeper tree is not traversed: its stack would not fit a work-item's private memory. Our builders stay below 64.
_MAX_DEPTH = 1024


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
        What every traversal kernel takes first: nodes, triangles, triangle count.
    defines : dict of str to int
        Macros that every traversal kernel needs.
    memory_bytes : int
        Size of all buffers.
    """

    def __init__(self, session: DeviceSession, mesh: Mesh, bvh: Bvh | None, layout: str = "auto") -> None:
        self.layout = _resolve_layout(layout, session, bvh)
        if bvh is None:
            nodes: Any = np.empty(0, BVH2_NODE)
            order = np.arange(mesh.face_count, dtype=np.int32)
            depth = 0
        else:
            nodes = make_bvh2_nodes(bvh)
            order = bvh.prim_ids
            depth = bvh.depth
            if depth > _MAX_DEPTH:
                raise ConfigError(f"the tree is {depth} levels deep; the traversal's stack holds {_MAX_DEPTH}")
        triangles = gather_triangles(mesh, order)
        self.arguments = (session.upload(nodes), session.upload(triangles), np.int32(len(triangles)))
        stack_size = _STACK_STEP * max(1, math.ceil(depth / _STACK_STEP))
        self.defines = {"LAYOUT": LAYOUTS[self.layout], "STACK_SIZE": stack_size}
        self.memory_bytes = nodes.nbytes + triangles.nbytes


def check_layout(layout: str) -> None:
    """Raise `ConfigError` unless this is ``"auto"`` or the layout of a tree."""
    known = ("auto", *(name for name in LAYOUTS if name != BRUTE))
    if layout not in known:
        raise ConfigError(f"layout must be one of {', '.join(known)}, not '{layout}'")


def _resolve_layout(layout: str, session: DeviceSession, bvh: Bvh | None) -> str:
    check_layout(layout)
    if bvh is None:
        return BRUTE
    return session.info.layout if layout == "auto" else layout
