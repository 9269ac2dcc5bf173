"""The device arrays of a tree whose vertices or spheres have moved, written around its topology: what stays the same.

The leaves first, in several threads, then the nodes from the last to the first. The result has the bytes that
`device_arrays.py` would make of the refitted tree, had it chosen the same wide nodes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh, Shape
from ..geometry.boxes import empty_box, half_area, lane_of, load_box, load_point, store_box, unite
from ..structs import BOX_LANES, BOX_NEGATED_MAX, LAYOUT_WIDTHS, NO_PRIM
from ..support.compiled import compiled
from ..support.host_threads import HostThreads, cut_range
from ..support.loop_functions import prefetch
from .leaf_blocks import write_sphere_leaves

# Lanes of a triangle's corners in a block; its face comes behind them.
_CORNER_LANES = 9

# Primitives per task of a thread: small, so that a thread that waits for a processor delays the others little. An
# update of 99,900 triangles takes 2.2 to 2.8 ms, 2.9 to 3.5 ms with twice as many, 2.8 ms with half (2-core x86-64
# server).
_PRIMS_PER_PART = 1 << 13

# A missing child has an inverted box, from the greatest number to the least, which no ray hits.
_GREATEST = np.finfo(np.float32).max

# Prefetch distances in triangles, those of `bvh/refit.py`.
_FACES_AHEAD = 32
_VERTICES_AHEAD = 16


class RefitArrays:
    """Writes the device arrays of one tree, for one mesh or group of spheres after the other; one thread at a time.

    Parameters
    ----------
    topology : Topology

    Attributes
    ----------
    topology : Topology
    half : (3,) float64, local coordinates
        Half the size along each axis of the box around the tree, symmetric about zero, as it was last written.
    sah_cost : float
        Cost of the tree as it was last written: the expected number of nodes and blocks that a random ray through the
        root's box meets, see `bvh/bvh.py`. The number of all of them if the root's area is zero.
    """

    def __init__(self, topology: Topology) -> None:
        self.topology = topology
        self.half = np.zeros(3)
        self.sah_cost = 0.0
        self._leaf_boxes = np.empty((len(topology.leaves), BOX_LANES), np.float32)
        self._node_boxes = np.empty((len(topology.children), BOX_LANES), np.float32)

    def write(self, shape: Shape, nodes: NDArray[np.void], blocks: NDArray[np.void], threads: HostThreads) -> None:
        """Write the arrays for a shape; they are not read, so they may be memory of the device.

        Parameters
        ----------
        shape : Mesh or Spheres
            A mesh with the faces of the tree's, or as many spheres as the tree has.
        nodes, blocks : arrays of structs, contiguous, written
            As long as those that the topology was read from.
        threads : HostThreads

        Notes
        -----
        O(nodes + primitives). The same bytes, and the same cost, for any number of threads.
        """
        topology = self.topology
        lanes = blocks.view(np.float32).reshape(len(blocks), -1)

        def write_leaves(begin: int, end: int) -> None:
            leaves, boxes = topology.leaves[begin:end], self._leaf_boxes[begin:end]
            written = leaves, topology.prims, lanes, lanes.view(np.int32), boxes
            if isinstance(shape, Mesh):
                _write_leaves(shape.local_vertices, shape.faces, *written)
            else:
                write_sphere_leaves(shape.local_centres, shape.local_radii, *written)

        threads.run(write_leaves, cut_range(0, len(topology.leaves), -(-shape.prim_count // _PRIMS_PER_PART)))
        lanes = nodes.view(np.float32).reshape(len(nodes), -1)
        area = _write_nodes(topology, self._leaf_boxes, self._node_boxes, lanes, lanes.view(np.int32))
        self._note_root(area)

    def _note_root(self, area: float) -> None:
        """Set `half` and `sah_cost`, given the sum of the areas below the root."""
        least, negated_most = (self._node_boxes[0, lane : lane + 3].astype(np.float64) for lane in (0, BOX_NEGATED_MAX))
        self.half = np.maximum(np.abs(least), np.abs(negated_most))
        x, y, z = -negated_most - least
        root_area = x * y + y * z + z * x
        block_count = int((self.topology.leaves[:, 1] - self.topology.leaves[:, 0]).sum())
        everything = len(self.topology.children) + block_count
        self.sah_cost = 1.0 + area / root_area if root_area > 0.0 else everything


@compiled
def _write_leaves(vertices, faces, leaves, prims, lanes, lane_ints, boxes):
    """Write the triangles of each leaf, and the box around them."""
    width = prims.shape[1]
    faces_ahead, vertices_ahead = _FACES_AHEAD // width, _VERTICES_AHEAD // width
    nan = np.float32(np.nan)
    for leaf in range(len(leaves)):
        box = empty_box()
        for block in range(leaves[leaf, 0], leaves[leaf, 1]):
            for slot in range(width):
                prim = prims[block, slot]
                lane_ints[block, _CORNER_LANES * width + slot] = prim
                prefetch(faces, 3 * prims[min(block + faces_ahead, len(prims) - 1), slot])
                coming = max(prims[min(block + vertices_ahead, len(prims) - 1), slot], 0)
                for corner in range(3):
                    prefetch(vertices, 3 * faces[coming, corner])
                if prim == NO_PRIM:
                    for lane in range(_CORNER_LANES):
                        lanes[block, lane * width + slot] = nan
                    continue
                a, b, c = faces[prim, 0], faces[prim, 1], faces[prim, 2]
                box = unite(
                    load_point(vertices, c), unite(load_point(vertices, b), unite(load_point(vertices, a), box))
                )
                ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
                bx, by, bz = vertices[b, 0], vertices[b, 1], vertices[b, 2]
                cx, cy, cz = vertices[c, 0], vertices[c, 1], vertices[c, 2]

                # Degenerate triangles, by the rule of `Mesh.degenerate_faces`, are stored as `leaf_blocks.py` does.
                ux, uy, uz = np.float64(bx) - ax, np.float64(by) - ay, np.float64(bz) - az
                vx, vy, vz = np.float64(cx) - ax, np.float64(cy) - ay, np.float64(cz) - az
                if uy * vz == uz * vy and uz * vx == ux * vz and ux * vy == uy * vx:
                    if width > 1:
                        ax, ay, az = nan, nan, nan
                    bx, by, bz = ax, ay, az
                    cx, cy, cz = ax, ay, az

                lanes[block, slot] = ax
                lanes[block, width + slot] = ay
                lanes[block, 2 * width + slot] = az
                lanes[block, 3 * width + slot] = bx
                lanes[block, 4 * width + slot] = by
                lanes[block, 5 * width + slot] = bz
                lanes[block, 6 * width + slot] = cx
                lanes[block, 7 * width + slot] = cy
                lanes[block, 8 * width + slot] = cz
        store_box(boxes, leaf, box)


@compiled
def _write_nodes(topology, leaf_boxes, node_boxes, lanes, lane_ints):
    """Write the nodes, the last one first; return the sum of half areas of the boxes that a ray may be tested with."""
    children, links, leaves = topology.children, topology.links, topology.leaves
    width = children.shape[1]
    # Wide nodes have one coordinate of all children side by side, others all coordinates of one child.
    slot_stride, axis_stride = (1, width) if topology.prims.shape[1] > 1 else (3, 1)
    first_max, first_link = BOX_LANES_OF_CHILD // 2 * width, BOX_LANES_OF_CHILD * width
    zero = np.float32(0.0)
    area = 0.0
    for node in range(len(children) - 1, -1, -1):
        around_all = empty_box()
        for slot in range(width):
            child = children[node, slot]
            x = slot * slot_stride
            y, z = x + axis_stride, x + 2 * axis_stride
            if child == NO_CHILD:
                lanes[node, x], lanes[node, y], lanes[node, z] = _GREATEST, _GREATEST, _GREATEST
                lanes[node, first_max + x] = -_GREATEST
                lanes[node, first_max + y] = -_GREATEST
                lanes[node, first_max + z] = -_GREATEST
                continue
            if child > 0:
                box = load_box(node_boxes, child)
                area += half_area(box)
            else:
                box = load_box(leaf_boxes, ~child)
                area += half_area(box) * (leaves[~child, 1] - leaves[~child, 0])
            around_all = unite(box, around_all)
            lanes[node, x], lanes[node, y], lanes[node, z] = lane_of(box, 0), lane_of(box, 1), lane_of(box, 2)
            # Subtracted from 0 instead of negated, which could make -0.0.
            lanes[node, first_max + x] = zero - lane_of(box, BOX_NEGATED_MAX)
            lanes[node, first_max + y] = zero - lane_of(box, BOX_NEGATED_MAX + 1)
            lanes[node, first_max + z] = zero - lane_of(box, BOX_NEGATED_MAX + 2)
        for link in range(links.shape[1]):
            lane_ints[node, first_link + link] = links[node, link]
        store_box(node_boxes, node, around_all)
    return area


# A child that a node does not have.
NO_CHILD = np.iinfo(np.int32).min

# Lanes of one child's box in a node. Links come behind them; the primitives of a block are its last lanes.
BOX_LANES_OF_CHILD = 6


class Topology(NamedTuple):
    """The links of a tree on a device, and the primitives of its leaves.

    Attributes
    ----------
    children : (N, width) int32
        Index of a node behind this one, ``~leaf``, or `NO_CHILD`.
    links : (N, k) int32
        The lanes of each node behind its boxes, as the device has them.
    leaves : (L, 2) int32
        Begin and end of each leaf's blocks. A leaf of the wide layouts is one block.
    prims : (B, block width) int32
        Faces of the mesh, or spheres, in each block, `NO_PRIM` in the lanes that are left over.
    """

    children: NDArray[np.int32]
    links: NDArray[np.int32]
    leaves: NDArray[np.int32]
    prims: NDArray[np.int32]


def read_topology(nodes: NDArray[np.void], blocks: NDArray[np.void], layout: str) -> Topology:
    """Return the topology of device arrays; it shares no memory with them.

    Parameters
    ----------
    nodes, blocks : arrays of structs
        See `DeviceArrays`; not changed.
    layout : str
        One of `structs.LAYOUT_WIDTHS`.
    """
    width = LAYOUT_WIDTHS[layout]
    block_width = 1 if width == 2 else width
    links = _lanes(nodes)[:, BOX_LANES_OF_CHILD * width :].copy()
    prims = _lanes(blocks)[:, -block_width:].copy()
    least, most = nodes["aabb_min"], nodes["aabb_max"]
    if block_width == 1:
        first, count = np.hsplit(links, 2)
        is_missing = least[:, :, 0] > most[:, :, 0]
        is_leaf = (count > 0) & ~is_missing
        children, begins, counts = first.copy(), first[is_leaf], count[is_leaf]
        children[is_leaf] = ~np.arange(len(begins), dtype=np.int32)
    else:
        is_missing = least[:, 0] > most[:, 0]
        children, begins, counts = links.copy(), np.arange(len(prims), dtype=np.int32), np.ones(len(prims), np.int32)
    # A missing child has an inverted box.
    children[is_missing] = NO_CHILD
    leaves = np.stack((begins, begins + counts), axis=1)
    return Topology(children, links, leaves, prims)


def _lanes(structs: NDArray[np.void]) -> NDArray[np.int32]:
    """Return structs as rows of 4-byte lanes."""
    return structs.view(np.int32).reshape(len(structs), -1)
