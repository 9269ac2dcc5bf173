"""One range of primitives becomes a subtree, in one compiled loop on one core; finished subtrees move together.

A range [begin, end) writes only to its own primitive references and to prim_ids[begin:end], so ranges that do not
overlap need neither a shared counter nor a lock.

Nodes are finished from right to left, and overwrite the primitive references of finished leaves, which nobody needs
any more, in both buffers: two slots for each primitive. A tree over n primitives has at most 2n - 1 nodes, and the same
holds for its parts, so there is always a free slot. `slot_of` says where the n-th finished node lies. The order is the
reverse of depth-first order: all descendants of the right child, all of the left child, then the right child and the
left child themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...geometry.boxes import as_node, half_area, load_box, store_box
from ...structs import BOX_LANES, NODE_COUNT, NODE_FIRST, PRIM_REF_ID
from ...support.compiled import compiled
from ..executor import Arrays, Executor
from ..invariants import index_of, middle_of, needs_halving, place_top
from ..options import MAX_DEPTH, BuildOptions
from ..prim_refs import BOUNDS_BOX, BOUNDS_CENTROIDS, Bounds
from .split import (
    MAX_EXHAUSTIVE,
    Slice,
    Split,
    bin_count_for,
    bound_halves,
    count_left,
    divide,
    fill_bins,
    find_exhaustive_split,
    find_split,
    make_bins,
    partition,
    unite_sides,
)
from .top import Range

DEFAULT_BINS = 16


class Rule(NamedTuple):
    """The options of a build that decide about a node; see `BuildOptions`.

    Attributes
    ----------
    bins, leaf_size : int
    traversal_cost : float
    """

    bins: int
    leaf_size: int
    traversal_cost: float


def make_rule(options: BuildOptions) -> Rule:
    """Return the rule that these options ask for."""
    return Rule(options.bins or DEFAULT_BINS, options.leaf_size, options.traversal_cost)


class SubtreeTask(NamedTuple):
    """A range that becomes a subtree.

    Attributes
    ----------
    begin, end, buffer, depth : int
        The range, which of the two buffers holds it, and the depth of its root in the whole tree.
    bounds : (2, 8) float32
    """

    begin: int
    end: int
    buffer: int
    depth: int
    bounds: Bounds


_NO_SPLIT = Split(np.inf, 0, 0, 0, 0)


@compiled
def build_subtree(prim_refs, task, rule, prim_ids):
    """Build the subtree over one range.

    Parameters
    ----------
    prim_refs : (2, n, 8) float32, overwritten
        Two buffers of primitive references. Afterwards they hold the nodes, see `slot_of`: rows of `structs.NODE`,
        except that an interior node's `first` is its left child's number. The root is the last one.
    task : SubtreeTask
    rule : Rule
    prim_ids : (n,) int32, written

    Returns
    -------
    int
        Number of nodes.

    Notes
    -----
    The search for a split and the moves are in this loop, with its arrays as locals. As functions that take the arrays,
    one by one or in a NamedTuple, inlined or not, they added 18 to 50 % to the build time: numba counts references to
    each array at every call. 60,000 triangles, one process.
    """
    ref_ints = prim_refs.view(np.int32)
    bins = make_bins(rule.bins)
    right_costs = np.empty(3 * rule.bins, np.float64)

    # The current node, and its children: row 0 is the left one.
    begin, end, buffer, depth = task.begin, task.end, task.buffer, task.depth
    range_end, range_bounds = end, task.bounds
    bounds = np.empty((2, BOX_LANES), np.float32)
    boxes, centroid_boxes = np.empty((2, BOX_LANES), np.float32), np.empty((2, BOX_LANES), np.float32)

    # The nodes above it, an entry for each level; the right child is built first. Of the left child: begin, end and
    # buffer, with 0 for the end once it is the current node, and the box of its centroids. Rows 2 * level and
    # 2 * level + 1: left and right child, a box until it is finished, then a node.
    levels = MAX_DEPTH + 1
    left_ranges = np.empty((levels, 3), np.int64)
    left_centroid_boxes = np.empty((levels, BOX_LANES), np.float32)
    child_boxes = np.empty((2 * levels, BOX_LANES), np.float32)

    level = node_count = 0
    enter_node(bounds, load_box(range_bounds, BOUNDS_BOX), load_box(range_bounds, BOUNDS_CENTROIDS))
    while True:
        prim_count = end - begin
        source = prim_refs[buffer]

        # Try to split the node.
        cost, left_mask, split = np.inf, 0, _NO_SPLIT
        if prim_count > 1 and not needs_halving(prim_count, depth + level):
            if prim_count <= MAX_EXHAUSTIVE:
                cost, left_mask = find_exhaustive_split(source, begin, prim_count)
            else:
                bin_count = bin_count_for(prim_count, rule.bins)
                fill_bins(source, begin, end, bounds, bin_count, bins)
                split = find_split(bins, bin_count, right_costs)
                cost = split.cost

        if not is_leaf(prim_count, half_area(load_box(bounds, BOUNDS_BOX)), cost, rule):
            # Move its primitive references to their sides, into the other buffer; halves stay where they are.
            if not cost < np.inf:
                middle = middle_of(begin, end)
                bound_halves(source, begin, middle, end, boxes, centroid_boxes)
            elif prim_count <= MAX_EXHAUSTIVE:
                middle = begin + count_left(left_mask)
                divide(source, prim_refs[1 - buffer], begin, prim_count, left_mask, boxes)
                buffer = 1 - buffer
            else:
                middle = begin + split.left_count
                unite_sides(bins, split, boxes)
                part = Slice(begin, end, begin, middle)
                partition(source, prim_refs[1 - buffer], part, bounds, split, centroid_boxes)
                buffer = 1 - buffer

            # The left child goes on the stack, the right one is next.
            left_ranges[level, 0], left_ranges[level, 1], left_ranges[level, 2] = begin, middle, buffer
            store_box(left_centroid_boxes, level, load_box(centroid_boxes, 0))
            store_box(child_boxes, 2 * level, load_box(boxes, 0))
            store_box(child_boxes, 2 * level + 1, load_box(boxes, 1))
            enter_node(bounds, load_box(boxes, 1), load_box(centroid_boxes, 1))
            begin = middle
            level += 1
            continue

        # A leaf, its primitives in ascending order already; perhaps the last one below some of the nodes above.
        for index in range(begin, end):
            prim_ids[index] = ref_ints[buffer, index, PRIM_REF_ID]
        first, count = begin, prim_count
        while level > 0 and left_ranges[level - 1, 1] == 0:
            level -= 1
            finish_node(child_boxes, 2 * level, first, count)
            emit_node(prim_refs, range_end, node_count, child_boxes, 2 * level + 1)
            emit_node(prim_refs, range_end, node_count + 1, child_boxes, 2 * level)
            first, count = node_count + 1, 0
            node_count += 2
        if level == 0:
            enter_node(bounds, load_box(range_bounds, BOUNDS_BOX), load_box(range_bounds, BOUNDS_CENTROIDS))
            finish_node(bounds, BOUNDS_BOX, first, count)
            emit_node(prim_refs, range_end, node_count, bounds, BOUNDS_BOX)
            return node_count + 1

        # A right child is finished; the left one is next.
        finish_node(child_boxes, 2 * level - 1, first, count)
        above = level - 1
        begin, end, buffer = left_ranges[above, 0], left_ranges[above, 1], left_ranges[above, 2]
        left_ranges[above, 1] = 0
        enter_node(bounds, load_box(child_boxes, 2 * above), load_box(left_centroid_boxes, above))


@compiled
def is_leaf(prim_count, area, split_cost, rule):
    """Say whether a node becomes a leaf: that is allowed, and no split is cheaper."""
    return prim_count <= rule.leaf_size and not rule.traversal_cost * area + split_cost < prim_count * area


@compiled
def enter_node(bounds, box, centroid_box):
    """Write the bounds of the current node."""
    store_box(bounds, BOUNDS_BOX, box)
    store_box(bounds, BOUNDS_CENTROIDS, centroid_box)


@compiled
def finish_node(boxes, row, first, count):
    """Turn the box in a row into a row of `structs.NODE`."""
    store_box(boxes, row, as_node(load_box(boxes, row), first, count))


@compiled
def emit_node(prim_refs, range_end, number, nodes, row):
    """Write `nodes[row]` as the finished node with this number."""
    buffer, slot = slot_of(range_end, number)
    store_box(prim_refs[buffer], slot, load_box(nodes, row))


@compiled
def slot_of(range_end, number):
    """Return the buffer of the n-th finished node of a range that ends at `range_end`, and its index in the buffer."""
    return number & 1, range_end - 1 - (number >> 1)


def build_one(arrays: Arrays, task: SubtreeTask, rule: Rule) -> int:
    """Build the subtree of a range; return its number of nodes."""
    return build_subtree(arrays["prim_refs"], task, rule, arrays["prim_ids"])


def compact(executor: Executor, root: Range) -> NDArray[np.float32]:
    """Return the nodes of the whole tree, (N, 8) float32, once all subtrees are built."""
    nodes = np.empty((place_top(root), BOX_LANES), np.float32)
    write_top(root, nodes)
    subtrees = list(root.leaves())
    shares = [subtrees[number :: executor.workers] for number in range(executor.workers)]
    executor.threads.run(place_subtrees, [(executor.arrays["prim_refs"], share, nodes) for share in shares])
    return nodes


def write_top(root: Range, nodes: NDArray[np.float32]) -> None:
    """Write the nodes of the top."""
    for node in root.walk():
        if node.children:
            index, first_child = node.placement
            nodes[index] = node.bounds[BOUNDS_BOX]
            finish_node(nodes, index, first_child, 0)


def place_subtrees(prim_refs: NDArray[np.float32], subtrees: Sequence[Range], nodes: NDArray[np.float32]) -> None:
    """Copy some subtrees to their indices."""
    for subtree in subtrees:
        place_finished(prim_refs, subtree.end, subtree.node_count, subtree.placement, nodes)


@compiled
def place_finished(prim_refs, range_end, node_count, placement, nodes):
    """Copy a subtree to its indices, and let its nodes name their children by these.

    Parameters
    ----------
    prim_refs : (2, n, 8) float32
        As `build_subtree` leaves them.
    range_end, node_count : int
        Where the subtree's range ends, and how many nodes it has.
    placement : Placement
    nodes : (N, 8) float32, rows of `structs.NODE`, written
    """
    node_ints = nodes.view(np.int32)
    last = node_count - 1
    for number in range(node_count):
        index = index_of(number, placement)
        # Nodes are finished in the reverse of depth-first order.
        buffer, slot = slot_of(range_end, last - number)
        store_box(nodes, index, load_box(prim_refs[buffer], slot))
        if node_ints[index, NODE_COUNT] == 0:
            node_ints[index, NODE_FIRST] = index_of(last - node_ints[index, NODE_FIRST], placement)
