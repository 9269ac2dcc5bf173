"""The steps of the default builder that run in a worker: it builds subtrees, and nothing else.

A step sees the arrays by name, gets plain numbers and small arrays, and returns a number: everything large is written
in place. The arrays, for n primitives:

    prim_refs  (2, n, 8) float32   two buffers of primitive references; in the end they hold the nodes
    prim_ids   (n,) int32          result
"""

from __future__ import annotations

from ..warm_up import make_small_arrays, make_small_bounds
from ..workers.executor import Arrays
from .rule import Rule
from .subtree import SubtreeTask, build_subtree

_WARM_UP_RULE = Rule(2, 1, 1.0)


def build_one(arrays: Arrays, task: SubtreeTask, rule: Rule) -> int:
    """Build the subtree of a range; return its number of nodes."""
    return build_subtree(arrays["prim_refs"], task, rule, arrays["prim_ids"])


def warm_up() -> None:
    """Compile, or load from numba's cache, all that the step above calls."""
    arrays = make_small_arrays()
    build_one(arrays, SubtreeTask(0, len(arrays["prim_ids"]), 0, 0, make_small_bounds()), _WARM_UP_RULE)
