"""The trees of all shapes in a device's memory: their nodes and their primitives, joined in a few buffers.

They do not change. A shape that moves gets new buffers: the trees of the others are copied on the device, and its own
is written there. Buffers that no world uses any more are written next, so a shape that moves again and again needs two.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, Self
from weakref import WeakSet, ref

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...device.host.variants import LONGEST_STACK
from ...device.info import DeviceInfo
from ...device.select import choose_device
from ...device.session import DeviceSession
from ...errors import ConfigError, DeviceError, SceneError
from ...geometry import Shape
from ...kinds import KINDS, TRIANGLES, Kind
from ...layouts.device_arrays import (
    DeviceArrays,
    has_shared_blocks,
    list_prims,
    make_all_arrays,
    make_device_arrays,
)
from ...layouts.device_prims import DevicePrims
from ...support.host_threads import HostThreads
from ...tree_layouts import LAYOUTS, TREE_LAYOUTS
from .tree_box import TreeBox

if TYPE_CHECKING:
    from ...builders.options import BuildOptions

BRUTE = "brute"

# The cost is rays times primitives: with more of them than this, a picture would take hours.
BRUTE_LIMIT = 100_000

# Trees too deep for the common stack of their layout get the next multiple of this.
_STACK_STEP = 16

# The most items that the device counts.
_MOST_ITEMS = np.iinfo(np.int32).max


def check_layout(layout: str) -> None:
    """Raise `ConfigError` unless this is ``"auto"`` or the layout of a tree."""
    known = ("auto", *TREE_LAYOUTS)
    if layout not in known:
        raise ConfigError(f"layout must be one of {', '.join(known)}, not '{layout}'")


def check_brute(prim_count: int) -> None:
    """Raise `ConfigError` if there are too many primitives to test without a tree."""
    if prim_count > BRUTE_LIMIT:
        raise ConfigError(
            f"the brute builder tests every primitive for every ray: {prim_count:,} primitives are more than its limit "
            f"of {BRUTE_LIMIT:,}"
        )


# Bytes of a triangle in the largest buffer of `bvh8`, whose blocks are seldom full, at most: 48 to 60 were measured.
_USUAL_BYTES = 60

# The layout of large scenes.
_SMALLEST_LAYOUT = min(TREE_LAYOUTS, key=lambda name: LAYOUTS[name].least_bytes)


def choose_layout(layout: str, info: DeviceInfo, shapes: Sequence[Shape]) -> str:
    """Return the layout that is asked for; of ``"auto"`` the one that suits a device, or `bvh8c` for a large scene.

    Raises
    ------
    DeviceError
        No buffer of the device holds the triangles, however they lie.
    """
    count = sum(shape.prim_count for shape in shapes if shape.kind is TRIANGLES)
    largest = info.max_allocation_bytes
    if layout == "auto":
        layout = info.layout if count * _USUAL_BYTES <= largest else _SMALLEST_LAYOUT
    least = count * LAYOUTS[layout].least_bytes
    if least > largest:
        advice = (
            f"take the layout {_SMALLEST_LAYOUT}" if layout != _SMALLEST_LAYOUT else "cut the mesh by `clbvh shard`"
        )
        raise DeviceError(
            f"{count:,} triangles need a buffer of at least {least / 1e6:,.0f} MB in the layout {layout}, and the "
            f"largest one of the device '{info.name}' has {largest / 1e6:,.0f} MB: {advice}"
        )
    return layout


# Triangles that a device is believed to hold: to ask starts its driver.
_BELIEVED = 1 << 24


def check_fit(device: Any, layout: str, shapes: Sequence[Shape]) -> None:
    """Raise `DeviceError` before trees are built that the device cannot hold; see `choose_layout`.

    Parameters
    ----------
    device : as `choose_device` and `DeviceInfo`
    layout : str
    shapes : sequence of Mesh or Spheres
    """
    if sum(shape.prim_count for shape in shapes) > _BELIEVED:
        info = device if isinstance(device, DeviceInfo) else choose_device(device)
        choose_layout(layout, info, shapes)


def pad_stack(layout: str, needed: int) -> int:
    """Return the size of the stack to compile in, where the tree needs one of `needed` entries.

    Raises
    ------
    ConfigError
        The tree needs more than a work-item has.
    """
    if needed > LONGEST_STACK:
        raise ConfigError(
            f"the tree is too deep: as {layout} it needs a stack of {needed:,} entries, and the traversal's holds "
            f"{LONGEST_STACK:,}"
        )
    return max(LAYOUTS[layout].common_stack, _STACK_STEP * math.ceil(needed / _STACK_STEP))


class Tree(NamedTuple):
    """Where the arrays of one shape are in the joined ones.

    Attributes
    ----------
    kind : Kind
    first_node, node_count, first_block, block_count : int
    stack_size : int
        Most entries on the stack of a traversal, as it is compiled in.
    """

    kind: Kind
    first_node: int
    node_count: int
    first_block: int
    block_count: int
    stack_size: int


@dataclass(frozen=True, eq=False)
class NewTree:
    """A tree that is not yet in its place among others.

    Attributes
    ----------
    tree : Tree
    find_box : function
        Returns the `TreeBox` around it.
    arrays : DeviceArrays or None
        Of a tree that is on the host.
    buffers : tuple of two buffers
        Nodes and blocks of one that was built on the device.
    """

    tree: Tree
    find_box: Callable[[], TreeBox]
    arrays: DeviceArrays | None = None
    buffers: tuple[Any, ...] = ()

    @classmethod
    def make(
        cls,
        session: DeviceSession,
        shape: Shape,
        plan: Bvh | BuildOptions,
        layout: str,
        prims: DevicePrims | None = None,
    ) -> Self:
        """Return a finished tree, or one that the device builds by the options, of the shape's primitives there."""
        if isinstance(plan, Bvh):
            return cls.from_host(shape, plan, layout)
        if has_shared_blocks(shape, layout):
            # Imported here: a tracer of a finished tree needs no builder.
            from ...builders.device.build_device import build_fast

            return cls.from_host(shape, build_fast(shape, plan, session.info), layout)
        return cls.build(session, prims or DevicePrims(session, session, shape), plan, layout)

    @classmethod
    def make_all(
        cls, session: DeviceSession, shapes: Sequence[Shape], plans: Sequence[Bvh | BuildOptions], layout: str
    ) -> list[Self]:
        """Return what `make` does of each shape."""
        bvhs = {number: plan for number, plan in enumerate(plans) if isinstance(plan, Bvh)}
        arrays = dict(zip(bvhs, make_all_arrays([*bvhs.values()], layout), strict=True))
        return [
            cls._of_bvh(shape, bvhs[number], arrays[number], layout)
            if number in bvhs
            else cls.make(session, shape, plan, layout)
            for number, (shape, plan) in enumerate(zip(shapes, plans, strict=True))
        ]

    @classmethod
    def from_host(cls, shape: Shape, bvh: Bvh, layout: str) -> Self:
        """Return a finished tree.

        Raises
        ------
        ConfigError
            It is too deep.
        """
        return cls._of_bvh(shape, bvh, make_device_arrays(bvh, layout), layout)

    @classmethod
    def _of_bvh(cls, shape: Shape, bvh: Bvh, arrays: DeviceArrays, layout: str) -> Self:
        return cls._of_arrays(shape, arrays, layout, partial(TreeBox.around, bvh))

    @classmethod
    def without_nodes(cls, shape: Shape) -> Self:
        """Return the primitives alone, for the layout ``"brute"``."""
        return cls._of_arrays(shape, list_prims(shape), BRUTE, partial(TreeBox.of_shape, shape))

    @classmethod
    def _of_arrays(cls, shape: Shape, arrays: DeviceArrays, layout: str, find_box: Callable[[], TreeBox]) -> Self:
        stack_size = pad_stack(layout, arrays.stack_size)
        tree = Tree(shape.kind, 0, len(arrays.nodes), 0, arrays.blocks.item_count, stack_size)
        return cls(tree, find_box, arrays)

    @classmethod
    def build(cls, session: DeviceSession, prims: DevicePrims, options: BuildOptions, layout: str) -> Self:
        """Build a tree on the device; its arrays never leave it.

        Raises
        ------
        DeviceError
            The device has not enough memory.
        """
        # Imported here: a tracer of a finished tree needs no builder.
        from ...builders.device.build_device import TreeForm, build_tree_on

        form, shape = TreeForm(LAYOUTS[layout]), prims.shape
        built = build_tree_on(session, prims, options, form)
        blocks = prims.make_blocks(session, form.layout.block_width, built.prims, built.block_count)
        # Before the buffers of the build go: PoCL 3.0 reads freed ones where it compiles a kernel for the first time.
        session.finish()
        stack_size = pad_stack(layout, built.stack_size)
        half = np.maximum(np.abs(built.lower), np.abs(built.upper)).astype(np.float64)
        tree = Tree(shape.kind, 0, built.node_count, 0, built.block_count, stack_size)
        return cls(tree, lambda: TreeBox(shape.origin, shape.scale, half), None, (built.nodes, blocks))


