"""The layouts `bvh4` and `bvh8`: up to four or eight children per node, and leaves that fill a block of triangles.

Owns the nodes and the lists of the triangles in the blocks; `leaf_blocks.py` gathers the corners.

The nodes are the cheapest ones that the binary tree contains, by dynamic programming over the whole tree, bottom-up
(Wald, Benthin and Boulos, "Getting rid of packets", 2008; Ylitie, Karras and Laine, "Efficient incoherent ray traversal
on GPUs through compressed wide BVHs", 2017). A block costs the same however many triangles it holds, so whole subtrees
become one leaf, whatever leaf size the binary tree was built with. Leaves with more triangles than a block holds become
subtrees whose leaves fill blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bvh.bvh import Bvh
from ..device.host.loops import Loops
from ..geometry import Mesh
from ..geometry.spheres import Bounded
from ..structs import NODE
from ..support.host_threads import HostThreads
from ..tree_layouts import wide_node

# Subtrees for each thread: they are of different sizes. And the least nodes that are worth a subtree: of the dragon's
# binary tree, 10,000 take 0.2 ms.
_SUBTREES_OF_THREAD = 16
_LEAST_NODES = 1 << 13

LOOPS = Loops("layouts/wide")


class WideTree(NamedTuple):
    """The nodes of a wide tree, and the primitives in each of its leaves.

    Attributes
    ----------
    nodes : (N,) `wide_node(width)`
        Node 0 is the root; children stand behind their parent, siblings together.
    blocks : (G, width) int32
        Primitives in each leaf's block, `NO_PRIM` in the lanes that are left over.
    stack_size : int
        Most entries on the stack of a traversal.
    """

    nodes: NDArray[np.void]
    blocks: NDArray[np.int32]
    stack_size: int


def widen(bvh: Bvh, width: int, threads: HostThreads) -> WideTree:
    """Return the wide tree that a ray traverses fastest, of those that the binary tree contains.

    Parameters
    ----------
    bvh : Bvh
        With leaves of any size.
    width : int
        Most children of a node, and most primitives of a leaf: 4 or 8.
    threads : HostThreads

    Notes
    -----
    O(nodes). The same tree gives the same bytes, whatever the number of threads.
    """
    nodes = split_leaves(bvh, width)
    shares = _choose_children(nodes, width, block_price(bvh.shape), threads)
    tree, count = (nodes, shares, bvh.prim_ids, width), len(nodes)

    # The top comes first: the sizes of the subtrees say where each of them begins. A small tree is one subtree.
    subtrees = min(_SUBTREES_OF_THREAD * threads.count, count // _LEAST_NODES)
    roots, top_size = np.zeros(1, np.int32), np.zeros(2, np.int32)
    if subtrees > 1:
        pending = np.empty(count, np.int32)
        end = LOOPS.cut_tree(nodes, shares, width, subtrees, pending, top_size)
        roots = np.sort(pending[top_size[0] : end])
    sizes = np.empty((len(roots), 2), np.int32)
    threads.run(
        lambda root, size: LOOPS.count_subtree(nodes, shares, width, root, np.empty(count, np.int32), size),
        list(zip(roots.tolist(), sizes, strict=True)),
    )
    node_count, block_count = (top_size + sizes.sum(axis=0)).tolist()
    wide_nodes, blocks = np.empty(node_count, wide_node(width)), np.empty((block_count, width), np.int32)
    output = wide_nodes.view(np.float32), blocks

    def write(start: NDArray[np.int32], *cuts: NDArray[np.int32]) -> int:
        return LOOPS.write_nodes(*tree, start, *cuts, np.empty((count, 3), np.int32), *output)

    starts, stack_size = _ROOT_START[None], 0
    if subtrees > 1:
        starts = np.empty((len(roots), len(_ROOT_START)), np.int32)
        stack_size = write(_ROOT_START, roots, sizes, starts)
    return WideTree(
        wide_nodes, blocks, max([stack_size, *threads.run(write, [(start, *_NO_CUTS) for start in starts])])
    )


# Where a subtree of the wide tree begins: its binary node, its wide node, the next wide node and the next block, and
# the entries on the stack above it.
_ROOT_START = np.array([0, 0, 1, 0, 0], np.int32)

# Of a subtree that is not cut any more: no roots in it, their sizes, and where they start.
_NO_CUTS = np.empty(0, np.int32), np.empty((0, 2), np.int32), np.empty((0, len(_ROOT_START)), np.int32)


# The price of a block's memory besides its test, which costs as much as a node step: as the area of this many average
# nodes, if a tree had one for each primitive. Blocks of spheres are as fast with four times the price, and with a
# quarter.
_BLOCK_PRICE = 20.0

# Faces whose boxes tell the area of an average node, where that around the mesh does not.
_SAMPLED_FACES = 1 << 12


def block_price(shape: Bounded) -> np.float32:
    """Return what a block costs besides its area, in units of that: for trees over this shape."""
    return np.float32(block_prices([shape])[0])


def block_prices(shapes: Sequence[Bounded]) -> NDArray[np.float32]:
    """Return the `block_price` of each shape."""
    boxes = np.array([shape.local_box for shape in shapes], np.float64)
    counts = np.array([shape.prim_count for shape in shapes])
    prices = _half_areas(boxes[:, 1] - boxes[:, 0]) / counts
    for number, shape in enumerate(shapes):
        if isinstance(shape, Mesh) and shape.spans_scales:
            # The box would make blocks so dear that no areas beside it mattered.
            corners = shape.local_vertices[shape.faces[:: 1 + shape.face_count // _SAMPLED_FACES]].astype(np.float64)
            prices[number] = np.median(_half_areas(np.ptp(corners, axis=1)))
    return (_BLOCK_PRICE * prices).astype(np.float32)


def _half_areas(extents: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z = extents.T
    return x * y + y * z + z * x


def _choose_children(
    nodes: NDArray[np.void], width: int, block_price: np.float32, threads: HostThreads
) -> NDArray[np.uint32]:
    """Find the cheapest way to represent each subtree by 1, 2, ... children of a wide node: return all shares."""
    count = len(nodes)
    shares = np.empty(count, np.uint32)
    scratch = np.empty((count, width), np.float32), np.zeros(count, np.uint8), np.empty(count, np.uint8)

    def choose(begin: int, end: int) -> None:
        LOOPS.choose_range(nodes, width, block_price, begin, end, *scratch, shares)

    ranges = threads.ranges(count, _LEAST_NODES)
    threads.run(choose, ranges)
    if len(ranges) > 1:
        # In a depth-first order few subtrees lie across the ends of ranges. They come last.
        choose(0, count)
    return shares


def split_leaves(bvh: Bvh, leaf_size: int) -> NDArray[np.void]:
    """Return the nodes of a tree whose leaves have at most `leaf_size` triangles.

    Parameters
    ----------
    bvh : Bvh
        The order of its primitives is kept: all but the last new leaf of each old one are full.
    leaf_size : int

    Returns
    -------
    (N,) `structs.NODE`
        Siblings are neighbours and lie behind their parent; the order is not depth-first.
    """
    nodes = np.ascontiguousarray(bvh.nodes)
    counts = nodes["count"]
    leaf_counts = -(-counts[counts > leaf_size].astype(np.int64) // leaf_size)
    if len(leaf_counts) == 0:
        return nodes
    grown = np.empty(len(nodes) + int((2 * (leaf_counts - 1)).sum()), NODE)
    LOOPS.split_leaves(nodes, leaf_size, bvh.prim_ids, *bvh.shape.find_corners(), grown)
    return grown
