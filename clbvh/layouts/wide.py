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
from ..geometry import Mesh
from ..geometry.corners import Bounded, find_corners
from ..structs import NO_PRIM, NODE_COUNT, NODE_FIRST, NODE_LANES, NODE_MAX, WIDE_NODES
from ..support.compiled import compiled
from ..support.host_threads import HostThreads

# Subtrees for each thread: they are of different sizes. And the least nodes that are worth a subtree: of the dragon's
# binary tree, 10,000 take 0.2 ms.
_SUBTREES_OF_THREAD = 16
_LEAST_NODES = 1 << 13

_FIRST_STACK_SIZE = 256

# More primitives than a block has.
_MANY = 100


class WideTree(NamedTuple):
    """The nodes of a wide tree, and the primitives in each of its leaves.

    Attributes
    ----------
    nodes : (N,) `structs.WIDE_NODES[width]`
        Node 0 is the root; children stand behind their parent, siblings together.
    blocks : (G, width) int32
        Primitives in each leaf's block, `NO_PRIM` in the lanes that are left over.
    stack_size : int
        Most entries on the stack of a traversal.
    """

    nodes: NDArray[np.void]
    blocks: NDArray[np.int32]
    stack_size: int


class BinaryTree(NamedTuple):
    """A binary tree whose leaves fit a block, and what becomes of it.

    Attributes
    ----------
    nodes, node_ints : (N, 8) float32 and int32, the same memory
        Lanes of `structs.NODE`.
    prim_ids : (n,) int32
    width : int
        Most children of a wide node, and most primitives of a leaf.
    shares : (N,) uint32
        Of a node that becomes at most i children of a wide node, its bits 4 (i - 1) to 4 i - 1 are the left half's
        share; 0 where i - 1 children are as cheap. For i = 1, that of a wide node's own children; 0 for a leaf.
    """

    nodes: NDArray[np.float32]
    node_ints: NDArray[np.int32]
    prim_ids: NDArray[np.int32]
    width: int
    shares: NDArray[np.uint32]


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
    tree = BinaryTree(nodes, nodes.view(np.int32), bvh.prim_ids, width, np.empty(len(nodes), np.uint32))
    subtrees = max(1, min(_SUBTREES_OF_THREAD * threads.count, len(nodes) // _LEAST_NODES))
    _choose_children(tree, block_price(bvh.shape), threads)

    # The top comes first: the sizes of the subtrees say where each of them begins.
    roots, *top_size = _cut_wide(tree, subtrees)
    roots.sort()  # here: numba takes 1.2 s to compile it
    sizes = np.array(threads.run(count_subtree, [(tree, root) for root in roots.tolist()]), np.int32).reshape(-1, 2)
    node_count, block_count = np.sum(sizes, axis=0) + top_size
    wide_nodes, blocks = np.empty(node_count, WIDE_NODES[width]), np.empty((block_count, width), np.int32)
    lanes = wide_nodes.view(np.float32).reshape(node_count, -1)
    output = lanes, lanes.view(np.int32), blocks
    starts = np.empty((len(roots), len(ROOT_START)), np.int32)
    stack_size = write_nodes(tree, ROOT_START, roots, sizes, starts, *output)
    stack_sizes = threads.run(write_nodes, [(tree, start, *NO_STARTS, *output) for start in starts])
    return WideTree(wide_nodes, blocks, max([stack_size, *stack_sizes]))


# Where a subtree of the wide tree begins: its binary node, its wide node, the next wide node and the next block, and
# the entries on the stack above it.
ROOT_START = np.array([0, 0, 1, 0, 0], np.int32)

# Of a subtree that is not cut any more: no roots in it, their sizes, and where they start.
NO_STARTS = np.empty(0, np.int32), np.empty((0, 2), np.int32), np.empty((0, len(ROOT_START)), np.int32)


@compiled
def _cut_wide(tree, count):
    """Return the binary nodes of up to `count` subtrees of the wide tree, and the numbers of nodes and blocks above."""
    pending = np.empty(count + tree.width, np.int32)
    children, stack = np.empty(tree.width, np.int32), np.empty((tree.width + 1, 2), np.int32)
    pending[0] = 0
    first, end, node_count, block_count = 0, 1, 0, 0
    while first < end and end - first < count:
        # Level by level: a round list would do, but few nodes are moved.
        node = pending[first]
        for index in range(first + 1, end):
            pending[index - 1] = pending[index]
        end -= 1
        node_count += 1
        for child in children[: list_children(tree, node, stack, children)]:
            if is_leaf(tree, child):
                block_count += 1
            else:
                pending[end] = child
                end += 1
    return pending[:end], node_count, block_count


@compiled
def count_subtree(tree, root):
    """Return the numbers of nodes and blocks of a subtree of the wide tree."""
    pending = np.empty(_FIRST_STACK_SIZE, np.int32)
    children, stack = np.empty(tree.width, np.int32), np.empty((tree.width + 1, 2), np.int32)
    pending[0] = root
    pending_count, node_count, block_count = 1, 0, 0
    while pending_count > 0:
        pending_count -= 1
        node_count += 1
        child_count = list_children(tree, pending[pending_count], stack, children)
        if pending_count + tree.width > len(pending):
            pending = np.concatenate((pending, np.empty_like(pending)))
        for slot in range(child_count):
            if is_leaf(tree, children[slot]):
                block_count += 1
            else:
                pending[pending_count] = children[slot]
                pending_count += 1
    return node_count, block_count


@compiled
def write_nodes(tree, start, roots, sizes, starts, wide_nodes, wide_ints, blocks):
    """Write the wide nodes and the blocks from a node down to some subtrees.

    Parameters
    ----------
    tree : BinaryTree
    start : (5,) int32
        See `ROOT_START`.
    roots : (k,) int32, ascending
        Binary nodes of subtrees that are left out.
    sizes : (k, 2) int32
        Their numbers of nodes and blocks.
    starts : (k, 5) int32, written
    wide_nodes, wide_ints : (N, 7 width) float32 and int32, the same memory, written
    blocks : (G, width) int32, written

    Returns
    -------
    int
        Most entries on the stack of a traversal.
    """
    width = tree.width
    greatest = np.finfo(np.float32).max
    # Lanes: three coordinates of the minimum, three of the maximum, then the children.
    first_max, first_child = 3 * width, 6 * width
    # Binary nodes, the wide nodes that they become, and the entries on the stack above them.
    pending = np.empty((_FIRST_STACK_SIZE, 3), np.int32)
    children, stack = np.empty(width, np.int32), np.empty((width + 1, 2), np.int32)
    pending[0, 0], pending[0, 1], pending[0, 2] = start[0], start[1], start[4]
    next_node, next_block = start[2], start[3]
    pending_count, stack_size = 1, 0
    while pending_count > 0:
        pending_count -= 1
        source, target = pending[pending_count, 0], pending[pending_count, 1]
        on_stack = pending[pending_count, 2]
        root = np.searchsorted(roots, source)
        if root < len(roots) and roots[root] == source:
            starts[root, 0], starts[root, 1], starts[root, 2] = source, target, next_node
            starts[root, 3], starts[root, 4] = next_block, on_stack
            next_node += sizes[root, 0] - 1
            next_block += sizes[root, 1]
            continue
        child_count = list_children(tree, source, stack, children)
        # While a child is visited, its siblings and those of all its ancestors are on the stack.
        on_stack += child_count - 1
        stack_size = max(stack_size, on_stack)
        if pending_count + width > len(pending):
            pending = np.concatenate((pending, np.empty_like(pending)))
        for slot in range(width):
            # A missing child has an inverted box.
            for axis in range(3):
                wide_nodes[target, axis * width + slot] = greatest
                wide_nodes[target, first_max + axis * width + slot] = -greatest
            wide_ints[target, first_child + slot] = 0
            if slot >= child_count:
                continue
            child = children[slot]
            for axis in range(3):
                wide_nodes[target, axis * width + slot] = tree.nodes[child, axis]
                wide_nodes[target, first_max + axis * width + slot] = tree.nodes[child, NODE_MAX + axis]
            if is_leaf(tree, child):
                wide_ints[target, first_child + slot] = ~next_block
                _list_prims(tree.node_ints, tree.prim_ids, child, stack, blocks[next_block])
                next_block += 1
            else:
                wide_ints[target, first_child + slot] = next_node
                pending[pending_count, 0], pending[pending_count, 1] = child, next_node
                pending[pending_count, 2] = on_stack
                pending_count += 1
                next_node += 1
    return stack_size


@compiled(is_inlined=True)
def _list_prims(node_ints, prim_ids, top, stack, prims):
    """Write the primitives of a small subtree in the tree's order, and `NO_PRIM` behind them."""
    stack[0, 0] = top
    stack_size = 1
    count = 0
    while stack_size > 0:
        stack_size -= 1
        node = stack[stack_size, 0]
        first = node_ints[node, NODE_FIRST]
        if node_ints[node, NODE_COUNT] == 0:
            stack[stack_size, 0], stack[stack_size + 1, 0] = first + 1, first
            stack_size += 2
        else:
            for index in range(first, first + node_ints[node, NODE_COUNT]):
                prims[count] = prim_ids[index]
                count += 1
    prims[count:] = NO_PRIM


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


def _choose_children(tree: BinaryTree, block_price: np.float32, threads: HostThreads) -> None:
    """Find the cheapest way to represent each subtree by 1, 2, ... children of a wide node: write `tree.shares`."""
    count = len(tree.nodes)
    costs, most, prim_counts = (
        np.empty((count, tree.width), np.float32),
        np.zeros(count, np.int8),
        np.empty(count, np.int8),
    )
    rows = costs, most, prim_counts
    # In a depth-first order few subtrees lie across the ends of ranges. They come last.
    threads.for_ranges(
        count, lambda begin, end: choose_range(tree, block_price, begin, end, *rows), least_items=_LEAST_NODES
    )
    choose_range(tree, block_price, 0, count, *rows)


@compiled
def choose_range(tree, block_price, begin, end, costs, most, prim_counts):
    """Choose for the nodes of a range whose subtrees lie in it, except for those for which it is done.

    Parameters
    ----------
    tree : BinaryTree
        Written: shares.
    block_price : float32
        See `block_price`.
    begin, end : int
    costs : (N, width) float32, written
        In column i - 1 the cost as at most i children, for i up to `most`.
    most : (N,) int8, written
        The number of leaves of the subtree, or `width`; 0 where nothing is chosen.
    prim_counts : (N,) int8, written
        Primitives of the subtree, or `_MANY`.
    """
    # In float32, as a device computes that builds trees, see cl/tree/choose.cl.
    for node in range(end - 1, begin - 1, -1):
        if most[node] > 0:
            continue
        area = _half_area(tree.nodes, node)
        leaf_cost = area + block_price
        if tree.node_ints[node, NODE_COUNT] > 0:
            most[node], prim_counts[node] = 1, tree.node_ints[node, NODE_COUNT]
            costs[node, 0], tree.shares[node] = leaf_cost, 0
            continue
        left = tree.node_ints[node, NODE_FIRST]
        right = left + 1
        if right >= end or most[left] == 0 or most[right] == 0:
            continue
        prim_count = min(_MANY, prim_counts[left] + prim_counts[right])
        left_most, right_most = most[left], most[right]
        own_most = min(left_most + right_most, tree.width)
        shares = np.uint32(0)
        for children in range(2, own_most + 1):
            cheapest, share = np.float32(np.inf), 0
            for left_children in range(1, min(children - 1, left_most) + 1):
                cost = costs[left, left_children - 1] + costs[right, min(children - left_children, right_most) - 1]
                if cost < cheapest:
                    cheapest, share = cost, left_children
            costs[node, children - 1] = cheapest
            shares |= np.uint32(share) << np.uint32(4 * (children - 1))

        # As one child: a wide node with the cheapest number of children, or a leaf.
        costs[node, 0] = costs[node, own_most - 1] + area
        if prim_count <= tree.width and leaf_cost <= costs[node, 0]:
            costs[node, 0] = leaf_cost
        else:
            shares |= share_of(shares, own_most)
        for children in range(2, own_most + 1):
            if costs[node, children - 2] <= costs[node, children - 1]:
                costs[node, children - 1] = costs[node, children - 2]
                shares &= ~(np.uint32(15) << np.uint32(4 * (children - 1)))
        most[node], prim_counts[node], tree.shares[node] = own_most, prim_count, shares


@compiled(is_inlined=True)
def share_of(shares, children):
    """Return the left half's share of a number of children; see `BinaryTree`."""
    return shares >> np.uint32(4 * (children - 1)) & np.uint32(15)


@compiled(is_inlined=True)
def is_leaf(tree, node):
    """Return whether a node becomes a leaf where it is one child."""
    return tree.shares[node] & np.uint32(15) == 0


@compiled(is_inlined=True)
def _half_area(nodes, node):
    x = nodes[node, NODE_MAX] - nodes[node, 0]
    y = nodes[node, NODE_MAX + 1] - nodes[node, 1]
    z = nodes[node, NODE_MAX + 2] - nodes[node, 2]
    return x * y + y * z + z * x


@compiled(is_inlined=True)
def list_children(tree, node, stack, children):
    """Write the binary nodes that become the children of a wide node, and return their number.

    Parameters
    ----------
    tree : BinaryTree
    node : int
        The binary node that the wide node stands for.
    stack : (width + 1, 2) int32, scratch
        Nodes and their shares of the children.
    children : (width,) int32, written
    """
    left_children = np.int32(share_of(tree.shares[node], 1))
    if left_children == 0:
        # The whole tree is one leaf.
        children[0] = node
        return 1
    first = tree.node_ints[node, NODE_FIRST]
    stack[0, 0], stack[0, 1] = first + 1, tree.width - left_children
    stack[1, 0], stack[1, 1] = first, left_children
    stack_size = 2
    count = 0
    while stack_size > 0:
        stack_size -= 1
        child, share = stack[stack_size, 0], stack[stack_size, 1]
        shares = tree.shares[child]
        while share > 1 and share_of(shares, share) == 0:
            share -= 1
        if share == 1:
            children[count] = child
            count += 1
        else:
            left_share = np.int32(share_of(shares, share))
            first = tree.node_ints[child, NODE_FIRST]
            stack[stack_size, 0], stack[stack_size, 1] = first + 1, share - left_share
            stack[stack_size + 1, 0], stack[stack_size + 1, 1] = first, left_share
            stack_size += 2
    return count


def split_leaves(bvh: Bvh, leaf_size: int) -> NDArray[np.float32]:
    """Return the nodes of a tree whose leaves have at most `leaf_size` triangles.

    Parameters
    ----------
    bvh : Bvh
        The order of its primitives is kept: all but the last new leaf of each old one are full.
    leaf_size : int

    Returns
    -------
    (N, 8) float32
        Lanes of `structs.NODE`. Siblings are neighbours and lie behind their parent; the order is not depth-first.
    """
    nodes = np.ascontiguousarray(bvh.nodes).view(np.float32).reshape(-1, NODE_LANES)
    counts = bvh.nodes["count"]
    leaf_counts = -(-counts[counts > leaf_size].astype(np.int64) // leaf_size)
    if len(leaf_counts) == 0:
        return nodes
    grown = np.empty((len(nodes) + int((2 * (leaf_counts - 1)).sum()), NODE_LANES), np.float32)
    grown[: len(nodes)] = nodes
    _split_leaves(grown, grown.view(np.int32), len(nodes), leaf_size, bvh.prim_ids, *find_corners(bvh.shape))
    return grown


@compiled
def _split_leaves(nodes, node_ints, node_count, leaf_size, prim_ids, points, ids):
    node = 0
    while node < node_count:
        count = node_ints[node, NODE_COUNT]
        if count > leaf_size:
            # The left child gets whole blocks. Both children are split further when the loop reaches them.
            first = node_ints[node, NODE_FIRST]
            left_count = (count // leaf_size + (count % leaf_size > 0) + 1) // 2 * leaf_size
            right_first, right_count = first + left_count, count - left_count
            _write_leaf(nodes, node_ints, node_count, first, left_count, prim_ids, points, ids)
            _write_leaf(nodes, node_ints, node_count + 1, right_first, right_count, prim_ids, points, ids)
            node_ints[node, NODE_FIRST] = node_count
            node_ints[node, NODE_COUNT] = 0
            node_count += 2
        node += 1


@compiled
def _write_leaf(nodes, node_ints, node, first, count, prim_ids, points, ids):
    node_ints[node, NODE_FIRST] = first
    node_ints[node, NODE_COUNT] = count
    for axis in range(3):
        least, most = np.inf, -np.inf
        for index in range(first, first + count):
            for corner in range(3):
                coordinate = points[ids[prim_ids[index], corner], axis]
                least, most = min(least, coordinate), max(most, coordinate)
        nodes[node, axis], nodes[node, NODE_MAX + axis] = least, most
