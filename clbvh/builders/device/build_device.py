"""A tree built on a device: from corners to nodes and blocks, in the steps of cl/kernels/build_tree.cl.

After Meister and Bittner, "Parallel locally-ordered clustering for bounding volume hierarchy construction" (2018), in
tiles as Benthin et al., "H-PLOC: hierarchical parallel locally-ordered clustering" (2024), have them. The bytes of a
tree depend on no device: all sizes follow from the number of primitives, and every merge has its own number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...device.info import DeviceInfo
from ...device.radix_sort import PAIR_BYTES, sort_pairs
from ...device.session import DeviceSession
from ...errors import DeviceError
from ...geometry.spheres import Bounded, Shape
from ...layouts.device_mesh import open_session
from ...layouts.device_prims import DevicePrims
from ...layouts.wide import block_price
from ...structs import MERGE, NODE, PLACEMENT, TREE_SUMMARY, WIDE_CHOICES
from ...support.stopwatch import Stopwatch
from ...tree_layouts import LAYOUTS, Layout
from ..options import BuildOptions
from .passes import TILE_SIZE, Pass, plan_passes

# Bits of a key, see cl/tree/morton.cl. Above this number of primitives two keys are sorted by, one after the other:
# cells of the coarser grid would have many primitives each.
_KEY_BITS = 30
_MOST_FOR_ONE_KEY = 1 << 24

# Work-items of a work-group: of kernels with one for each primitive, with one for each tile, and with one for each
# cluster of a tile, on GPUs.
_PRIM_GROUP = (64,)
_TILE_GROUP = (1,)
CLUSTER_GROUP = (128,)


class TreeForm(NamedTuple):
    """The binary tree, and what becomes of it.

    Attributes
    ----------
    layout : Layout
        `bvh2` if `as_rows`: the binary tree as it is.
    as_rows : bool
        Nodes as a `Bvh` has them.
    """

    layout: Layout
    as_rows: bool = False

    @property
    def node(self) -> np.dtype:
        """The struct of a node."""
        return NODE if self.as_rows else self.layout.node


ROWS = TreeForm(LAYOUTS["bvh2"], as_rows=True)


class BuiltTree(NamedTuple):
    """A tree on a device.

    Attributes
    ----------
    nodes : buffer of (node_count,) structs of the layout
    prims : buffer of (block_count * block width,) int32
        The primitives of each block, see `WideTree.blocks`; of `bvh2` and of a `Bvh` its `prim_ids`.
    node_count, block_count : int
    stack_size : int
        Most entries on the stack of a traversal.
    lower, upper : (3,) float32
        The root's box.
    """

    nodes: Any
    prims: Any
    node_count: int
    block_count: int
    stack_size: int
    lower: NDArray[np.float32]
    upper: NDArray[np.float32]


def build_fast(shape: Bounded, options: BuildOptions, device: DeviceInfo | str | int | None = None) -> Bvh:
    """Build on a device and download the tree.

    Returns
    -------
    Bvh
        Its phases: "open", "upload", "sort", "merge", "place", "download". The first build of a process compiles or
        loads the kernels in "sort".

    Raises
    ------
    DeviceError
        There is no such device, or it has not enough memory.
    """
    watch = Stopwatch()
    try:
        session = open_session(shape, device)
    except DeviceError as error:
        if device is not None:
            raise
        raise DeviceError(f"{error}; the quality 'default' is built without a device") from error
    watch.lap("open")
    with session:

        def lap(phase: str) -> None:
            session.finish()
            watch.lap(phase)

        tree = build_tree_on(session, DevicePrims(session, session, cast(Shape, shape)), options, ROWS, lap)
        # Copied out of shared memory: 20 times as fast as a driver for CPUs fills new memory.
        with session.mapped(tree.nodes, tree.node_count, NODE, write=False) as mapped:
            nodes = mapped.copy()
        with session.mapped(tree.prims, tree.block_count, np.dtype(np.int32), write=False) as mapped:
            prim_ids = mapped.copy()
        watch.lap("download")
    return Bvh(nodes, prim_ids, shape, watch.laps_ms)


def build_tree_on(
    session: DeviceSession,
    prims: DevicePrims,
    options: BuildOptions,
    form: TreeForm,
    lap: Callable[[str], None] = lambda phase: None,
) -> BuiltTree:
    """Build a tree over primitives that are on the device.

    Parameters
    ----------
    session : DeviceSession
    prims : DevicePrims
    options : BuildOptions
        Its leaf size and its traversal cost. A block of a wide layout holds at most as many primitives as its width.
    form : TreeForm
    lap : function
        Called with the name of each phase when that is enqueued.

    Raises
    ------
    DeviceError
        The device has not enough memory: 180 bytes for each primitive besides the tree, or 80 for `bvh2`. Or it cuts
        long loops short.
    """
    if session.info.cuts_loops and (form.layout.is_wide or prims.shape.prim_count > TILE_SIZE):
        raise DeviceError(f"{session.info.name} cuts long loops short and builds wrong trees: take another device")
    lap("upload")
    build = _Build(session, prims, options, form)
    lap("sort")
    build.merge()
    lap("merge")
    tree = build.place()
    lap("place")
    return tree


class _Build:
    """One build, until its arrays are no longer needed."""

    def __init__(self, session: DeviceSession, prims: DevicePrims, options: BuildOptions, form: TreeForm) -> None:
        self._session, self._form = session, form
        self._passes: list[Pass] = plan_passes(prims.shape.prim_count)
        self._root = prims.shape.prim_count - 2 if prims.shape.prim_count > 1 else ~0
        is_grouped = session.info.kind == "gpu"
        self._merge_group = CLUSTER_GROUP if is_grouped else _TILE_GROUP
        self._kernels = session.kernels(
            "build_tree",
            {
                "TREE_WIDTH": form.layout.width,
                "AS_ROWS": int(form.as_rows),
                "GROUPED": int(is_grouped),
                "GROUP_SIZE": self._merge_group[0],
            },
        )
        merge_count = max(1, prims.shape.prim_count - 1)
        width, is_wide = form.layout.width, form.layout.is_wide
        self._tree = {
            "points": prims.points,
            "corners": prims.corners,
            "pairs": self._sort(prims),
            "merges": session.allocate(merge_count * MERGE.itemsize),
            "choices": session.allocate(merge_count * WIDE_CHOICES[width].itemsize) if is_wide else None,
            "is_node": session.allocate(merge_count),
            "placements": session.allocate(merge_count * PLACEMENT.itemsize),
            "leaf_size": np.int32(min(options.leaf_size, width) if is_wide else options.leaf_size),
            "traversal_cost": np.float32(options.traversal_cost),
            "block_price": block_price(prims.shape),
        }

    def _sort(self, prims: DevicePrims) -> Any:
        """Return the pairs of the primitives along the curve."""
        pairs = self._session.allocate(PAIR_BYTES * prims.shape.prim_count)
        steps = [(0, 0)] if prims.shape.prim_count <= _MOST_FOR_ONE_KEY else [(1, 0), (0, 1)]
        for is_fine, is_second in steps:
            self._session.run(
                self._kernels["make_keys"],
                (prims.shape.prim_count,),
                _PRIM_GROUP,
                points=prims.points,
                corners=prims.corners,
                pairs=pairs,
                prim_count=np.int32(prims.shape.prim_count),
                is_fine=np.int32(is_fine),
                is_second=np.int32(is_second),
            )
            pairs = sort_pairs(self._session, pairs, prims.shape.prim_count, _KEY_BITS)
        return pairs

    def merge(self) -> None:
        """Make the binary tree."""
        clusters = left_over = None
        for number, each in enumerate(self._passes):
            left_over = self._session.allocate(4 * each.tile_count * each.target)
            self._session.run(
                self._kernels["merge_tiles"],
                (each.tile_count * self._merge_group[0],),
                self._merge_group,
                **self._tree,
                **each.as_arguments(),
                clusters=clusters,
                left_over=left_over,
                is_first=np.int32(number == 0),
            )
            clusters = left_over

    def _run_tiles(self, name: str, passes: Iterable[Pass], **arguments: Any) -> None:
        """Run a kernel over the merges of passes, with one work-item for each tile."""
        group = _TILE_GROUP if self._session.info.kind == "cpu" else _PRIM_GROUP
        for each in passes:
            self._session.run(
                self._kernels[name], (each.tile_count,), group, **self._tree, **each.as_arguments(), **arguments
            )

    def place(self) -> BuiltTree:
        """Write the nodes, and the primitives of the leaves."""
        session, root = self._session, np.int32(self._root)
        if self._form.layout.is_wide:
            session.run(self._kernels["mark_root"], (1,), (1,), **self._tree, root=root)
            yes, no = np.int32(1), np.int32(0)
            self._run_tiles("visit_tiles", reversed(self._passes[1:]), marks=yes, counts=no)
            self._run_tiles("visit_tiles", self._passes[:1], marks=yes, counts=yes)
            self._run_tiles("visit_tiles", self._passes[1:], marks=no, counts=yes)
        summary_buffer = session.allocate(TREE_SUMMARY.itemsize)
        session.run(self._kernels["summarize"], (1,), (1,), **self._tree, root=root, summary=summary_buffer)
        summary = np.empty(1, TREE_SUMMARY)
        session.download(summary_buffer, summary)
        node_count, block_count = int(summary["node_count"][0]), int(summary["block_count"][0])
        node_count = 2 * node_count + 1 if self._form.as_rows else max(1, node_count)
        nodes = session.allocate(node_count * self._form.node.itemsize)
        prims = session.allocate(4 * block_count * self._form.layout.block_width)
        output = {"nodes": nodes, "prims": prims, "summary": summary_buffer}
        session.run(self._kernels["place_first"], (1,), (1,), **self._tree, **output, root=root)
        self._run_tiles("place_tiles", reversed(self._passes), **output)
        session.download(summary_buffer, summary)
        return BuiltTree(
            nodes,
            prims,
            node_count,
            block_count,
            int(summary["stack_size"][0]) + self._form.layout.entry_stack,
            summary["aabb_min"][0],
            summary["aabb_max"][0],
        )
