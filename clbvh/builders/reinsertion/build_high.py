"""The quality `high`: the default tree, rearranged until rays find less to test.

Owns the order of the steps, which are in cl/host/builders/reinsertion.cl, and the division of the tree among threads.
The tree is the same, byte for byte, for any number of workers: the subtrees that threads rearrange follow from the
tree, and each is the work of one thread.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh, sah_cost
from ...device.host.loops import Loops
from ...geometry.spheres import Bounded
from ...structs import BOX_LANES, BOX_TAG, MAX_DEPTH, NODE
from ...support.stopwatch import Stopwatch
from ..executor import Executor
from ..options import DEFAULT_QUALITY, BuildOptions
from ..prim_refs import fill_slice
from ..sah.build_sah import build_sah

# More bins than the default give a better start on scans, and sometimes a worse one elsewhere: both trees are built,
# and the one of the lower cost is rearranged. docs/internals/decisions.md has the shares.
_FINER_BINS = 64

# A node stays within the same eighth of the triangles. With the whole tree to choose from, the SAH cost falls by
# another percent, but rays test no less: docs/internals/decisions.md. And eighths are work for eight threads.
_PARTS = 8
_SMALLEST_PART = 4096  # a few milliseconds: nothing to share

# The first pass saves about three quarters of the total; four passes more than these save less than 0.2 %, on scans
# and in buildings.
_PASSES = 4

REINSERTION = Loops("builders/reinsertion")

ROOT = 1


class ExpandedTree(NamedTuple):
    """A tree over n primitives that can be rearranged: each of them is a leaf of its own.

    Node 1 is the root, node 0 is unused, and siblings are nodes 2k and 2k + 1.

    Attributes
    ----------
    boxes : (2n, 8) float32
        `structs.BOX` of each node. The tag is the first child, 0 in a leaf, and the tally is the leaf's primitive.
    parents : (n,) int32
        ``parents[node >> 1]`` is the parent of a node; 0 for the root.
    """

    boxes: NDArray[np.float32]
    parents: NDArray[np.int32]

    @classmethod
    def of(cls, bvh: Bvh) -> Self:
        """Expand the leaves of a tree."""
        count = bvh.shape.prim_count
        prim_refs = np.empty((count, BOX_LANES), np.float32)
        fill_slice(bvh.shape.find_corners(), 0, count, prim_refs)
        tree = cls(np.zeros((2 * count, BOX_LANES), np.float32), np.zeros(count, np.int32))
        REINSERTION.expand_leaves(bvh.nodes, bvh.prim_ids, prim_refs, *tree)
        return tree

    @property
    def links(self) -> NDArray[np.int32]:
        """The boxes' lanes as integers."""
        return self.boxes.view(np.int32)

    def list_nodes(self, order: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return all nodes, parents first, in the memory of `order`, (>= 2n - 1,)."""
        order[0] = ROOT
        return order[: 1 + REINSERTION.list_descendants(self.boxes, ROOT, order[1:])]

    def choose_leaves(self, order: NDArray[np.int32], options: BuildOptions) -> tuple[int, NDArray[np.bool_]]:
        """Return the depth of the tree of the lowest SAH cost, and its leaves: (2n,) bool, of no meaning below one."""
        count, rule = len(self.boxes), (options.leaf_size, options.traversal_cost)
        is_leaf, costs, scratch = np.empty(count, np.bool_), np.empty(count), np.empty((2, count), np.int32)
        return REINSERTION.choose_leaves(self.boxes, *rule, order, costs, *scratch, is_leaf), is_leaf

    def collapse(self, is_leaf: NDArray[np.bool_], shape: Bounded) -> Bvh:
        """Return the finished tree with these leaves, at most `MAX_DEPTH` deep."""
        nodes, prim_ids = np.empty(len(self.boxes), NODE), np.empty(shape.prim_count, np.int32)
        return Bvh(nodes[: REINSERTION.collapse(self.boxes, is_leaf, nodes, prim_ids)].copy(), prim_ids, shape)


def build_high(shape: Bounded, executor: Executor, options: BuildOptions) -> Bvh:
    """Build the default tree and optimise it; see `clbvh.build` for the parameters.

    Returns
    -------
    Bvh
        Never of a higher SAH cost than the default tree, at the traversal cost of the options.

    Notes
    -----
    Rearranges in threads of this process, as many as there are workers. Besides the shape and two trees it takes about
    110 bytes per primitive.
    """
    start = _build_start(shape, executor, options)
    watch = Stopwatch()
    tree = ExpandedTree.of(start)
    watch.lap("expand_leaves")

    order = np.empty(2 * shape.prim_count, np.int32)
    parts = _choose_parts(tree, tree.list_nodes(order))
    executor.threads.run(_rearrange, [(tree, *part) for part in parts])
    watch.lap("reinsert")

    depth, is_leaf = tree.choose_leaves(tree.list_nodes(order), options)
    better = tree.collapse(is_leaf, shape) if depth <= MAX_DEPTH else None
    cheapest = start if better is None else _cheapest((start, better), options)
    watch.lap("collapse")
    return replace(cheapest, timings_ms={**start.timings_ms, **watch.laps_ms})


def _build_start(shape: Bounded, executor: Executor, options: BuildOptions) -> Bvh:
    """Return the cheaper one of two finished trees."""
    plain = replace(options, quality=DEFAULT_QUALITY)
    start = build_sah(shape, executor, plain)
    if options.bins is not None:
        return start
    watch = Stopwatch()
    finer = build_sah(shape, executor, replace(plain, bins=_FINER_BINS))
    cheapest = _cheapest((start, finer), options)
    watch.lap("finer bins")
    return replace(cheapest, timings_ms={**start.timings_ms, **watch.laps_ms})


def _cheapest(trees: Iterable[Bvh], options: BuildOptions) -> Bvh:
    """Return the tree of the lowest SAH cost, the first one of equals."""
    return min(trees, key=lambda tree: sah_cost(tree, traversal_cost=options.traversal_cost))


def _choose_parts(tree: ExpandedTree, order: NDArray[np.int32]) -> list[tuple[int, int]]:
    """Return disjoint subtrees, each the work of one thread: their roots and primitive counts, the largest first."""
    prim_counts = np.empty(len(tree.boxes), np.int32)
    REINSERTION.count_prims(tree.boxes, order, prim_counts)
    most_prims = max(prim_counts[ROOT] // _PARTS, _SMALLEST_PART)
    parts = []
    stack = [ROOT]
    while stack:
        node = stack.pop()
        if prim_counts[node] <= most_prims:
            parts.append((node, int(prim_counts[node])))
        else:
            child = int(tree.links[node, BOX_TAG])
            stack += [child + 1, child]
    return sorted(parts, key=lambda part: -part[1])


def _rearrange(tree: ExpandedTree, top: int, prim_count: int) -> None:
    """Reinsert the nodes of one subtree, pass by pass, until none moves."""
    order = np.empty(2 * prim_count, np.int32)
    for _ in range(_PASSES):
        below = order[: REINSERTION.list_descendants(tree.boxes, top, order)]
        if REINSERTION.reinsert_below(*tree, top, below) == 0:
            return
