"""The cost of rays: node steps and triangle tests, counted on the host, step for step as in `cl/traversal/bvh2.cl`.

A measure of trees that does not depend on a machine's speed, and needs no OpenCL device. Boxes, the order of children
and culling are those of the device, and so is float32. Only the edge functions are computed another way, which may
change the last bit of `t`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...bvh import Bvh
from ...layouts.device_arrays import make_device_arrays
from ...structs import PACKED_RAY
from ...support.host_threads import HostThreads
from ...support.ranges import cut_range
from ..rays.batch import TreeBox, read_rays
from ..rays.pack import pack_rays
from .descend import HostTrees, PackedRays, TreeStart, descend

# Rays that a thread takes at a time: rays of one picture differ much in their steps, so threads take many small shares.
_CHUNK_RAYS = 1 << 14

_FIELDS = 4


@dataclass(frozen=True, eq=False)
class Visits:
    """Counts for each ray.

    Attributes
    ----------
    node_steps : (n,) int32
        Interior nodes visited. Each step tests the boxes of both children.
    leaf_visits : (n,) int32
        Leaves visited.
    triangle_tests : (n,) int32
        Triangles tested in those leaves.
    prim_id : (n,) int32
        Face that the ray hits; -1 on a miss. With `any_hit`, the first one found.
    """

    node_steps: NDArray[np.int32]
    leaf_visits: NDArray[np.int32]
    triangle_tests: NDArray[np.int32]
    prim_id: NDArray[np.int32]

    @property
    def node_steps_per_ray(self) -> float:
        """The mean of `node_steps`; 0 without rays, as all means here."""
        return _mean(self.node_steps)

    @property
    def leaf_visits_per_ray(self) -> float:
        """The mean of `leaf_visits`."""
        return _mean(self.leaf_visits)

    @property
    def triangle_tests_per_ray(self) -> float:
        """The mean of `triangle_tests`."""
        return _mean(self.triangle_tests)

    @property
    def tests_per_ray(self) -> float:
        """Mean of node steps plus triangle tests: what the SAH cost estimates, with both costs 1."""
        return self.node_steps_per_ray + self.triangle_tests_per_ray

    @property
    def visits_per_ray(self) -> float:
        """Mean number of nodes visited, interior nodes and leaves."""
        return self.node_steps_per_ray + self.leaf_visits_per_ray


def _mean(counts: NDArray[np.int32]) -> float:
    return float(counts.mean(dtype=np.float64)) if len(counts) else 0.0


def count_visits(
    bvh: Bvh,
    origins: ArrayLike,
    directions: ArrayLike,
    *,
    t_min: ArrayLike = 0.0,
    t_max: ArrayLike = np.inf,
    any_hit: bool = False,
) -> Visits:
    """Cast rays on the host and count their steps.

    Parameters
    ----------
    bvh : Bvh
    origins, directions, t_min, t_max
        See `Tracer.closest_hit`.
    any_hit : bool, optional
        Stop at the first triangle that is hit, as `Tracer.any_hit` does.

    Returns
    -------
    Visits

    Raises
    ------
    QueryError
        See `Tracer.closest_hit`.

    Notes
    -----
    In this thread: about a million node steps in 10 ms.
    """
    return HostTraversal(bvh).count_visits(origins, directions, t_min=t_min, t_max=t_max, any_hit=any_hit)


class HostTraversal:
    """A tree that is ready to be traversed on the host, by compiled code, in any number of threads.

    Parameters
    ----------
    bvh : Bvh
    """

    def __init__(self, bvh: Bvh) -> None:
        arrays = make_device_arrays(bvh, "bvh2")
        self._trees = HostTrees.join([arrays.nodes], [arrays.blocks], [])
        self._start = TreeStart(0, 0, False, max(1, bvh.depth))
        self._box = TreeBox.around(bvh)

    def count_visits(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        t_min: ArrayLike = 0.0,
        t_max: ArrayLike = np.inf,
        any_hit: bool = False,
        threads: HostThreads | None = None,
    ) -> Visits:
        """Cast rays and count their steps; see the function `count_visits`.

        Parameters
        ----------
        origins, directions, t_min, t_max, any_hit
            See `count_visits`.
        threads : HostThreads, optional
            Threads that share the rays. Without them the calling thread casts all.
        """
        batch, _ = read_rays(origins, directions, t_min, t_max)
        rays = np.empty(batch.ray_count, PACKED_RAY)
        counts = np.zeros((batch.ray_count, _FIELDS), np.int32)
        nearest = np.empty(batch.ray_count, np.float32)

        def cast(begin: int, end: int) -> None:
            part = rays[begin:end]
            pack_rays(batch, batch.part(begin, end), self._box, part)
            packed = PackedRays(part["origin"], part["direction"], part["t_min"], part["t_max"])
            descend(self._trees, self._start, packed, any_hit, counts[begin:end], nearest[begin:end])

        if threads is None:
            cast(0, batch.ray_count)
        else:
            threads.run(cast, cut_range(0, batch.ray_count, -(-batch.ray_count // _CHUNK_RAYS)))
        return Visits(*np.ascontiguousarray(counts.T))
