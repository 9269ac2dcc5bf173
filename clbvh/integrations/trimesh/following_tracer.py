"""A tracer that follows something of trimesh, a mesh or a scene, which may change between two queries.

Owns the locks, the device's memory, and trying again; and what has changed of a scene, which trimesh's own hashes tell,
of the graph and of each mesh. Meshes are followed by `tracers.py`. Must not know who queries it.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from numbers import Integral
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...device.context import check_process, is_inherited
from ...device.info import DeviceInfo
from ...errors import ConfigError, DeviceError, QueryError, SceneError
from ...geometry import Mesh
from ...scene.handles import Geometry
from ...scene.parts import make_affine
from ...scene.scene import Scene
from ...scene.transforms import check_transforms
from ...trace.device_tree import check_layout
from ...trace.tracer import Tracer

Known = TypeVar("Known")


class EngineOptions(NamedTuple):
    """The options of an engine.

    Attributes
    ----------
    device : DeviceInfo, str, int or None
    layout : str
        Both as `clbvh.Tracer` takes them.
    """

    device: DeviceInfo | str | int | None = None
    layout: str = "auto"


def read_options(device: Any, layout: Any) -> EngineOptions:
    """Return the options of an engine, or raise `ConfigError`; which devices there are is seen by the first query."""
    if not (device is None or isinstance(device, (DeviceInfo, str, Integral))):
        raise ConfigError(f"device must be a clbvh.DeviceInfo, a number, a name or None, not {device!r}")
    check_layout(layout)
    return EngineOptions(int(device) if isinstance(device, Integral) else device, layout)


class FollowingTracer(ABC, Generic[Known]):
    """A tracer that is opened when first needed; `Known` is what is known of the thing that it follows.

    Any number of threads may use one object, as long as none changes the thing meanwhile.

    Parameters
    ----------
    options : EngineOptions
    on_open : function
        Called with this object, under no lock, after it has taken more of the device's memory.

    Attributes
    ----------
    last_use : float
        Seconds on a clock of its own.
    """

    def __init__(self, options: EngineOptions, on_open: Callable[[Any], None]) -> None:
        self.options = options
        self.last_use = 0.0
        self._on_open = on_open
        self._lock = threading.RLock()
        self._tracer: Tracer | None = None
        self._announced_bytes = 0

    def cast(self, thing: Any, query: str, rays: tuple[NDArray[Any], NDArray[Any]], **more: Any) -> Any:
        """Run a ray query of the tracer; rays that it refuses hit nothing."""
        return self.ask(thing, lambda tracer, known: cast_any_rays(tracer, query, rays, **more))

    def close(self) -> None:
        """Give the device's and the host's memory back, after the queries of other threads."""
        if is_inherited():
            return
        with self._lock:
            self._forget()
            tracer = self._take()
        if tracer is not None:
            tracer.close()

    def give_way(self) -> bool:
        """Give the device's memory back, unless a thread is about to use it; return whether it did."""
        if is_inherited() or not self._lock.acquire(blocking=False):
            return False
        try:
            tracer = self._take()
        finally:
            self._lock.release()
        if tracer is not None:
            tracer.close()
        return tracer is not None

    @property
    def open_tracer(self) -> Tracer | None:
        """The tracer, if there is one now."""
        return self._tracer

    @abstractmethod
    def _follow_open(self, thing: Any) -> tuple[Tracer, Known]:
        """Return a tracer of the thing as it is now, and what is known of it; called under the lock."""

    @abstractmethod
    def _forget(self) -> None:
        """Drop what is known of the thing."""

    def _take(self) -> Tracer | None:
        """Return the tracer, which this object no longer has."""
        tracer, self._tracer = self._tracer, None
        return tracer

    def _open_new(self, source: Any) -> Tracer:
        """Open a tracer with the options; its memory is announced anew."""
        device, layout = self.options
        tracer = Tracer(source, device=device, layout=layout)
        self._announced_bytes = 0
        return tracer

    def ask(self, thing: Any, query: Callable[[Tracer, Known], Any]) -> Any:
        """Return `query(tracer, known)`, with a tracer that follows the present state of the mesh or scene."""
        self.last_use = time.monotonic()
        while True:
            tracer, known = self._open(thing)
            try:
                return query(tracer, known)
            except QueryError:
                # Another thread may have closed it meanwhile: try again with a new one.
                if not tracer.is_closed:
                    raise

    def _open(self, thing: Any) -> tuple[Tracer, Known]:
        check_process()
        with self._lock:
            tracer, known = self._follow_open(thing)
            byte_count = tracer.memory_bytes
            has_grown = byte_count > self._announced_bytes
            self._announced_bytes = byte_count
        if has_grown:
            self._on_open(self)
        return tracer, known


