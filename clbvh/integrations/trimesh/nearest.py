"""What trimesh calls nearest: the face that faces a point most directly, and the nearest vertex.

For most points outside a mesh, the closest point is on an edge or a vertex, which belongs to several faces. The device
returns the face with the smallest number. trimesh returns the face whose normal points to the point most directly, and
this module chooses the same.

The closest point of the surface does not tell the nearest vertex, which may belong to another face. A k-d tree of the
vertices would be a second tree; the boxes of the first one hold the vertices as well.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...device.host.loops import Loops
from ...geometry import Mesh
from ...support.host_threads import HostThreads
from ...trace.points.refine import ClosestPoints

_LOOPS = Loops("trimesh/nearest")


def choose_facing(
    points: NDArray[np.float64],
    mesh: Mesh,
    around: tuple[NDArray[np.int64], ...],
    tolerance: float,
    closest: ClosestPoints,
) -> None:
    """Replace each face by the one that faces the point most directly, among equally near ones around it.

    Parameters
    ----------
    points : (n, 3) float64, contiguous, the file's coordinates
    mesh : Mesh
    around : the mesh's `CornerFaces`, widened
    tolerance : float, the file's unit squared
        Squared distances that differ by less are equal; points as near as this to the surface keep their faces.
    closest : ClosestPoints of the points, contiguous, written
        With the point and the distance of the face that is chosen.

    Notes
    -----
    Candidates are the faces that share a vertex with the face that was found. A nearer one replaces it, too, because
    the device chooses in float32. Of equally direct ones, the smallest number wins.
    """
    geometry = mesh.vertices, mesh.faces, mesh.scale, mesh.origin
    squared_tolerance = tolerance * mesh.scale * mesh.scale

    def choose(begin: int, end: int) -> None:
        part = (values[begin:end] for values in closest)
        _LOOPS.choose(points[begin:end], *geometry, *around, squared_tolerance, *part)

    with HostThreads() as threads:
        threads.for_ranges(len(points), choose)


def find_nearest_vertices(bvh: Bvh, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the distance to the nearest vertex of a tree's mesh, and its index, for each point.

    Parameters
    ----------
    bvh : Bvh
    points : (n, 3) float64, the file's coordinates
        Finite.

    Returns
    -------
    distance : (n,) float64, the file's unit
    vertex_id : (n,) int64
        At equal distance the smallest. Vertices without a face count, too; each of them is compared.
    """
    mesh = bvh.mesh
    points = np.ascontiguousarray(points, np.float64)
    geometry = mesh.vertices, mesh.faces, mesh.scale, mesh.origin
    tree, vertex_id = (bvh.nodes, bvh.prim_ids, mesh.loose_vertices), np.empty(len(points), np.int64)

    def find(begin: int, end: int) -> None:
        # A descent leaves one sibling behind at each level.
        stack = np.empty((bvh.depth + 2, 2), np.int64)
        _LOOPS.find_vertices(points[begin:end], *geometry, *tree, stack, vertex_id[begin:end])

    with HostThreads() as threads:
        threads.for_ranges(len(points), find)
    x, y, z = (mesh.vertices[vertex_id] - points).T
    # Squares may overflow or underflow float64.
    return np.hypot(np.hypot(x, y), z), vertex_id
