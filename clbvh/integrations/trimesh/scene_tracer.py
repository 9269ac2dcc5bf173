"""A tracer that follows a `trimesh.Scene`: trimesh's own hashes, of the graph and of meshes, tell what has changed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import DeviceError, SceneError
from ...geometry import Mesh
from ...scene.handles import Geometry
from ...scene.parts import make_affine
from ...scene.scene import Scene
from ...scene.transforms import check_transforms
from ...trace.tracer import Tracer
from .following_tracer import FollowingTracer, has_faces

# The names of a node that places a triangle mesh, and of its geometry.
Node = tuple[Any, Any]


class FollowedScene:
    """A scene of ours that was made of one of trimesh, and what it knows of that one.

    Attributes
    ----------
    contents : Scene
    nodes : list of Node
        In the order of the graph, as are the instances.
    """

    def __init__(self, scene: Any) -> None:
        self.graph_key = _graph_key(scene)
        self.nodes, self._transforms = _read_nodes(scene)
        if not self.nodes:
            raise SceneError("the scene has no node with a triangle mesh: rays need a surface")
        self.contents = Scene()
        self._hashes: dict[Any, int] = {}
        self._meshes: dict[Any, Mesh] = {}
        self._geometries: dict[Any, Geometry] = {}
        for name in dict.fromkeys(name for _, name in self.nodes):
            mesh = scene.geometry[name]
            self._hashes[name] = hash(mesh)
            self._meshes[name] = Mesh.from_arrays(mesh.vertices, mesh.faces, name=str(name))
            self._geometries[name] = self.contents.add(self._meshes[name])
        for (_, name), transform in zip(self.nodes, self._transforms, strict=True):
            self.contents.place(self._geometries[name], transform)

    def move(self, tracer: Tracer, scene: Any) -> bool:
        """Let a tracer of this scene follow the one of trimesh; return False where only a new tracer can."""
        graph_key = _graph_key(scene)
        is_as_known = graph_key == self.graph_key
        nodes, transforms = (self.nodes, self._transforms) if is_as_known else _read_nodes(scene)
        if nodes != self.nodes:
            return False
        hashes = {name: hash(scene.geometry[name]) for name in self._hashes}
        changed = {name: scene.geometry[name] for name in hashes if hashes[name] != self._hashes[name]}
        if not all(has_faces(self._meshes[name], mesh) for name, mesh in changed.items()):
            return False
        moved = np.flatnonzero((self._transforms != transforms).any(axis=(1, 2)))
        try:
            if len(moved):
                tracer.set_transforms(moved, transforms[moved])
            for name, mesh in changed.items():
                tracer.set_vertices(self._geometries[name], np.asarray(mesh.vertices))
        except DeviceError:
            return False  # no room for a second copy
        self.graph_key, self._transforms, self._hashes = graph_key, transforms, hashes
        return True


class SceneTracer(FollowingTracer[FollowedScene]):
    """A tracer of one scene of trimesh: opened when first needed, moved or opened again when the scene has changed."""

    def nodes(self, scene: Any) -> list[Node]:
        """Return the nodes of the scene as it is now."""
        with self._lock:
            known = self._known
            if known is not None and known.graph_key == _graph_key(scene):
                return known.nodes
        return _read_nodes(scene)[0]

    def _follow_open(self, scene: Any) -> tuple[Tracer, FollowedScene]:
        """Return a tracer of the scene as it is now, and what it follows: both new ones if they cannot be moved."""
        tracer, known = self.open_tracer, self._known
        # A move that fails or is interrupted leaves a tracer of nothing that is known: the next is new.
        self._known = None
        if tracer is None or known is None or tracer.is_closed or not known.move(tracer, scene):
            self._give_back()
            known = FollowedScene(scene)
            tracer = self._open_new(known.contents)
        self._known = known
        return tracer, known


def _graph_key(scene: Any) -> tuple[Any, ...]:
    """Return what changes when a node is moved, added or taken away, or gets another geometry."""
    return hash(scene.graph), scene.graph.base_frame, tuple(scene.geometry)


def _read_nodes(scene: Any) -> tuple[list[Node], NDArray[np.float64]]:
    """Return the nodes that place triangle meshes, and their transforms, (n, 4, 4) float64.

    Raises
    ------
    SceneError
        A transform is singular, or not finite; the message names the node.
    """
    import trimesh

    nodes, matrices = [], []
    for node in scene.graph.nodes_geometry:
        matrix, geometry = scene.graph[node]
        mesh = scene.geometry.get(geometry)
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            nodes.append((node, geometry))
            matrices.append(make_affine(matrix))
    transforms = np.array(matrices).reshape(-1, 4, 4)
    return nodes, check_transforms(transforms, lambda index: f"the transform of the node {nodes[index][0]!r}")
