"""A tracer that follows a mesh of trimesh, which may change between two queries.

Must not know who queries it, nor which other meshes there are: that is `tracers.py`.
"""

from __future__ import annotations

import time
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...builders.build import build
from ...bvh import Bvh
from ...bvh.sah_cost import sah_cost
from ...errors import DeviceError, MeshError, QueryError
from ...geometry import Mesh
from ...geometry.appearance.normals import VertexFaces, find_vertex_faces
from ...trace import ClosestPoints, Tracer
from ...trace.points.facing import choose_facing
from ...trace.points.nearest_vertex import find_nearest_vertices
from .following_tracer import FollowingTracer

# A tree whose SAH cost has grown by more than this factor is built again: rays through a mesh that bends then take
# about twice as long as through a new tree, see docs/tree.md.
_LARGEST_SAH_GROWTH = 2.0


class _FollowedTree:
    """The tree of a mesh as it was when it had this content.

    Parameters
    ----------
    content : int
    built : Bvh
        As it was built, perhaps around other vertices.
    mesh : Mesh
        As it is now, with the same faces.
    """

    def __init__(self, content: int, built: Bvh, mesh: Mesh) -> None:
        self.content = content
        self.built = built
        self.mesh = mesh

    @cached_property
    def bvh(self) -> Bvh:
        """The tree around the vertices as they are now; a tracer that was updated does not need it."""
        return self.built if self.mesh is self.built.mesh else self.built.refit(self.mesh.vertices)

    @cached_property
    def sah_growth(self) -> float:
        """The SAH cost of the tree now, divided by its cost when it was built."""
        return 1.0 if self.bvh is self.built else sah_cost(self.bvh) / sah_cost(self.built)

    @cached_property
    def vertex_faces(self) -> VertexFaces:
        return find_vertex_faces(self.mesh)


class MeshTracer(FollowingTracer["_FollowedTree"]):
    """A tree and a tracer of one mesh: built when first needed, updated or built again when the mesh has changed."""

    _tree: _FollowedTree | None = None
    # Of the tree that the tracer was opened with, which may have been refitted before.
    _growth_at_open = 1.0

    def closest_point(self, mesh: Any, points: NDArray[np.float64], tolerance: float) -> ClosestPoints:
        """Return the closest points of the surface; of faces that are equally near, the one that faces the point.

        Parameters
        ----------
        mesh : trimesh.Trimesh
        points : (n, 3) float64
        tolerance : float, the mesh's unit squared
            Squared distances that differ by less are equal.
        """

        def find(tracer: Tracer, tree: _FollowedTree) -> ClosestPoints:
            closest = tracer.closest_point(points)
            choose_facing(points, tree.mesh, tree.vertex_faces, tolerance, closest)
            return closest

        return self._ask(mesh, find)

    def nearest_vertex(self, mesh: Any, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return the distance to the nearest vertex, and its index; this works on the host."""
        self.last_use = time.monotonic()
        return find_nearest_vertices(self._follow(mesh).bvh, points)

    def _forget(self) -> None:
        self._tree = None

    def _follow_open(self, mesh: Any) -> tuple[Tracer, _FollowedTree]:
        """Return a tracer of the mesh as it is now, and its tree."""
        tree = self._follow(mesh)
        if self._tracer is None:
            self._tracer = self._open_new(tree.bvh)
            self._growth_at_open = tree.sah_growth
        return self._tracer, tree

    def _follow(self, mesh: Any) -> _FollowedTree:
        """Return the tree of the mesh as it is now; the tracer, if it is still open, has the same one."""
        with self._lock:
            content = hash(mesh)
            known = self._tree
            if known is not None and known.content == content:
                return known
            vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
            if known is not None and has_faces(known.mesh, vertices, faces):
                # Ctrl-C leaves the tracer with either mesh: no tree is known until it has the new one.
                self._tree = None
                try:
                    self._tree = tree = self._move(content, known.built, vertices)
                except MeshError:
                    self._tree = known
                    raise
                if tree is not None:
                    return tree
            self._give_back()
            self._tree = known = None  # no two trees at once
            bvh = build(Mesh.from_arrays(vertices, faces, name="trimesh"))
            tree = self._tree = _FollowedTree(content, bvh, bvh.mesh)
            return tree

    def _move(self, content: int, built: Bvh, vertices: NDArray[Any]) -> _FollowedTree | None:
        """Return a tree around vertices that have moved, and update the tracer; None if a new one would be faster.

        A tracer that cannot be updated is closed: another thread did so, or the device has no room for a second copy
        of the tree, and perhaps for the first one.
        """
        tracer = self._tracer
        if tracer is not None:
            try:
                tracer.update(vertices)
            except (DeviceError, QueryError):
                self._give_back()
            else:
                is_worn = self._growth_at_open * tracer.sah_growth > _LARGEST_SAH_GROWTH
                return None if is_worn else _FollowedTree(content, built, tracer.mesh)
        tree = _FollowedTree(content, built, built.mesh.with_vertices(vertices))
        return None if tree.sah_growth > _LARGEST_SAH_GROWTH else tree

    def _give_back(self) -> None:
        with self._lock:
            tracer = self._take()
        if tracer is not None:
            tracer.close()


def has_faces(mesh: Mesh, vertices: NDArray[Any], faces: NDArray[Any]) -> bool:
    """Return whether a mesh has these faces and this number of vertices."""
    return len(mesh.vertices) == len(vertices) and np.array_equal(mesh.faces, faces)
