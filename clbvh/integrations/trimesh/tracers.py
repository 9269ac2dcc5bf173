"""The tracers of all meshes: one per mesh and options, shared by its engines.

The device's memory belongs to the mesh: it goes back when the mesh is collected.
"""

from __future__ import annotations

import threading
import time
from functools import cached_property, partial
from typing import Any, ClassVar
from weakref import WeakValueDictionary, ref

import numpy as np

from ...builders.build import build
from ...bvh import Bvh
from ...bvh.bvh import sah_cost
from ...errors import DeviceError, QueryError
from ...geometry import Mesh
from ...geometry.as_mesh import as_mesh
from ...geometry.smooth_normals import VertexFaces, find_vertex_faces
from ...trace.tracer import Tracer
from .following_tracer import EngineOptions, FollowingTracer, has_faces

# A tree whose SAH cost has grown by more than this factor is built again: rays through a mesh that bends then take
# about twice as long as through a new tree, see docs/tree.md.
_LARGEST_SAH_GROWTH = 2.0


class FollowedTree:
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
        """The faces around each vertex."""
        return find_vertex_faces(self.mesh)


class MeshTracer(FollowingTracer[FollowedTree]):
    """A tree and a tracer of one mesh: built when first needed, updated or built again when the mesh has changed."""

    # Of the tree that the tracer was opened with, which may have been refitted before.
    _growth_at_open = 1.0

    def find_tree(self, mesh: Any) -> Bvh:
        """Return the tree of the mesh as it is now; this needs no device."""
        self.last_use = time.monotonic()
        with self._lock:
            return self._follow(mesh).bvh

    def _follow_open(self, mesh: Any) -> tuple[Tracer, FollowedTree]:
        """Return a tracer of the mesh as it is now, and its tree."""
        tree = self._follow(mesh)
        tracer = self.open_tracer
        if tracer is None or tracer.is_closed:
            tracer, self._growth_at_open = self._open_new(tree.bvh), tree.sah_growth
        return tracer, tree

    def _follow(self, mesh: Any) -> FollowedTree:
        """Return the tree of the mesh as it is now; the tracer, if it is still open, has the same one."""
        content, known = hash(mesh), self._known
        if known is None or known.content != content:
            # A move that fails or is interrupted leaves the tracer with either mesh: no tree is known then.
            self._known = None
            if known is not None:
                known = self._move(content, known.built, mesh) if has_faces(known.mesh, mesh) else None
            if known is None:
                self._give_back()
                bvh = build(Mesh.from_arrays(np.asarray(mesh.vertices), np.asarray(mesh.faces), name="trimesh"))
                known = FollowedTree(content, bvh, bvh.mesh)
            self._known = known
        return known

    def _move(self, content: int, built: Bvh, mesh: Any) -> FollowedTree | None:
        """Return a tree around vertices that have moved, and update the tracer; None if a new one would be faster.

        A tracer that cannot be updated is closed: another thread did so, or the device has no room for a second copy
        of the tree, and perhaps for the first one.
        """
        vertices, tracer = np.asarray(mesh.vertices), self.open_tracer
        if tracer is not None:
            try:
                tracer.update(vertices)
            except (DeviceError, QueryError):
                self._give_back()
            else:
                is_worn = self._growth_at_open * tracer.sah_growth > _LARGEST_SAH_GROWTH
                return None if is_worn else FollowedTree(content, built, tracer.mesh)
        tree = FollowedTree(content, built, built.mesh.with_vertices(vertices))
        return None if tree.sah_growth > _LARGEST_SAH_GROWTH else tree


class _Tracers:
    """Of this process. A callback of the garbage collector takes no lock: it may run while its thread holds one."""

    lock = threading.RLock()
    shared: ClassVar[WeakValueDictionary[tuple[int, EngineOptions], MeshTracer]] = WeakValueDictionary()
    # Those that live as long as a mesh, by its identity. A reference that dies is removed before the identity is free.
    kept: ClassVar[dict[int, tuple[ref[Any], set[MeshTracer]]]] = {}


def read_mesh(thing: Any) -> Any:
    """Return a `trimesh.Trimesh` as it is, and make a new one with the same faces of any other `MeshLike`.

    Raises
    ------
    MeshError
        The argument is not a mesh.
    """
    import trimesh

    if isinstance(thing, trimesh.Trimesh):
        return thing
    mesh = as_mesh(thing)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def find_tracer(mesh: Any, options: EngineOptions, *, keep: bool) -> MeshTracer:
    """Return the tracer of a mesh with these options, which all engines share.

    Parameters
    ----------
    mesh : trimesh.Trimesh
    options : EngineOptions
    keep : bool
        Whether it lives as long as the mesh, and not only as long as somebody refers to it.
    """
    with _Tracers.lock:
        key = (id(mesh), options)
        tracer = _Tracers.shared.get(key)
        if tracer is None:
            tracer = _Tracers.shared[key] = MeshTracer(options)
        if keep:
            entry = _Tracers.kept.get(id(mesh))
            if entry is None:
                entry = _Tracers.kept[id(mesh)] = (ref(mesh, partial(_forget, id(mesh))), set())
            entry[1].add(tracer)
        return tracer


def forget_kept() -> None:
    """Drop the references to tracers that live as long as their meshes; tracers that are still in use stay."""
    _Tracers.kept.clear()


def _forget(mesh_id: int, mesh: ref[Any]) -> None:
    """Drop the tracers of a mesh that is collected."""
    _Tracers.kept.pop(mesh_id, None)


class Installed:
    """The engine that is installed in this process."""

    options: ClassVar[EngineOptions | None] = None


def options_for(mesh: Any) -> EngineOptions:
    """Return the options for proximity queries of a mesh: its ray engine's, the installed engine's, or the default."""
    options = getattr(getattr(mesh, "__dict__", {}).get("ray"), "options", None)
    return options if isinstance(options, EngineOptions) else Installed.options or EngineOptions()
