"""With a small task threshold on a large mesh, bundling ranges into tasks took quadratic time."""

from __future__ import annotations

import numpy as np

from clbvh.builders.sah.build_sah import _build_subtrees
from clbvh.builders.sah.subtree import Rule
from clbvh.builders.sah.top import Range

RANGES = 4096
LOOKS_PER_RANGE = 20


class CountedRange(Range):
    looks = 0

    def __len__(self):
        CountedRange.looks += 1
        return super().__len__()


class OneWorker:
    """Stands for a pool."""

    workers = 1

    def map(self, step, tasks):
        return [1] * len(tasks)


def split_evenly(begin, end, depth=0):
    node = CountedRange(begin, end, depth, 0, np.zeros((2, 8), np.float32))
    if end - begin > 1:
        middle = (begin + end) // 2
        node.children = (split_evenly(begin, middle, depth + 1), split_evenly(middle, end, depth + 1))
    return node


def test_each_range_is_looked_at_a_few_times():
    root = split_evenly(0, RANGES)
    CountedRange.looks = 0
    _build_subtrees(OneWorker(), root, Rule(16, 4, 1.0))
    assert CountedRange.looks < LOOKS_PER_RANGE * RANGES
    assert all(node.node_count == 1 for node in root.leaves())
