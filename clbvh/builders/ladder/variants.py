"""The ladder: the builders of the report, in its order, each with one change against the one before."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from ..options import BuildOptions

SORT = 0  # sort the whole range, cut in the middle
SELECT = 1  # find the median, cut there
BINS = 2  # count the range in bins, cut at the boundary next to the median


class Nodes(Enum):
    """The kinds of nodes of the variants."""

    HEAP = "linked, from the process's own heap"
    COUNTER = "linked, from one array, numbered by an atomic counter that all workers share"
    ROWS = "nodes of the flat tree"


@dataclass(frozen=True)
class Variant:
    """One builder of the ladder.

    Attributes
    ----------
    name : str
        Its name for `clbvh.build`; docs/ladder.md has its name in the report, its change and what that showed.
    parallel : bool
        Children are tasks for the workers, down to the task threshold.
    copies : bool
        Each node has a list of primitives of its own, instead of a range of one index array.
    cached : bool
        Boxes and centroids are computed once, in parallel, instead of in every comparison.
    how : int
        SORT, SELECT or BINS.
    nodes : Nodes
    flattens : bool
        The pass that flattens linked nodes is a part of the build. The other variants with linked nodes need it only
        because a `Bvh` is flat; their phase is called "convert", and the report did not measure it.
    frontier : bool
        Leaves hold up to `BuildOptions.frontier` primitives.
    """

    name: str
    parallel: bool = False
    copies: bool = True
    cached: bool = False
    how: int = SORT
    nodes: Nodes = Nodes.HEAP
    flattens: bool = False
    frontier: bool = False

    def leaf_size(self, options: BuildOptions) -> int:
        """Return how many primitives a leaf of this variant holds at most."""
        return options.frontier if self.frontier else options.leaf_size


_SEQUENTIAL = Variant("sequential")
# The two children are parallel tasks.
_NAIVE = replace(_SEQUENTIAL, name="naive", parallel=True)
# Ranges of one shared index array.
_RANGE = replace(_NAIVE, name="range", copies=False)
# Boxes and centroids are computed once.
_CACHED = replace(_RANGE, name="cached", cached=True)
# The median is selected, in O(n), instead of sorting everything.
_MEDIAN = replace(_CACHED, name="median", how=SELECT)
# A few bins on the longest axis; the cut is the boundary next to the median.
_BIN = replace(_MEDIAN, name="bin", how=BINS)
# Nodes come from one array, by a counter that all workers increment.
_ATOMIC = replace(_BIN, name="atomic", nodes=Nodes.COUNTER)
# A separate pass flattens the linked nodes.
_FLATTEN = replace(_BIN, name="flatten", flattens=True)
# Straight into the flat array: the report's final design.
_FLAT = replace(_BIN, name="flat", nodes=Nodes.ROWS)
# Stops at large leaves, which the device tests by brute force.
_FRONTIER = replace(_FLAT, name="frontier", frontier=True)

VARIANTS = {
    variant.name: variant
    for variant in (_SEQUENTIAL, _NAIVE, _RANGE, _CACHED, _MEDIAN, _BIN, _ATOMIC, _FLATTEN, _FLAT, _FRONTIER)
}