@dataclass(frozen=True, eq=False)
class DeviceTrees:
    """The trees of all shapes in the memory of a device.

    Attributes
    ----------
    session : DeviceSession
        Owns the buffers.
    layout : str
    trees : tuple of Tree
        By geometry id.
    buffers : dict of str to buffer
        nodes, blocks and spheres, as the kernels call them, see cl/world/world.cl; without those that would be empty.
    dtypes : dict of str to dtype
        Of the items of those buffers.
    box : TreeBox
        Around the first tree.
    """

    session: DeviceSession
    layout: str
    trees: tuple[Tree, ...]
    buffers: dict[str, Any]
    dtypes: dict[str, np.dtype]
    box: TreeBox

    @classmethod
    def join(cls, session: DeviceSession, shapes: Sequence[Shape], trees: Sequence[NewTree], layout: str) -> Self:
        """Put trees into their places on a device.

        Parameters
        ----------
        session : DeviceSession
        shapes : sequence of Mesh or Spheres
        trees : sequence of NewTree
            One for each shape.
        layout : str

        Raises
        ------
        SceneError
            There are more nodes or primitives than int32 counts.
        DeviceError
            The trees do not fit the device.
        """
        dtypes = {"nodes": LAYOUTS[layout].node}
        dtypes |= {kind.buffer: LAYOUTS[layout].block(kind) for kind in dict.fromkeys(shape.kind for shape in shapes)}
        joined = cls(session, layout, _place([new.tree for new in trees]), {}, dtypes, trees[0].find_box())
        if len(trees) == 1 and trees[0].arrays is None:
            # A tree that was built there stays where it is.
            for (name, _, _), buffer in zip(_list_arrays(joined.trees[0]), trees[0].buffers, strict=True):
                joined.buffers[name] = buffer
            return joined
        for name, size in joined._sizes().items():
            joined.buffers[name] = session.allocate(size, writable=False)
        joined.put(session, 0, trees)
        return joined

    def put(self, session: DeviceSession, first_id: int, trees: Sequence[NewTree]) -> None:
        """Write the trees of geometries that follow each other into their places."""
        placed = list(zip(self.trees[first_id : first_id + len(trees)], trees, strict=True))
        on_host = [(_list_arrays(tree), new.arrays) for tree, new in placed if new.arrays is not None]
        ends = {name: first + count for arrays, _ in on_host for name, first, count in arrays if count}
        begins = {name: first for arrays, _ in on_host[::-1] for name, first, _ in arrays}
        with ExitStack() as stack:
            threads = stack.enter_context(HostThreads())
            # Each buffer is mapped once: that takes as long as to build a small tree.
            items = {
                name: stack.enter_context(
                    session.mapped(
                        self.buffers[name], end - begins[name], self.dtypes[name], write=True, first=begins[name]
                    )
                )
                for name, end in ends.items()
            }
            for ((_, first, count), (blocks, first_block, block_count)), arrays in on_host:
                if count:  # as bytes: numpy takes three times as long for structs
                    nodes = items["nodes"][first - begins["nodes"] :][:count]
                    nodes.view(np.uint8)[:] = arrays.nodes.view(np.uint8)
                arrays.blocks.write(items[blocks][first_block - begins[blocks] :][:block_count], threads)
        for tree, new in placed:
            for source, (name, first, count) in zip(new.buffers, _list_arrays(tree), strict=False):
                size = self.dtypes[name].itemsize
                session.copy(source, self.buffers[name], count * size, target_begin=first * size)

    def block_buffer(self, geometry_id: int) -> str:
        """Return the name of the buffer with the blocks of a tree."""
        return self.trees[geometry_id].kind.buffer

    @property
    def ranges(self) -> NDArray[np.int32]:
        """(G, 4) int32: first node, first block, number of blocks and kind of each tree."""
        rows = ((tree.first_node, tree.first_block, tree.block_count, tree.kind.number) for tree in self.trees)
        return np.array([*rows], "i4")

    @property
    def kinds(self) -> set[Kind]:
        """Of the primitives of all shapes."""
        return {tree.kind for tree in self.trees}

    @property
    def stack_size(self) -> int:
        """Size of the stack to compile in."""
        return max(tree.stack_size for tree in self.trees)

    @property
    def memory_bytes(self) -> int:
        """Bytes of all buffers."""
        return sum(self._sizes().values())

    def _sizes(self) -> dict[str, int]:
        """Return the bytes of each buffer."""
        sizes = dict.fromkeys(self.dtypes, 0)
        for tree in self.trees:
            for name, _, count in _list_arrays(tree):
                sizes[name] += count * self.dtypes[name].itemsize
        return sizes

    def download(self, session: DeviceSession, geometry_id: int) -> list[NDArray[np.void]]:
        """Return copies of the nodes and of the blocks of a shape."""
        arrays = []
        for name, first, count in _list_arrays(self.trees[geometry_id]):
            arrays.append(array := np.empty(count, self.dtypes[name]))
            session.download(self.buffers[name], array.view(np.uint8), begin=first * array.itemsize)
        return arrays

    def with_room(self, session: DeviceSession, geometry_id: int, tree: Tree, retired: RetiredBuffers) -> DeviceTrees:
        """Return the trees in which one is yet to be written: in other buffers, with copies of all other trees.

        Parameters
        ----------
        session : DeviceSession
            A branch of the owner, for this thread.
        geometry_id : int
        tree : Tree
            The numbers of its nodes and blocks.
        retired : RetiredBuffers
            Those that may be written.
        """
        trees = _place([*self.trees[:geometry_id], tree, *self.trees[geometry_id + 1 :]])
        moved = replace(self, trees=trees, buffers=dict(self.buffers))
        sizes = moved._sizes()
        old_counts = {name: count for name, _, count in _list_arrays(self.trees[geometry_id])}
        for name, first, count in _list_arrays(trees[geometry_id]):
            item_bytes = self.dtypes[name].itemsize
            begin, old_end = first * item_bytes, (first + old_counts[name]) * item_bytes
            moved.buffers[name] = target = retired.take(self.session, name, sizes[name])
            source = self.buffers[name]
            session.copy(source, target, begin)
            end = begin + count * item_bytes
            session.copy(source, target, sizes[name] - end, source_begin=old_end, target_begin=end)
        return moved


