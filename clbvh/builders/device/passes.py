"""The passes of a build over all clusters: their tiles, and how many clusters they leave, from the numbers alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# The most clusters of a tile, as cl/tree/tile.cl has it, and how many are left of one; of the last tile one is.
TILE_SIZE = 512
CLUSTERS_LEFT = 32


class Pass(NamedTuple):
    """One pass: all tiles of its clusters, whose sizes differ by one at most.

    Attributes
    ----------
    cluster_count, tile_count : int
    target : int
        Clusters that are left of each tile.
    first_merge : int
        Number of the first merge; each merge leaves one cluster less.
    levels_above : int
        Height that the later passes add at least, if they pair neighbours.
    """

    cluster_count: int
    tile_count: int
    target: int
    first_merge: int
    levels_above: int

    def as_arguments(self) -> dict[str, np.int32]:
        """Return the arguments of the kernels."""
        return {name: np.int32(value) for name, value in self._asdict().items()}


def plan_passes(prim_count: int) -> list[Pass]:
    """Return the passes until one cluster is left; none for one primitive."""
    passes = []
    cluster_count, first_merge = prim_count, 0
    while cluster_count > 1:
        tile_count = -(-cluster_count // TILE_SIZE)
        target = CLUSTERS_LEFT if tile_count > 1 else 1
        passes.append(Pass(cluster_count, tile_count, target, first_merge, 0))
        first_merge += cluster_count - target * tile_count
        cluster_count = target * tile_count
    levels_above = 0
    for number, each in reversed(list(enumerate(passes))):
        passes[number] = each._replace(levels_above=levels_above)
        largest_tile = -(-each.cluster_count // each.tile_count)
        # By halves down to the target.
        levels_above += (-(-largest_tile // each.target) - 1).bit_length()
    return passes
