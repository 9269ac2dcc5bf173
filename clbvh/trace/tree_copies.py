"""The copies of one tree on a device, which let its mesh move while queries run.

An update writes into a copy that no query uses, and queries that begin later use that one. So a query sees one mesh
from beginning to end, an update waits for none, and one that fails or is interrupted has changed nothing. Two copies
are enough for one thread; with queries in other threads there is one for each mesh that they still use, and one more.

A copy is in use as long as its caster is alive: a query holds the caster that it began with. Nothing has to be given
back, so nothing is lost when Ctrl-C strikes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast
from weakref import ref

from ..device.session import DeviceSession
from ..geometry import Mesh
from ..layouts.refit_arrays import RefitArrays
from ..layouts.topology import read_topology
from .device_tree import DeviceTree
from .launch import Caster
from .rays.batch import TreeBox
from .tree_buffers import TreeBuffers


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
        # Listed above first: Ctrl-C in between would leave buffers that nobody knows.
        free[0].buffers.allocate()
        return free[0]


def _tree_of(caster: Caster) -> DeviceTree:
    """Return the tree of a caster at a mesh."""
    return cast(DeviceTree, caster.tree)
