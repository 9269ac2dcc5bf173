"""Many small trees in a wide layout: one compiled loop widens them all, from common arrays.

To call the steps of `wide.py` one by one takes 50 us for each tree; here 12 triangles take 10 us. The arrays have the
same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bvh.bvh import Bvh
from ..geometry.joined_shapes import first_rows
from ..structs import WIDE_NODES
from ..support.compiled import compiled
from ..support.host_threads import HostThreads
from .wide import (
    NO_STARTS,
    ROOT_START,
    BinaryTree,
    WideTree,
    block_prices,
    choose_range,
    count_subtree,
    split_leaves,
    write_nodes,
)

# Least trees of a thread's range: each takes some microseconds.
_LEAST_TREES = 64


class _Joined(NamedTuple):
    """Binary trees, `BinaryTree`, in common arrays: tree i has the rows from `first_nodes[i]` and `first_prims[i]` on.

    Links are those within each tree.
    """

    nodes: NDArray[np.float32]
    node_ints: NDArray[np.int32]
    prim_ids: NDArray[np.int32]
    shares: NDArray[np.uint32]
    first_nodes: NDArray[np.int64]
    first_prims: NDArray[np.int64]


def widen_small(bvhs: Sequence[Bvh], width: int) -> list[WideTree]:
    """Return the wide tree of each binary tree, as `widen` does."""
    sources, prim_ids = [split_leaves(bvh, width) for bvh in bvhs], [bvh.prim_ids for bvh in bvhs]
    nodes, count = np.concatenate(sources), len(bvhs)
    shares = np.empty(len(nodes), np.uint32)
    first_nodes, first_prims = first_rows(sources), first_rows(prim_ids)
    trees = _Joined(nodes, nodes.view(np.int32), np.concatenate(prim_ids), shares, first_nodes, first_prims)
    prices = block_prices([bvh.shape for bvh in bvhs])
    costs = np.empty((len(nodes), width), np.float32)
    most, prim_counts = np.zeros(len(nodes), np.int8), np.empty(len(nodes), np.int8)
    sizes, stack_sizes = np.empty((count, 2), np.int64), np.empty(count, np.int64)
    with HostThreads() as threads:
        threads.for_ranges(
            count,
            lambda first, end: _choose(trees, width, prices, first, end, costs, most, prim_counts, sizes),
            least_items=_LEAST_TREES,
        )
        ends = np.concatenate((np.zeros((1, 2), np.int64), np.cumsum(sizes, axis=0)))
        wide_nodes, blocks = np.empty(ends[-1, 0], WIDE_NODES[width]), np.empty((ends[-1, 1], width), np.int32)
        lanes = wide_nodes.view(np.float32).reshape(len(wide_nodes), -1)
        output = lanes, lanes.view(np.int32), blocks
        threads.for_ranges(
            count,
            lambda first, end: _write(trees, width, ROOT_START, NO_STARTS, ends, first, end, *output, stack_sizes),
            least_items=_LEAST_TREES,
        )
    rows = zip(ends[:-1].tolist(), ends[1:].tolist(), stack_sizes.tolist(), strict=True)
    return [
        WideTree(wide_nodes[node:node_end], blocks[block:block_end], stack_size)
        for (node, block), (node_end, block_end), stack_size in rows
    ]


@compiled
def _take(trees, width, number):
    """Return one of the binary trees."""
    first, end = trees.first_nodes[number], trees.first_nodes[number + 1]
    prim_ids = trees.prim_ids[trees.first_prims[number] : trees.first_prims[number + 1]]
    return BinaryTree(trees.nodes[first:end], trees.node_ints[first:end], prim_ids, width, trees.shares[first:end])


@compiled
def _choose(trees, width, prices, first, end, costs, most, prim_counts, sizes):
    """Choose the wide nodes of some trees, and write their numbers of nodes and blocks, (n, 2) int64."""
    for number in range(first, end):
        tree = _take(trees, width, number)
        begin, stop = trees.first_nodes[number], trees.first_nodes[number + 1]
        rows = costs[begin:stop], most[begin:stop], prim_counts[begin:stop]
        choose_range(tree, prices[number], 0, len(tree.nodes), rows[0], rows[1], rows[2])
        sizes[number, 0], sizes[number, 1] = count_subtree(tree, 0)


@compiled
def _write(trees, width, start, no_starts, ends, first, end, wide_nodes, wide_ints, blocks, stack_sizes):
    """Write the nodes and the blocks of some trees, those of tree i from `ends[i]` on."""
    roots, sizes, starts = no_starts
    for number in range(first, end):
        node, block = ends[number]
        node_end, block_end = ends[number + 1]
        own = wide_nodes[node:node_end], wide_ints[node:node_end], blocks[block:block_end]
        tree = _take(trees, width, number)
        stack_sizes[number] = write_nodes(tree, start, roots, sizes, starts, own[0], own[1], own[2])
