"""Many small trees in a wide layout: one loop widens them all, from common arrays.

To call the steps of `wide.py` one by one takes 50 us for each tree; here 12 triangles take 10 us. The arrays have the
same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..bvh.bvh import Bvh
from ..geometry.joined_shapes import first_rows
from ..structs import NODE
from ..support.host_threads import HostThreads
from ..tree_layouts import wide_node
from .wide import LOOPS, WideTree, block_prices, split_leaves

# Least trees of a thread's range: each takes some microseconds.
_LEAST_TREES = 64


def widen_small(bvhs: Sequence[Bvh], width: int) -> list[WideTree]:
    """Return the wide tree of each binary tree, as `widen` does."""
    sources, sources_prims = [split_leaves(bvh, width) for bvh in bvhs], [bvh.prim_ids for bvh in bvhs]
    # As numbers: numpy copies structs field by field.
    nodes = np.concatenate([source.view(np.float32) for source in sources]).view(NODE)
    prim_ids, count = np.concatenate(sources_prims), len(bvhs)
    first_nodes, first_prims = first_rows(sources), first_rows(sources_prims)
    prices, shares = block_prices([bvh.shape for bvh in bvhs]), np.empty(len(nodes), np.uint32)
    scratch = np.empty((len(nodes), width), np.float32), np.zeros(len(nodes), np.uint8), np.empty(len(nodes), np.uint8)
    longest = int(np.diff(first_nodes).max())
    sizes, stack_sizes = np.empty((count, 2), np.int64), np.empty(count, np.int32)
    with HostThreads() as threads:
        threads.for_ranges(
            count,
            lambda begin, end: LOOPS.choose_trees(
                nodes, width, prices, first_nodes, begin, end, *scratch, shares, np.empty(longest, np.int32), sizes
            ),
            least_items=_LEAST_TREES,
        )
        ends = np.concatenate((np.zeros((1, 2), np.int64), np.cumsum(sizes, axis=0)))
        wide_nodes, blocks = np.empty(ends[-1, 0], wide_node(width)), np.empty((ends[-1, 1], width), np.int32)
        tables = stack_sizes, first_nodes, first_prims, ends
        output = wide_nodes.view(np.float32), blocks
        threads.for_ranges(
            count,
            lambda begin, end: LOOPS.write_trees(
                nodes, shares, prim_ids, width, *tables, begin, end, np.empty((longest, 3), np.int32), *output
            ),
            least_items=_LEAST_TREES,
        )
    rows = zip(ends[:-1].tolist(), ends[1:].tolist(), stack_sizes.tolist(), strict=True)
    return [
        WideTree(wide_nodes[node:node_end], blocks[block:block_end], stack_size)
        for (node, block), (node_end, block_end), stack_size in rows
    ]
