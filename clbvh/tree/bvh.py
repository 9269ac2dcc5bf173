"""A finished tree: nodes, the order of the primitives, and the mesh they index.

Knows neither how it was built nor who traverses it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh
from .descent import measure_depth


@dataclass(frozen=True, eq=False)
class Bvh:
    """A flat bounding volume hierarchy in depth-first order.

    Attributes
    ----------
    nodes : (N,) `layout.NODE`
        Row 0 is the root. Siblings are neighbours, and the left child's subtree comes before the right one's.
        There are no unused rows.
    prim_ids : (F,) int32
        A permutation of the mesh's faces: leaf `nodes[i]` holds
        ``prim_ids[first : first + count]``.
    mesh : Mesh
        The mesh that `prim_ids` refers to.
    timings_ms : mapping of str to float
        Milliseconds of wall time of each phase of the build.
    """

    nodes: NDArray[np.void]
    prim_ids: NDArray[np.int32]
    mesh: Mesh
    timings_ms: Mapping[str, float] = field(default_factory=dict)

    @property
    def node_count(self) -> int:
        """Number of nodes, leaves included."""
        return len(self.nodes)

    @cached_property
    def depth(self) -> int:
        """Number of edges from the root to the deepest leaf; 0 for a tree that is one leaf."""
        return measure_depth(self.nodes["first"], self.nodes["count"])

    def __repr__(self) -> str:
        return f"Bvh({self.mesh.name!r}, nodes={self.node_count:,}, depth={self.depth})"