def cast_any_rays(tracer: Tracer, query: str, rays: tuple[NDArray[Any], NDArray[Any]], **more: Any) -> Any:
    """Run a query of a tracer; rays that it refuses hit nothing."""
    try:
        return getattr(tracer, query)(*rays, **more)
    except QueryError:
        if rays[0].ndim != 2:
            raise
        origins, directions = (np.array(values, np.float64) for values in rays)
        bad = ~(np.isfinite(origins) & np.isfinite(directions)).all(axis=1) | (directions == 0).all(axis=1)
        if not bad.any():
            raise
        origins[bad], directions[bad] = 0.0, 1.0
        return getattr(tracer, query)(origins, directions, t_max=np.where(bad, -1.0, np.inf), **more)


class SceneNodes(NamedTuple):
    """The nodes of a scene that place a triangle mesh, in the order of its graph.

    Attributes
    ----------
    names : (n,) object
        Names of the nodes.
    geometries : (n,) object
        The name of each node's geometry.
    """

    names: NDArray[np.object_]
    geometries: NDArray[np.object_]

    def is_same(self, other: SceneNodes) -> bool:
        """Return whether the same nodes place the same geometries."""
        return self.names.tolist() == other.names.tolist() and self.geometries.tolist() == other.geometries.tolist()


class _Follower:
    """A scene of ours that was made of one of trimesh, and what it knows of that one; a tracer opens with it.

    Parameters
    ----------
    nodes : SceneNodes
    transforms : (n, 4, 4) float64
    meshes : dict of str to trimesh.Trimesh
        By the name of the geometry.
    graph_key : tuple
        See `_graph_key`.
    """

    def __init__(
        self, nodes: SceneNodes, transforms: NDArray[np.float64], meshes: dict[Any, Any], graph_key: tuple[Any, ...]
    ) -> None:
        self.nodes = nodes
        self.contents = Scene()
        self.contents_of = {name: hash(mesh) for name, mesh in meshes.items()}
        self.geometries: dict[Any, Geometry] = {}
        self.meshes: dict[Any, Mesh] = {}
        for name, mesh in meshes.items():
            self.meshes[name] = Mesh.from_arrays(mesh.vertices, mesh.faces, name=str(name))
            self.geometries[name] = self.contents.add(self.meshes[name])
        for geometry, transform in zip(nodes.geometries, transforms, strict=True):
            self.contents.place(self.geometries[geometry], transform)
        self.transforms = transforms
        self.graph_key = graph_key

    def move(self, tracer: Tracer, transforms: NDArray[np.float64]) -> None:
        """Set the transforms that have changed."""
        moved = np.flatnonzero((self.transforms != transforms).any(axis=(1, 2)))
        if len(moved):
            tracer.set_transforms(moved, transforms[moved])
        self.transforms = transforms

    def deform(self, tracer: Tracer, name: Any, mesh: Any) -> None:
        """Set the vertices of a mesh whose faces are as before."""
        tracer.set_vertices(self.geometries[name], np.asarray(mesh.vertices))
        self.contents_of[name] = hash(mesh)

    def can_deform(self, name: Any, mesh: Any) -> bool:
        """Return whether a mesh has the faces of the one that was known, and as many vertices."""
        return has_faces(self.meshes[name], np.asarray(mesh.vertices), np.asarray(mesh.faces))


