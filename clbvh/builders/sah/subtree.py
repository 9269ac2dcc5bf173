"""One range of primitives becomes a subtree, in one loop on one core; finished subtrees move together.

Ranges that do not overlap need neither a shared counter nor a lock. A finished subtree lies where the primitive
references of its range were, see cl/host/builders/subtrees.cl.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...structs import NODE
from ..executor import Arrays, Executor
from ..invariants import place_top, write_top
from ..options import BuildOptions
from ..prim_refs import SUBTREES, Bounds
from .top import Range

DEFAULT_BINS = 16

# The options of a build that decide about a node: bins, leaf size and traversal cost; see `BuildOptions`.
Rule = tuple[int, int, float]


def make_rule(options: BuildOptions) -> Rule:
    """Return the rule that these options ask for."""
    return options.bins or DEFAULT_BINS, options.leaf_size, options.traversal_cost


def build_one(arrays: Arrays, begin: int, end: int, buffer: int, depth: int, bounds: Bounds, rule: Rule) -> int:
    """Build the subtree of a range, whose root has this depth in the whole tree; return its number of nodes."""
    task = begin, end, buffer, depth, bounds, *rule
    return int(SUBTREES.build_subtree(arrays["prim_refs"], *task, arrays["prim_ids"]))


def compact(executor: Executor, root: Range) -> NDArray[np.void]:
    """Return the nodes of the whole tree, (N,) `structs.NODE`, once all subtrees are built."""
    nodes = np.empty(place_top(root), NODE)
    write_top(root, nodes)
    refs = executor.arrays["prim_refs"]
    subtrees = np.array([(node.end, node.node_count, *node.placement) for node in root.leaves()], np.int64)
    shares = np.array_split(subtrees, executor.workers)
    executor.threads.run(SUBTREES.place_subtrees, [(refs.shape[1], refs, share, nodes) for share in shares])
    return nodes
