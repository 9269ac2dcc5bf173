"""The tree of one geometry, written on the device around primitives that have moved; its links stay the same.

The blocks first, then the nodes, level by level from the leaves. The result has the bytes that `layouts` would make of
the refitted tree, had it chosen the same wide nodes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...device.host.loops import Loops
from ...device.session import DeviceSession
from ...geometry import Shape
from ...layouts.device_prims import DevicePrims
from ...structs import BOX_LANES
from ...tree_layouts import LAYOUTS
from .tree_box import TreeBox
from .trees import DeviceTrees

_LOOPS = Loops("world/trees")

_WORK_GROUP = (64,)

# Upper levels with up to this many nodes in all are written by one work-item: a node takes a CPU 0.1 us and a GPU some
# microseconds, a launch tens of them.
_SERIAL_NODES = {"cpu": 512, "gpu": 8}


class Refit:
    """Writes the tree of one geometry, for one shape after the other.

    Parameters
    ----------
    trees : DeviceTrees
    geometry_id : int
    prims : DevicePrims
        The shape that the tree was built over; `write` puts other ones there.
    session : DeviceSession
        A branch of the owner's, for this thread.

    Attributes
    ----------
    prims : DevicePrims
    built : Mesh or Spheres
        The shape that the tree was built over.
    sah_cost : float
        The expected number of nodes and blocks that a random ray through the root's box meets, as the tree was last
        written; see `sah_cost` in `bvh/bvh.py`. 0 before that.
    built_cost : float
        The same of the tree that was built.
    """

    def __init__(self, trees: DeviceTrees, geometry_id: int, prims: DevicePrims, session: DeviceSession) -> None:
        self.prims, self.built, self.sah_cost, self.built_cost = prims, prims.shape, 0.0, 0.0
        owner, self._tree = trees.session, trees.trees[geometry_id]
        self._layout = LAYOUTS[trees.layout]
        nodes, blocks = trees.download(session, geometry_id)
        levels = find_levels(list_children(nodes))
        order = np.argsort(levels, kind="stable").astype(np.int32)
        self._launches = _plan_launches(np.bincount(levels), owner.info.kind)
        self._order, self._prim_ids = owner.upload(order), owner.upload(blocks["prim_id"])
        self._block_boxes = owner.allocate(self._tree.block_count * BOX_LANES * 4)
        self._node_boxes = owner.allocate(self._tree.node_count * BOX_LANES * 4)

    @property
    def memory_bytes(self) -> int:
        """Bytes of its buffers."""
        own = self._order, self._prim_ids, self._block_boxes, self._node_boxes
        return sum(buffer.size for buffer in own)

    def write(self, before: DeviceTrees, moved: DeviceTrees, geometry_id: int, shape: Shape, session: Any) -> TreeBox:
        """Write the tree for a shape, and return the box around it.

        Parameters
        ----------
        before, moved : DeviceTrees
            Those with the links, and those to write, in which the tree has the same size.
        geometry_id : int
        shape : Mesh or Spheres
        session : DeviceSession
            A branch of the owner's, for this thread.
        """
        if self.built_cost == 0.0:
            # Only those who move a geometry ask how the cost has grown.
            self._write(before, moved, geometry_id, session)
            self.built_cost = self.sah_cost
        self.prims.put(session, shape)
        return TreeBox(shape.origin, shape.scale, self._write(before, moved, geometry_id, session))

    def _write(
        self, before: DeviceTrees, moved: DeviceTrees, geometry_id: int, session: DeviceSession
    ) -> NDArray[np.float64]:
        """Write the tree, and return half the size of the box around it that is symmetric about zero."""
        tree = moved.trees[geometry_id]
        blocks = moved.buffers[moved.block_buffer(geometry_id)]
        self.prims.write_blocks(
            session, self._layout.block_width, self._prim_ids, tree.block_count, blocks, first_block=tree.first_block,
            boxes=self._block_boxes,
        )  # fmt: skip
        kernel = session.kernel("refit_nodes", {"TREE_WIDTH": self._layout.width})
        for begin, end, item_count in self._launches:
            session.run(
                kernel, (item_count,), _WORK_GROUP if item_count > 1 else (1,),
                order=self._order, begin=np.int32(begin), end=np.int32(end), links=before.buffers["nodes"],
                first_link=np.int32(before.trees[geometry_id].first_node), nodes=moved.buffers["nodes"],
                first_node=np.int32(tree.first_node), block_boxes=self._block_boxes, node_boxes=self._node_boxes,
            )  # fmt: skip
        lanes = tree.node_count * BOX_LANES
        with session.mapped(self._node_boxes, lanes, np.dtype(np.float32), write=False) as boxes:
            rows = boxes.reshape(-1, BOX_LANES)
            area, root = float(rows[:, 3].sum(dtype=np.float64)), rows[0].astype(np.float64)
        x, y, z = root[4:7] - root[:3]
        root_area = x * y + y * z + z * x
        # A tree in one point: a ray there meets everything.
        self.sah_cost = 1.0 + area / root_area if root_area > 0.0 else float(tree.node_count + tree.block_count)
        return np.maximum(abs(root[:3]), abs(root[4:7]))


def _plan_launches(level_sizes: NDArray[np.integer], kind: str) -> list[tuple[int, int, int]]:
    """Return where each launch of the kernel begins and ends in the order of the nodes, and its work-items."""
    launches: list[tuple[int, int, int]] = []
    begin, total = 0, int(level_sizes.sum())
    for size in level_sizes.tolist():
        if total - begin <= _SERIAL_NODES.get(kind, 1):
            return [*launches, (begin, total, 1)]
        launches.append((begin, begin + size, size))
        begin += size
    return launches


def list_children(nodes: NDArray[np.void]) -> NDArray[np.int32]:
    """Return the nodes below each node of a device's tree, (N, width), with 0 in place of leaves and missing ones."""
    if "child" in (nodes.dtype.names or ()):
        return np.maximum(nodes["child"], 0)
    is_node = (nodes["count"] == 0) & (nodes["aabb_min"][:, :, 0] <= nodes["aabb_max"][:, :, 0])
    return np.where(is_node, nodes["first"], 0)


def find_levels(children: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return how far the farthest leaf is below each node, (N,) int64; children stand behind their parent."""
    levels = np.empty(len(children), np.int64)
    _LOOPS.find_levels(levels, children.shape[1], children)
    return levels
