"""A mesh and its tree in a device's memory, ready for a traversal kernel, and the copies that let the mesh move.

An update writes into a copy that no query uses, and queries that begin later use that one. So a query sees one mesh
from beginning to end, an update waits for none, and one that fails or is interrupted has changed nothing. Two copies
are enough for one thread; with queries in other threads there is one for each mesh that they still use, and one more.

A copy is in use as long as its caster is alive: a query holds the caster that it began with. Nothing has to be given
back, so nothing is lost when Ctrl-C strikes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING, Any, Self, cast
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from ..bvh import Bvh
from ..device.session import DeviceSession
from ..errors import ConfigError
from ..geometry import Mesh
from ..layouts.device_arrays import DeviceArrays, list_prims, make_device_arrays
from ..layouts.refit_arrays import RefitArrays, read_topology
from ..structs import ENTRY_POINT_LAYOUTS, HIT, LAYOUT_WIDTHS, LAYOUTS
from .rays.batch import TreeBox
from .traced_tree import WideArrays
from .world.surface_arrays import lone_arrays

if TYPE_CHECKING:  # pictures need no queries
    from .launch import Caster

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
    hit_dtype : numpy.dtype
        Of hits on the device.
    mesh : Mesh
    surface : SurfaceArrays
        What hits are refined on.
    scene_surface : Surface or None
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
    hit_dtype = HIT

    def __init__(self, session: DeviceSession, mesh: Mesh, bvh: Bvh | None, layout: str = "auto") -> None:
        self.mesh, self.surface = mesh, lone_arrays(mesh)
        self.sah_growth = 1.0
        self.layout = BRUTE if bvh is None else resolve_layout(layout, session)
        arrays = list_prims(mesh) if bvh is None else make_device_arrays(bvh, self.layout)
        stack_size = pad_stack(self.layout, arrays.stack_size, 0 if bvh is None else bvh.depth)
        self.buffers = TreeBuffers(session, arrays)
        self.arguments: dict[str, Any] = {
            **self.buffers.arguments, "block_count": np.int32(len(arrays.blocks)), "top_nodes": None, "instances": None,
            "spheres": None,
        }  # fmt: skip
        self.defines = make_defines(self.layout, stack_size)
        self.has_entry_points = self.layout in ENTRY_POINT_LAYOUTS
        self.node_bytes = arrays.nodes.itemsize
        self.memory_bytes = self.buffers.byte_count
        self._shares_memory = session.info.kind == "cpu" and not session.info.is_simulator
        self._on_host = HostTree()

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
        moved.mesh, moved.surface, moved.buffers, moved.sah_growth = mesh, lone_arrays(mesh), buffers, sah_growth
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
    return {"LAYOUT": LAYOUTS[layout], "STACK_SIZE": stack_size, "LONE": 1}


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


# The arrays of a tree, by the names of the kernels' arguments.
_NAMES = ("nodes", "blocks")


class TreeBuffers:
    """The nodes and the blocks of a tree, each in a buffer.

    Parameters
    ----------
    session : DeviceSession
        Owns the buffers.
    arrays : DeviceArrays

    Attributes
    ----------
    arguments : dict of str to buffer
        By the names of the kernels' arguments.
    """

    def __init__(self, session: DeviceSession, arrays: DeviceArrays) -> None:
        self._session = session
        by_name: dict[str, NDArray[np.void]] = {name: getattr(arrays, name) for name in _NAMES}
        self._shapes = {name: (len(array), array.dtype) for name, array in by_name.items()}
        self.arguments: dict[str, Any] = {name: session.upload(array) for name, array in by_name.items()}
        self._held: list[NDArray[np.uint8]] = []

    def twin(self) -> TreeBuffers:
        """Return other buffers of the same sizes; the device may have no room for them."""
        twin = copy(self)
        twin.arguments, twin._held = {}, []
        try:
            for name in _NAMES:
                twin.arguments[name] = self._session.allocate(self._byte_count(name), writable=False)
        except BaseException:
            twin.release()
            raise
        return twin

    def hold(self) -> list[NDArray[np.uint8]]:
        """Return the bytes of nodes and blocks to read, until the buffers are written or released; neither is empty."""
        self._held = [self._session.hold_mapped(self.arguments[name], self._byte_count(name)) for name in _NAMES]
        return self._held

    def _let_go(self) -> None:
        while self._held:
            self._session.end_mapping(self._held.pop())

    @property
    def byte_count(self) -> int:
        """Bytes of the buffers that are on the device."""
        return sum(map(self._byte_count, list(self.arguments)))

    def _byte_count(self, name: str) -> int:
        count, dtype = self._shapes[name]
        return count * dtype.itemsize

    @contextmanager
    def mapped(self, session: DeviceSession, *, write: bool) -> Iterator[tuple[NDArray[np.void], NDArray[np.void]]]:
        """Map nodes and blocks into the host's memory as arrays; neither may be empty.

        Parameters
        ----------
        session : DeviceSession
            The one that owns the buffers, or a branch of it.
        write : bool
            True: the caller fills both arrays completely. False: the caller only reads them.
        """
        if write:
            self._let_go()
        nodes, blocks = (session.mapped(self.arguments[name], *self._shapes[name], write=write) for name in _NAMES)
        with nodes as node_array, blocks as block_array:
            yield node_array, block_array

    def release(self) -> None:
        """Give the buffers back before the session ends."""
        self._let_go()
        while self.arguments:
            self._session.release(self.arguments.popitem()[1])


@dataclass(eq=False)
class _Copy:
    """Buffers, and the last caster that was given them; None if there was none."""

    buffers: TreeBuffers
    caster: ref[Caster] | None = None

    @property
    def is_free(self) -> bool:
        return self.caster is None or self.caster() is None


class TreeCopies:
    """The copies of one tree; for one update at a time.

    Parameters
    ----------
    caster : Caster
        At the tree as it was built, the first copy.
    """

    def __init__(self, caster: Caster) -> None:
        self._copies = [_Copy(_tree_of(caster).buffers, ref(caster))]
        self._arrays: RefitArrays | None = None
        self._built_cost = 0.0

    @property
    def memory_bytes(self) -> int:
        """Bytes of all copies on the device."""
        return sum(held.buffers.byte_count for held in list(self._copies))

    def move(self, caster: Caster, mesh: Mesh, session: DeviceSession) -> Caster:
        """Return a caster at a copy of the tree whose mesh has moved.

        Parameters
        ----------
        caster : Caster
            The newest one; it stays as it is.
        mesh : Mesh
            With the same faces.
        session : DeviceSession
            A branch of the caster's session, for this thread.

        Raises
        ------
        DeviceError
            The device has no room for another copy, or its driver refuses.
        """
        tree = _tree_of(caster)
        arrays, held = self._arrays, self._take_free(tree)
        if arrays is None:
            with tree.buffers.mapped(session, write=False) as built:
                arrays = RefitArrays(read_topology(*built, tree.layout))
        with held.buffers.mapped(session, write=True) as target:
            if self._arrays is None:
                # The cost of the tree as it was built: only those who update ask how it has grown.
                arrays.write(tree.mesh, *target, caster.threads)
                self._built_cost, self._arrays = arrays.sah_cost, arrays
            arrays.write(mesh, *target, caster.threads)
        # Queries have queues of their own, which do not wait for this one.
        session.finish()
        copied = tree.moved(mesh, held.buffers, arrays.sah_cost / self._built_cost)
        moved = caster.over(copied, TreeBox(mesh.origin, mesh.scale, arrays.half))
        held.caster = ref(moved)
        return moved

    def _take_free(self, tree: DeviceTree) -> _Copy:
        """Return a copy that no query uses, a new one if there is none; release any other unused copies."""
        free = [held for held in self._copies if held.is_free]
        if not free:
            free = [_Copy(tree.buffers.twin())]
            self._copies += free
        for surplus in free[1:]:
            self._copies.remove(surplus)
            surplus.buffers.release()
        return free[0]


def _tree_of(caster: Caster) -> DeviceTree:
    """Return the tree of a caster at a mesh."""
    return cast(DeviceTree, caster.tree)
