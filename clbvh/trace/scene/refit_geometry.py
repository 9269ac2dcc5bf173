"""The arrays of one geometry of a scene, refitted to vertices or spheres that have moved."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...device.session import DeviceSession
from ...geometry import Shape
from ...layouts.refit_arrays import RefitArrays
from ...layouts.topology import read_topology
from ...support.host_threads import HostThreads

if TYPE_CHECKING:
    from .device_scene import DeviceScene


class RefitGeometry:
    """Writes the arrays of one geometry, for one shape after the other.

    Parameters
    ----------
    scene : DeviceScene
        With the geometry as it is now.
    geometry_id : int
    session : DeviceSession
        A branch of the scene's, for this thread.
    growth_before : float
        The SAH cost of the tree in the scene, divided by that of the tree that was built.

    Attributes
    ----------
    bvh : Bvh
        The tree in the scene.
    sah_growth : float
        The SAH cost of the tree as it was last written, divided by that of the tree that was built.
    """

    def __init__(
        self, scene: DeviceScene, geometry_id: int, session: DeviceSession, growth_before: float = 1.0
    ) -> None:
        self.bvh = scene.trees[geometry_id]
        self._first = scene.state.shapes[geometry_id]
        self._first_cost = 0.0
        self._growth_before = self.sah_growth = growth_before
        with scene.mapped(session, geometry_id, write=False) as arrays:
            self._arrays = RefitArrays(read_topology(*arrays, scene.layout))

    def write(self, shape: Shape, nodes: NDArray[np.void], blocks: NDArray[np.void], threads: HostThreads) -> None:
        """Write nodes and blocks for a shape; see `RefitArrays.write`."""
        if self._first_cost == 0.0:
            # Only those who move a geometry ask how the cost has grown.
            self._arrays.write(self._first, nodes, blocks, threads)
            self._first_cost = self._arrays.sah_cost
        self._arrays.write(shape, nodes, blocks, threads)
        self.sah_growth = self._growth_before * self._arrays.sah_cost / self._first_cost
