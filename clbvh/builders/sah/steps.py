"""The steps of the default builder that run in a worker: it builds subtrees, and nothing else.

A step sees the arrays by name, gets plain numbers and small arrays, and returns a number: everything large is written
in place. The arrays, for n primitives:

    prim_refs  (2, n, 8) float32   two buffers of primitive references; in the end they hold the nodes
    prim_ids   (n,) int32          result
"""

from __future__ import annotations

from ..executor import Arrays
from .rule import Rule
from .subtree import SubtreeTask, build_subtree


def build_one(arrays: Arrays, task: SubtreeTask, rule: Rule) -> int:
    """Build the subtree of a range; return its number of nodes."""
    return build_subtree(arrays["prim_refs"], task, rule, arrays["prim_ids"])
