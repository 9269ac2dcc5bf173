"""A mesh and its tree in a device's memory, ready for a traversal kernel."""

from __future__ import annotations

import math
from copy import copy
from threading import Lock
from typing import Any, Self

import numpy as np

from ..bvh import Bvh
from ..device.session import DeviceSession
from ..errors import ConfigError
from ..geometry import Mesh
from ..layouts.device_arrays import list_prims, make_device_arrays
from ..structs import ENTRY_POINT_LAYOUTS, HIT, LAYOUT_WIDTHS, LAYOUTS, PACKED_POINT, PACKED_RAY
from .tree_buffers import TreeBuffers
from .triangles import Triangles, triangles_of
from .wide_arrays import WideArrays

BRUTE = "brute"

# Trees of up to a million triangles share one compiled kernel for each layout: a compilation takes a second or two on
# PoCL. The dragon's tree needs 29, 48 and 72 entries. A longer stack costs no time: on PoCL 3.0 the bunny's kernels
# with 16 to 128 entries perform alike. Deeper trees get the next multiple of the step.
_COMMON_STACK = {"bvh2": 32, "bvh4": 64, "bvh8": 96}
_STACK_STEP = 16

# A tree that needs a longer stack is refused: it would not fit a work-item's private memory. The trees of our builders,
# at most 64 levels deep, need less in any layout.
_LONGEST_STACK = 1024


class HostTree:
    """The arrays of one copy of a tree on the host, once a query has asked for them."""

    def __init__(self) -> None:
        self.lock = Lock()
        self.arrays: WideArrays | None = None


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
    ray_dtype, point_dtype, hit_dtype : numpy.dtype
        Of rays, points and hits on the device.
    mesh : Mesh
    surface : Triangles
        What hits are refined on.
    scene_surface : SceneSurface or None
        The scene that is nothing but this mesh.
    most_crossings : int
        Most crossings that a ray can have.
    buffers : TreeBuffers
    sah_growth : float
        The SAH cost of the tree on the device, divided by that of the tree that was built; see `Tracer.sah_growth`.
    """

    has_instances = False
    advances_rays = False
    scene_surface: Any = None
    ray_tree: Any = None
    ray_dtype = PACKED_RAY
    point_dtype = PACKED_POINT
    hit_dtype = HIT

    def __init__(self, session: DeviceSession, mesh: Mesh, bvh: Bvh | None, layout: str = "auto") -> None:
        self.mesh = mesh
        self.sah_growth = 1.0
        self.layout = BRUTE if bvh is None else resolve_layout(layout, session)
        arrays = list_prims(mesh) if bvh is None else make_device_arrays(bvh, self.layout)
        stack_size = pad_stack(self.layout, arrays.stack_size, 0 if bvh is None else bvh.depth)
        self.buffers = TreeBuffers(session, arrays)
        self.arguments: dict[str, Any] = {**self.buffers.arguments, "block_count": np.int32(len(arrays.blocks))}
        self.defines = make_defines(self.layout, stack_size)
        self.has_entry_points = self.layout in ENTRY_POINT_LAYOUTS
        self.node_bytes = arrays.nodes.itemsize
        self.memory_bytes = self.buffers.byte_count
        self._shares_memory = session.info.kind == "cpu" and not session.info.is_simulator
        self._on_host = HostTree()

    @property
    def surface(self) -> Triangles:  # noqa: D102
        return triangles_of(self.mesh)

    @property
    def most_crossings(self) -> int:  # noqa: D102
        return self.mesh.face_count

    def on_host(self) -> WideArrays | None:
        """Return the tree as the host sees it, without a copy; None if it does not, or if the layout is no wide one.

        For calls that are running: it is valid until the last caster at this tree is gone.
        """
        if not (self._shares_memory and self.layout in ENTRY_POINT_LAYOUTS):
            return None
        held = self._on_host
        if held.arrays is None:
            with held.lock:
                if held.arrays is None:
                    nodes, blocks = self.buffers.hold()
                    held.arrays = WideArrays.of(nodes, blocks, LAYOUT_WIDTHS[self.layout], self.defines["STACK_SIZE"])
        return held.arrays

    def moved(self, mesh: Mesh, buffers: TreeBuffers, sah_growth: float) -> Self:
        """Return the tree over a moved mesh, whose arrays `buffers` already hold; this tree does not change."""
        moved = copy(self)
        moved.mesh, moved.buffers, moved.sah_growth = mesh, buffers, sah_growth
        moved._on_host = HostTree()
        moved.arguments = self.arguments | buffers.arguments
        return moved


def check_layout(layout: str) -> None:
    """Raise `ConfigError` unless this is ``"auto"`` or the layout of a tree."""
    known = ("auto", *LAYOUT_WIDTHS)
    if layout not in known:
        raise ConfigError(f"layout must be one of {', '.join(known)}, not '{layout}'")


def resolve_layout(layout: str, session: DeviceSession) -> str:
    """Return the layout of a tree: the one of that name or, for ``"auto"``, what suits the device."""
    check_layout(layout)
    return session.settings.layout if layout == "auto" else layout


def make_defines(layout: str, stack_size: int) -> dict[str, int]:
    """Return the macros of every traversal kernel of a tree."""
    return {"LAYOUT": LAYOUTS[layout], "STACK_SIZE": stack_size}


def pad_stack(layout: str, needed: int, depth: int) -> int:
    """Return the size of the stack to compile in, where the tree needs one of `needed` entries.

    Raises
    ------
    ConfigError
        The tree, `depth` levels deep, needs more than a work-item has.
    """
    if needed > _LONGEST_STACK:
        raise ConfigError(
            f"the tree is {depth} levels deep: as {layout} it needs a stack of {needed} entries, and the traversal's "
            f"holds {_LONGEST_STACK}"
        )
    return max(_COMMON_STACK.get(layout, _STACK_STEP), _STACK_STEP * math.ceil(needed / _STACK_STEP))
