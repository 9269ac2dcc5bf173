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
        Its name for `clbvh.build`.
    report : str
        Its name in the report.
    does, teaches : str
        Its change against the variant before, and the lesson of the report.
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
    report: str
    does: str
    teaches: str
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


SEQUENTIAL = Variant(
    name="sequential",
    report="sequential baseline",
    does="top-down; a list of primitives per node, sorted on the longest axis, cut at the median; linked nodes",
    teaches="what is right",
)
NAIVE = replace(
    SEQUENTIAL,
    name="naive",
    report="bvh_omp_naive",
    does="the left and the right child are parallel tasks",
    teaches="almost no gain: the sorts at the top are serial",
    parallel=True,
)
RANGE = replace(
    NAIVE,
    name="range",
    report="range recursion",
    does="ranges of one shared index array",
    teaches="no lists to allocate and to copy",
    copies=False,
)
CACHED = replace(
    RANGE,
    name="cached",
    report="cached metadata",
    does="box and centroid of each primitive are computed once, in parallel, before the build",
    teaches="millions of computations less",
    cached=True,
)
MEDIAN = replace(
    CACHED,
    name="median",
    report="nth_element",
    does="the median is selected, in O(n), instead of sorting everything",
    teaches="a node needs its median, not an order",
    how=SELECT,
)
BIN = replace(
    MEDIAN,
    name="bin",
    report="bucket partition, bvh_omp_opt",
    does="a few bins on the longest axis; the cut is the boundary next to the median",
    teaches="about the middle is good enough: 28 % off the build time, and the trees traverse equally well",
    how=BINS,
)
ATOMIC = replace(
    BIN,
    name="atomic",
    report="bvh_omp_pool",
    does="nodes come from one array, by a counter that all workers increment",
    teaches="2.9 times slower there: the counter's cache line travels between the cores",
    nodes=Nodes.COUNTER,
)
FLATTEN = replace(
    BIN,
    name="flatten",
    report="bvh_cpu_gpu",
    does="a separate pass flattens the linked nodes",
    teaches="the pass costs time",
    flattens=True,
)
FLAT = replace(
    BIN,
    name="flat",
    report="bvh_cpu_gpu_flat",
    does="straight into the flat array",
    teaches="the report's final design",
    nodes=Nodes.ROWS,
)
FRONTIER = replace(
    FLAT,
    name="frontier",
    report="frontier hybrid",
    does="stops at large leaves, which the device tests by brute force",
    teaches="saves little build time and loses much kernel time; the best size is between 64 and 256",
    frontier=True,
)

VARIANTS = {
    variant.name: variant
    for variant in (SEQUENTIAL, NAIVE, RANGE, CACHED, MEDIAN, BIN, ATOMIC, FLATTEN, FLAT, FRONTIER)
}
