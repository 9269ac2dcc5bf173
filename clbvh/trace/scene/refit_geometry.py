"""The arrays of one geometry of a scene, refitted to vertices that have moved."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...device.session import DeviceSession
from ...geometry import Mesh
from ...layouts.refit_arrays import RefitArrays
from ...layouts.topology import read_topology
from ...support.host_threads import HostThreads

if TYPE_CHECKING:
    from .device_scene import DeviceScene


class RefitGeometry:
    """Writes the arrays of one geometry, for one mesh after the other.

    Parameters
    ----------
    scene : DeviceScene
        With the geometry as it was built.
    geometry_id : int
        A mesh.
    session : DeviceSession
        A branch of the scene's, for this thread.

    Attributes
    ----------
    bvh : Bvh
        The tree that was built.
    sah_growth : float
        The SAH cost of the tree as it was last written, divided by that of the tree that was built.
    """

    def __init__(self, scene: DeviceScene, geometry_id: int, session: DeviceSession) -> None:
        self.bvh = scene.trees[geometry_id]
        self._built = scene.state.shapes[geometry_id]
        self._built_cost = 0.0
        self.sah_growth = 1.0
        with scene.mapped(session, geometry_id, write=False) as arrays:
            self._arrays = RefitArrays(read_topology(*arrays, scene.layout))

    def write(self, mesh: Mesh, nodes: NDArray[np.void], blocks: NDArray[np.void], threads: HostThreads) -> None:
        """Write nodes and blocks for a mesh; see `RefitArrays.write`."""
        if self._built_cost == 0.0 and isinstance(self._built, Mesh):
            # Only those who move vertices ask how the cost has grown.
            self._arrays.write(self._built, nodes, blocks, threads)
            self._built_cost = self._arrays.sah_cost
        self._arrays.write(mesh, nodes, blocks, threads)
        self.sah_growth = self._arrays.sah_cost / self._built_cost
