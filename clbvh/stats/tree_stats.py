"""The parts of a tree and its quality as numbers, and histograms for little space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..bvh.bvh import Bvh, find_depths, sah_cost
from ..layouts.device_arrays import make_device_arrays
from ..tree_layouts import TREE_LAYOUTS
from .overlap import measure_overlap

# The end-point overlap of larger meshes is measured on this many triangles. For the dragon of 871,306 triangles that
# yields 3.628 instead of 3.629, in 0.8 s instead of 3.6 s on one core of an x86-64 server.
OVERLAP_SAMPLE = 200_000


@dataclass(frozen=True)
class TreeStats:
    """The parts of a tree, and measures of its quality.

    Attributes
    ----------
    triangle_count, node_count, interior_count, leaf_count : int
        Every interior node has two children, so leaves outnumber interior nodes by one.
    depth : int
        Edges from the root to the deepest leaf.
    mean_leaf_depth, mean_leaf_size : float
        Over the leaves, each counted once.
    leaf_sizes : tuple of int
        Numbers of leaves with 0, 1, 2, ... triangles.
    leaf_depths : tuple of int
        Numbers of leaves at depth 0, 1, 2, ...
    traversal_cost, intersection_cost : float
        Of an interior node and of a triangle test; the unit of both measures below.
    sah_cost : float
        See `sah_cost`.
    epo : float
        End-point overlap, see `clbvh.stats.overlap.measure_overlap`.
    epo_triangles : int
        The number of triangles that `epo` was measured on: all of them, or a sample.
    host_bytes : int
        `nodes` and `prim_ids`, without the mesh.
    device_bytes : mapping of str to int
        By layout: nodes and blocks of triangles.

    Examples
    --------
    >>> import clbvh
    >>> stats = clbvh.measure_tree(clbvh.build(clbvh.make_shape("icosphere", triangles=1000)))
    >>> stats.triangle_count, stats.node_count == stats.interior_count + stats.leaf_count
    (980, True)
    >>> sum(size * count for size, count in enumerate(stats.leaf_sizes))
    980
    """

    triangle_count: int
    node_count: int
    interior_count: int
    leaf_count: int
    depth: int
    mean_leaf_depth: float
    mean_leaf_size: float
    leaf_sizes: tuple[int, ...]
    leaf_depths: tuple[int, ...]
    traversal_cost: float
    intersection_cost: float
    sah_cost: float
    epo: float
    epo_triangles: int
    host_bytes: int
    device_bytes: Mapping[str, int]

    @property
    def host_bytes_per_triangle(self) -> float:
        """`host_bytes` over the number of triangles."""
        return self.host_bytes / self.triangle_count

    @property
    def device_bytes_per_triangle(self) -> dict[str, float]:
        """`device_bytes` over the number of triangles."""
        return {layout: size / self.triangle_count for layout, size in self.device_bytes.items()}

    def as_dict(self) -> dict[str, Any]:
        """Return all fields and properties as types that JSON has.

        Examples
        --------
        >>> import json
        >>> import clbvh
        >>> stats = clbvh.measure_tree(clbvh.build(clbvh.make_shape("icosphere", triangles=1000)))
        >>> json.loads(json.dumps(stats.as_dict()))["triangle_count"]
        980
        """
        return {
            **asdict(self),
            "host_bytes_per_triangle": self.host_bytes_per_triangle,
            "device_bytes_per_triangle": self.device_bytes_per_triangle,
        }


def measure_tree(
    bvh: Bvh,
    *,
    traversal_cost: float = 1.0,
    intersection_cost: float = 1.0,
    overlap_sample: int | None = OVERLAP_SAMPLE,
) -> TreeStats:
    """Measure a tree.

    Parameters
    ----------
    bvh : Bvh
    traversal_cost, intersection_cost : float
        Cost of an interior node and of one triangle test.
    overlap_sample : int or None
        Most triangles on which the end-point overlap is measured; None for all.

    Returns
    -------
    TreeStats

    Raises
    ------
    ConfigError
        A sample of less than one triangle.

    Examples
    --------
    >>> import clbvh
    >>> bvh = clbvh.build(clbvh.make_shape("icosphere", triangles=1000), leaf_size=4)
    >>> stats = clbvh.measure_tree(bvh)
    >>> stats.mean_leaf_size <= 4 and stats.sah_cost == clbvh.sah_cost(bvh)
    True
    """
    is_leaf = bvh.nodes["count"] > 0
    leaf_sizes = bvh.nodes["count"][is_leaf]
    leaf_depths = find_depths(bvh.nodes)[is_leaf]
    leaf_count = len(leaf_sizes)
    interior_count = bvh.node_count - leaf_count
    overlap = measure_overlap(
        bvh, traversal_cost=traversal_cost, intersection_cost=intersection_cost, sample=overlap_sample
    )
    return TreeStats(
        triangle_count=bvh.mesh.face_count,
        node_count=bvh.node_count,
        interior_count=interior_count,
        leaf_count=leaf_count,
        depth=bvh.depth,
        mean_leaf_depth=float(leaf_depths.mean()),
        mean_leaf_size=float(leaf_sizes.mean()),
        leaf_sizes=tuple(np.bincount(leaf_sizes).tolist()),
        leaf_depths=tuple(np.bincount(leaf_depths).tolist()),
        traversal_cost=float(traversal_cost),
        intersection_cost=float(intersection_cost),
        sah_cost=sah_cost(bvh, traversal_cost=traversal_cost, intersection_cost=intersection_cost),
        epo=overlap.epo,
        epo_triangles=overlap.triangle_count,
        host_bytes=bvh.nodes.nbytes + bvh.prim_ids.nbytes,
        device_bytes={layout: make_device_arrays(bvh, layout).byte_count for layout in TREE_LAYOUTS},
    )


@dataclass(frozen=True)
class Bar:
    """The number of occurrences of the values from `first` to `last`, both included."""

    first: int
    last: int
    count: int

    @property
    def label(self) -> str:
        """The text beside the bar."""
        return str(self.first) if self.first == self.last else f"{self.first} to {self.last}"


def gather_bars(counts: Sequence[int], most_bars: int) -> list[Bar]:
    """Gather a histogram into bars of equal width.

    Parameters
    ----------
    counts : sequence of int
        Numbers of occurrences of 0, 1, 2, ...
    most_bars : int
        The number of bars that fit.

    Returns
    -------
    list of Bar
        From the lowest occurring value to the highest; empty if none occurs.
    """
    occurring = [value for value, count in enumerate(counts) if count > 0]
    if not occurring:
        return []
    first, last = occurring[0], occurring[-1]
    width = -(-(last + 1 - first) // most_bars)
    return [
        Bar(begin, min(begin + width - 1, last), sum(counts[begin : begin + width]))
        for begin in range(first, last + 1, width)
    ]