def _place(trees: Sequence[Tree]) -> tuple[Tree, ...]:
    """Return the trees one behind the other."""
    placed = []
    ends = dict.fromkeys(("nodes", *(kind.buffer for kind in KINDS.values())), 0)
    for tree in trees:
        blocks = tree.kind.buffer
        placed.append(Tree(tree.kind, ends["nodes"], tree.node_count, ends[blocks], tree.block_count, tree.stack_size))
        ends["nodes"] += tree.node_count
        ends[blocks] += tree.block_count
    if max(ends.values()) > _MOST_ITEMS:
        raise SceneError(f"the scene has {max(ends.values()):,} nodes, and the device counts up to {_MOST_ITEMS:,}")
    return tuple(placed)


def _list_arrays(tree: Tree) -> list[tuple[str, int, int]]:
    """Return the buffers of a tree's nodes and of its blocks, where they begin, and their numbers."""
    return [
        ("nodes", tree.first_node, tree.node_count),
        (tree.kind.buffer, tree.first_block, tree.block_count),
    ]


class RetiredBuffers:
    """Buffers of earlier trees: those that no query uses any more may be written; for one change at a time."""

    def __init__(self) -> None:
        # The trees, and what they share with no newer ones: name, size, buffer. The oldest first.
        self._retired: list[tuple[ref[DeviceTrees], list[tuple[str, int, Any]]]] = []
        self._free: list[tuple[str, int, Any]] = []
        self._shared: WeakSet[Any] = WeakSet()

    def leave(self, trees: DeviceTrees) -> None:
        """Never write the buffers of trees: other tracers see them, too."""
        self._shared.update(trees.buffers.values())

    def add(self, trees: DeviceTrees, newer: DeviceTrees) -> None:
        """Keep the buffers of trees that newer ones do not share, for later."""
        sizes = trees._sizes()
        own = [
            (name, sizes[name], each)
            for name, each in trees.buffers.items()
            if newer.buffers[name] is not each and each not in self._shared
        ]
        self._retired.append((ref(trees), own))

    def take(self, session: DeviceSession, name: str, size: int) -> Any:
        """Return a buffer of a size: one that is free, or a new one. Other free ones of the name are released.

        Raises
        ------
        DeviceError
            The device has no room for another one.
        """
        # In order: trees may share buffers with older ones that a query still uses.
        while self._retired and self._retired[0][0]() is None:
            self._free += self._retired.pop(0)[1]
        known = [each for each in self._free if each[0] == name]
        self._free = [each for each in self._free if each[0] != name]
        taken = next((buffer for _, known_size, buffer in known if known_size == size), None)
        for _, _, buffer in known:
            if buffer is not taken:
                session.release(buffer)
        return session.allocate(size, writable=False) if taken is None else taken

    @property
    def memory_bytes(self) -> int:
        """Bytes of all buffers."""
        retired = [each for _, own in self._retired for each in own]
        return sum(size for _, size, _ in retired + self._free)