class SceneTracer(FollowingTracer["_Follower"]):
    """A tracer of one scene of trimesh: opened when first needed, moved or opened again when the scene has changed."""

    # As long as there is a tracer.
    _follower: _Follower | None = None

    def nodes(self, scene: Any) -> SceneNodes:
        """Return the nodes of the scene as it is now."""
        with self._lock:
            known = self._follower
            if known is not None and known.graph_key == _graph_key(scene):
                return known.nodes
        return _read_nodes(scene)[0]

    def _take(self) -> Tracer | None:
        self._follower = None
        return super()._take()

    def _forget(self) -> None:
        self._follower = None

    def _follow_open(self, scene: Any) -> tuple[Tracer, _Follower]:
        """Return a tracer of the scene as it is now, and what it follows: both new ones if they cannot be moved."""
        tracer, known, key = self._tracer, self._follower, _graph_key(scene)
        if tracer is not None and known is not None and not tracer.is_closed:
            is_as_known = known.graph_key == key
            nodes, transforms = (known.nodes, known.transforms) if is_as_known else _read_nodes(scene)
            if is_as_known or nodes.is_same(known.nodes):
                meshes = ((name, scene.geometry[name]) for name in known.geometries)
                changed = [(name, mesh) for name, mesh in meshes if known.contents_of[name] != hash(mesh)]
                if is_as_known and not changed:
                    return tracer, known
                if all(known.can_deform(name, mesh) for name, mesh in changed):
                    # A change that fails or is interrupted leaves a tracer of nothing that is known: the next is new.
                    self._follower = None
                    try:
                        known.move(tracer, transforms)
                        for name, mesh in changed:
                            known.deform(tracer, name, mesh)
                    except DeviceError:
                        pass  # no room for a second copy: open another one in place of this one
                    else:
                        known.graph_key = key
                        self._follower = known
                        return tracer, known
        self._take()
        if tracer is not None:
            tracer.close()
        nodes, transforms = _read_nodes(scene)
        if len(nodes.names) == 0:
            raise SceneError("the scene has no node with a triangle mesh: rays need a surface")
        follower = _Follower(nodes, transforms, {name: scene.geometry[name] for name in nodes.geometries}, key)
        self._tracer, self._follower = self._open_new(follower.contents), follower
        return self._tracer, follower


def _graph_key(scene: Any) -> tuple[Any, ...]:
    """Return what changes when a node is moved, added or taken away, or gets another geometry."""
    return hash(scene.graph), scene.graph.base_frame, tuple(scene.geometry)


def _read_nodes(scene: Any) -> tuple[SceneNodes, NDArray[np.float64]]:
    """Return the nodes that place triangle meshes, and their transforms, (n, 4, 4) float64.

    Raises
    ------
    SceneError
        A transform is singular, or not finite; the message names the node.
    """
    import trimesh

    rows = []
    for node in scene.graph.nodes_geometry:
        matrix, geometry = scene.graph[node]
        mesh = scene.geometry.get(geometry)
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            rows.append((node, geometry, make_affine(matrix)))
    names, geometries = (np.empty(len(rows), object) for _ in range(2))
    for index, (node, geometry, _) in enumerate(rows):
        names[index], geometries[index] = node, geometry
    matrices = np.array([matrix for _, _, matrix in rows]).reshape(-1, 4, 4)
    transforms = check_transforms(matrices, lambda index: f"the transform of the node {names[index]!r}")
    return SceneNodes(names, geometries), transforms


def has_faces(mesh: Mesh, vertices: NDArray[Any], faces: NDArray[Any]) -> bool:
    """Return whether a mesh has these faces and this number of vertices."""
    return len(mesh.vertices) == len(vertices) and np.array_equal(mesh.faces, faces)
