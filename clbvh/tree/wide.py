"""A binary tree becomes one of up to four or eight children per node, with leaves that fill a group of triangles.

Which nodes stay is decided by dynamic programming over the whole tree: the cheapest wide tree that the binary one
contains (Wald, Benthin and Boulos, "Getting rid of packets", 2008; Ylitie, Karras and Laine, "Efficient incoherent ray
traversal on GPUs through compressed wide BVHs", 2017). A group costs the same however many triangles are in it, so
whole subtrees become one leaf, whatever leaf size the binary tree was built with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..geometry import Mesh
from ..layout import GROUPS, NO_PRIM, NODE_COUNT, NODE_FIRST, NODE_MAX, WIDE_NODES
from .big_leaves import cut_big_leaves
from .bvh import Bvh

# What a test of a group costs in node steps, and what its memory costs besides, as the area of that many average
# nodes.
GROUP_COST = 1.0
GROUP_PRICE = 16.0


@dataclass(frozen=True, eq=False)
class WideTree:
    """The nodes that stay, and which triangles are in each leaf.

    Attributes
    ----------
    nodes : (N,) `layout.WIDE_NODES[width]`
        Row 0 is the root; children stand behind their parent, siblings together.
    groups : (G, width) int32
        Faces of the mesh in each leaf's group, `NO_PRIM` in the lanes that are left over.
    waiting : int
        How many children can wait at once while a ray goes through the tree, at most.
    """

    nodes: NDArray[np.void]
    groups: NDArray[np.int32]
    waiting: int


def widen(bvh: Bvh, width: int) -> WideTree:
    """Return the wide tree that a ray traverses fastest, of those that the binary tree contains.

    Parameters
    ----------
    bvh : Bvh
        With leaves of any size.
    width : int
        Most children of a node, and most triangles of a leaf: 4 or 8.

    Notes
    -----
    O(nodes), on one core. The same tree gives the same bytes.
    """
    rows, prim_ids = cut_big_leaves(bvh, width), bvh.prim_ids
    row_ints = rows.view(np.int32)
    splits = np.zeros((len(rows), width + 1), np.int8)
    _choose_nodes(rows, row_ints, width, GROUP_COST, GROUP_PRICE, splits)
    dtype = WIDE_NODES[width]
    nodes = np.empty(max(1, len(rows) // 2), dtype)
    groups = np.full((len(rows) // 2 + 1, width), NO_PRIM, np.int32)
    lanes = nodes.view(np.float32).reshape(len(nodes), -1)
    node_count, group_count, waiting = _write_nodes(
        rows, row_ints, prim_ids, width, splits, lanes, lanes.view(np.int32), groups
    )
    return WideTree(nodes[:node_count], groups[:group_count], waiting)


@njit(cache=True, nogil=True)
def _half_area(rows, row):  # type: ignore[no-untyped-def]
    x = rows[row, NODE_MAX] - rows[row, 0]
    y = rows[row, NODE_MAX + 1] - rows[row, 1]
    z = rows[row, NODE_MAX + 2] - rows[row, 2]
    return np.float64(x) * y + np.float64(y) * z + np.float64(z) * x


@njit(cache=True, nogil=True)
def _choose_nodes(rows, row_ints, width, group_cost, group_price, splits):  # type: ignore[no-untyped-def]
    """Find the cheapest way to represent each subtree by 1, 2, ... children of a wide node.

    Writes `splits[row, i]`, for up to i children: how many of them are the left half's; 0 for no more than i - 1
    children. `splits[row, 1]` is the same for the children of the node that represents the subtree, 0 for a leaf.
    """
    costs = np.empty((len(rows), width + 1), np.float64)
    prim_counts = np.empty(len(rows), np.int32)
    price = group_price * _half_area(rows, 0) / len(rows)
    # Children stand behind their parents.
    for row in range(len(rows) - 1, -1, -1):
        area = _half_area(rows, row)
        leaf_cost = area * group_cost + price
        prim_counts[row] = row_ints[row, NODE_COUNT]
        if prim_counts[row] > 0:
            costs[row, 1:] = leaf_cost
            continue
        left = row_ints[row, NODE_FIRST]
        right = left + 1
        prim_counts[row] = prim_counts[left] + prim_counts[right]
        for children in range(2, width + 1):
            cheapest = np.inf
            for left_children in range(1, children):
                cost = costs[left, left_children] + costs[right, children - left_children]
                if cost < cheapest:
                    cheapest = cost
                    splits[row, children] = left_children
            costs[row, children] = cheapest

        # As one child: a node with as many children as are best, or a leaf.
        costs[row, 1] = costs[row, width] + area
        splits[row, 1] = splits[row, width]
        if prim_counts[row] <= width and leaf_cost <= costs[row, 1]:
            costs[row, 1] = leaf_cost
            splits[row, 1] = 0
        for children in range(2, width + 1):
            if costs[row, children - 1] <= costs[row, children]:
                costs[row, children] = costs[row, children - 1]
                splits[row, children] = 0


@njit(cache=True, nogil=True)
def _list_children(row_ints, splits, row, width, waiting, children):  # type: ignore[no-untyped-def]
    """Write the rows that become the children of a wide node, and return their number."""
    left_children = splits[row, 1]
    if left_children == 0:
        # The whole tree is one leaf.
        children[0] = row
        return 1
    waiting[0, 0], waiting[0, 1] = row_ints[row, NODE_FIRST] + 1, width - left_children
    waiting[1, 0], waiting[1, 1] = row_ints[row, NODE_FIRST], left_children
    waiting_count = 2
    count = 0
    while waiting_count > 0:
        waiting_count -= 1
        child, share = waiting[waiting_count, 0], waiting[waiting_count, 1]
        while share > 1 and splits[child, share] == 0:
            share -= 1
        if share == 1:
            children[count] = child
            count += 1
        else:
            left_share = splits[child, share]
            waiting[waiting_count, 0], waiting[waiting_count, 1] = row_ints[child, NODE_FIRST] + 1, share - left_share
            waiting[waiting_count + 1, 0], waiting[waiting_count + 1, 1] = row_ints[child, NODE_FIRST], left_share
            waiting_count += 2
    return count


@njit(cache=True, nogil=True)
def _list_prims(row_ints, prim_ids, row, waiting, prims):  # type: ignore[no-untyped-def]
    """Write the primitives of a small subtree."""
    waiting[0, 0] = row
    waiting_count = 1
    count = 0
    while waiting_count > 0:
        waiting_count -= 1
        row = waiting[waiting_count, 0]
        first = row_ints[row, NODE_FIRST]
        if row_ints[row, NODE_COUNT] == 0:
            waiting[waiting_count, 0], waiting[waiting_count + 1, 0] = first + 1, first
            waiting_count += 2
        else:
            for place in range(first, first + row_ints[row, NODE_COUNT]):
                prims[count] = prim_ids[place]
                count += 1


@njit(cache=True, nogil=True)
def _write_nodes(rows, row_ints, prim_ids, width, splits, nodes, node_ints, groups):  # type: ignore[no-untyped-def]
    """Write the nodes and the groups that were chosen; return how many there are, and how many children can wait."""
    greatest = np.finfo(np.float32).max
    # In units of 4 bytes: three coordinates of the minimum, three of the maximum, then the children.
    first_max, first_child = 3 * width, 6 * width
    pending = np.empty((len(nodes), 2), np.int32)
    parents = np.empty(len(nodes), np.int32)
    most_waiting = np.zeros(len(nodes), np.int32)
    children = np.empty(width, np.int32)
    waiting = np.empty((width + 1, 2), np.int32)
    pending[0] = 0
    pending_count = 1
    node_count = 1
    group_count = 0
    while pending_count > 0:
        pending_count -= 1
        row, node = pending[pending_count, 0], pending[pending_count, 1]
        child_count = _list_children(row_ints, splits, row, width, waiting, children)
        most_waiting[node] = child_count - 1
        for slot in range(width):
            # A child that is not there: inside out.
            for axis in range(3):
                nodes[node, axis * width + slot] = greatest
                nodes[node, first_max + axis * width + slot] = -greatest
            node_ints[node, first_child + slot] = 0
            if slot >= child_count:
                continue
            child = children[slot]
            for axis in range(3):
                nodes[node, axis * width + slot] = rows[child, axis]
                nodes[node, first_max + axis * width + slot] = rows[child, NODE_MAX + axis]
            if splits[child, 1] == 0:
                node_ints[node, first_child + slot] = ~group_count
                _list_prims(row_ints, prim_ids, child, waiting, groups[group_count])
                group_count += 1
            else:
                node_ints[node, first_child + slot] = node_count
                parents[node_count] = node
                pending[pending_count, 0], pending[pending_count, 1] = child, node_count
                pending_count += 1
                node_count += 1

    # While a child is looked at, its siblings wait, and those of all its ancestors.
    for node in range(node_count - 1, 0, -1):
        parent = parents[node]
        siblings = 0
        for slot in range(width):
            siblings += nodes[parent, slot] <= nodes[parent, first_max + slot]
        most_waiting[parent] = max(most_waiting[parent], siblings - 1 + most_waiting[node])
    return node_count, group_count, most_waiting[0]


def gather_groups(mesh: Mesh, groups: NDArray[np.int32]) -> NDArray[np.void]:
    """Return the corners of the triangles of each group.

    Parameters
    ----------
    mesh : Mesh
    groups : (G, width) int32
        Of a `WideTree` over the mesh.

    Returns
    -------
    (G,) `layout.GROUPS[width]`
        Degenerate triangles and lanes without a triangle are NaN.
    """
    width = groups.shape[1]
    gathered = np.empty(len(groups), GROUPS[width])
    gathered["prim_id"] = groups
    lanes = gathered.view(np.float32).reshape(len(groups), -1)
    _gather_corners(mesh.vertices, mesh.faces, mesh.degenerate_faces, groups, lanes)
    return gathered


@njit(cache=True, nogil=True)
def _gather_corners(vertices, faces, degenerate, groups, lanes):  # type: ignore[no-untyped-def]
    width = groups.shape[1]
    for group in range(len(groups)):
        for lane in range(width):
            prim = groups[group, lane]
            is_hittable = prim != NO_PRIM and not degenerate[prim]
            for corner in range(3):
                for axis in range(3):
                    place = (3 * corner + axis) * width + lane
                    lanes[group, place] = vertices[faces[prim, corner], axis] if is_hittable else np.nan
