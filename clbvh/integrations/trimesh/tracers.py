"""The tracers of all meshes and scenes of trimesh: one for each and its options, shared by its engines.

Owns the state of each followed mesh or scene, its lock, the second attempt after another thread's close, and the bound
of the device's memory. Knows nothing of queries.

A mesh of trimesh and its engines refer to each other, so its memory goes back when Python's garbage collector runs,
which counts objects and not their bytes: hence the bound.
"""

from __future__ import annotations

import gc
import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Integral
from typing import Any, ClassVar, NamedTuple
from weakref import WeakValueDictionary, ref

import numpy as np
import trimesh
from numpy.typing import NDArray

from ...builders.build import build
from ...bvh import Bvh
from ...bvh.bvh import sah_cost
from ...device.info import DeviceInfo
from ...errors import ConfigError, DeviceError, QueryError, SceneError
from ...geometry import Mesh
from ...geometry.as_mesh import as_mesh
from ...geometry.loading.file_parts import POINT, find_hidden
from ...geometry.loading.trimesh import make_affine
from ...geometry.smooth_normals import VertexFaces, find_vertex_faces
from ...scene.handles import Geometry
from ...scene.scene import Scene
from ...scene.transforms import check_transforms
from ...support.forks import make_lock
from ...trace.tracer import Tracer
from ...trace.world.trees import check_layout

# A tracer builds a worn tree anew by itself. One that is opened again gets a new tree where the SAH cost has grown by
# more than this factor.
_LARGEST_SAH_GROWTH = 2.0

# The names of a node that places a triangle mesh, and of its geometry.
Node = tuple[Any, Any]


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


class Installed:
    """The engine that is installed in this process."""

    options: ClassVar[EngineOptions | None] = None


def options_for(mesh: Any) -> EngineOptions:
    """Return the options for proximity queries of a mesh: its ray engine's, the installed engine's, or the default."""
    options = getattr(getattr(mesh, "__dict__", {}).get("ray"), "options", None)
    return options if isinstance(options, EngineOptions) else Installed.options or EngineOptions()


def read_mesh(thing: Any) -> Any:
    """Return a `trimesh.Trimesh` as it is, and make a new one with the same faces of any other `MeshLike`.

    Raises
    ------
    MeshError
        The argument is not a mesh.
    """
    if isinstance(thing, trimesh.Trimesh):
        return thing
    mesh = as_mesh(thing)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


@dataclass(eq=False)
class FollowedMesh:
    """A mesh of trimesh as it was seen last, and the tree that was built when its vertices were perhaps elsewhere.

    The tree needs no device, and outlives the tracer.

    Attributes
    ----------
    content : int
        Trimesh's hash of the mesh.
    mesh : Mesh
    built : Bvh
    """

    content: int
    mesh: Mesh
    built: Bvh

    @classmethod
    def read(cls, source: Any) -> FollowedMesh:
        """Read and build a mesh of trimesh."""
        mesh = Mesh.from_arrays(np.asarray(source.vertices), np.asarray(source.faces), name="trimesh")
        return cls(hash(source), mesh, build(mesh))

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

    def open(self, options: EngineOptions) -> Tracer:
        """Open a tracer of the mesh as it is now."""
        return Tracer(self.bvh, device=options.device, layout=options.layout)

    def follow(self, source: Any, tracer: Tracer | None) -> FollowedMesh | None:
        """Return the mesh as it is now, and update the tracer; None if it has other faces, or needs a new tree.

        A tracer that cannot be updated is closed, and the query opens another one: the device has no room for a second
        copy of the tree, and perhaps for the first one, or another thread has closed it.
        """
        content = hash(source)
        if content == self.content:
            return self
        if not _has_faces(self.mesh, source):
            return None
        vertices = np.asarray(source.vertices)
        if tracer is not None:
            try:
                tracer.update(vertices)
            except (DeviceError, QueryError):
                tracer.close()
            else:
                return replace(self, content=content, mesh=tracer.mesh)
        moved = replace(self, content=content, mesh=self.built.mesh.with_vertices(vertices))
        return moved if moved.sah_growth <= _LARGEST_SAH_GROWTH else None


class FollowedScene:
    """A scene of trimesh as it was seen last, and the scene of ours that its tracer is opened with.

    Raises
    ------
    MeshError, SceneError
        A mesh or a node cannot be used, or there is none.

    Attributes
    ----------
    graph : tuple
        See `read_graph`.
    nodes : list of Node
        Those that are not hidden, in the order of the graph, as are the instances.
    """

    def __init__(self, source: Any) -> None:
        self.graph, (self.nodes, self._transforms) = read_graph(source), read_nodes(source)
        if not _list_nodes(source)[0]:
            raise SceneError("the scene has no node with a triangle mesh: rays need a surface")
        self._hashes: dict[Any, int] = {}
        self._geometries: dict[Any, Geometry] = {}
        self._scene = Scene()
        for name in dict.fromkeys(name for _, name in self.nodes):
            mesh = source.geometry[name]
            self._hashes[name] = hash(mesh)
            self._geometries[name] = self._scene.add(Mesh.from_arrays(mesh.vertices, mesh.faces, name=str(name)))
        for (_, name), transform in zip(self.nodes, self._transforms, strict=True):
            self._scene.place(self._geometries[name], transform)
        if self._scene.is_empty:
            self._scene.place(self._scene.add(Mesh.from_arrays(*POINT, name="hidden")))

    def open(self, options: EngineOptions) -> Tracer:
        """Open a tracer of the scene as it was read."""
        return Tracer(self._scene, device=options.device, layout=options.layout)

    def follow(self, source: Any, tracer: Tracer | None) -> FollowedScene | None:
        """Move the tracer to the scene as it is now; return None where only a new one can follow.

        After that, an error or an interrupt, neither is of use.
        """
        if tracer is None:
            return None
        graph = read_graph(source)
        nodes, transforms = (self.nodes, self._transforms) if graph == self.graph else read_nodes(source)
        if nodes != self.nodes:
            return None
        hashes = {name: hash(source.geometry[name]) for name in self._hashes}
        changed = {name: source.geometry[name] for name in hashes if hashes[name] != self._hashes[name]}
        if not all(_has_faces(self._geometries[name].shape, mesh) for name, mesh in changed.items()):
            return None
        moved = np.flatnonzero((self._transforms != transforms).any(axis=(1, 2)))
        try:
            if len(moved):
                tracer.set_transforms(moved, transforms[moved])
            for name, mesh in changed.items():
                tracer.set_vertices(self._geometries[name], np.asarray(mesh.vertices))
        except (DeviceError, QueryError):
            return None  # no room for a second copy, or closed by another thread
        self.graph, self._transforms, self._hashes = graph, transforms, hashes
        return self


def read_graph(scene: Any) -> tuple[Any, ...]:
    """Return what changes when a node is moved, added or taken away, or gets another geometry."""
    return hash(scene.graph), scene.graph.base_frame, *scene.geometry


def read_nodes(scene: Any) -> tuple[list[Node], NDArray[np.float64]]:
    """Return the nodes that place triangle meshes and are not hidden, and their transforms, (n, 4, 4) float64.

    Raises
    ------
    SceneError
        A transform is not finite; the message names the node.
    """
    nodes, matrices = _list_nodes(scene)
    is_shown = ~find_hidden(matrices)
    shown = list(itertools.compress(nodes, is_shown))
    return shown, check_transforms(matrices[is_shown], lambda index: f"the transform of the node {shown[index][0]!r}")


def _list_nodes(scene: Any) -> tuple[list[Node], NDArray[np.float64]]:
    """Return all nodes that place triangle meshes, and their transforms, (n, 4, 4) float64."""
    nodes, matrices = [], []
    for node in scene.graph.nodes_geometry:
        matrix, geometry = scene.graph[node]
        mesh = scene.geometry.get(geometry)
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            nodes.append((node, geometry))
            matrices.append(make_affine(matrix))
    return nodes, np.array(matrices).reshape(-1, 4, 4)


def _has_faces(known: Any, mesh: Any) -> bool:
    """Return whether a mesh of trimesh has the faces of the `Mesh` that was known, and as many vertices."""
    return len(known.vertices) == len(mesh.vertices) and np.array_equal(known.faces, mesh.faces)


class FollowingTracer:
    """A tracer of a mesh or a scene of trimesh, which may change between two queries: opened when first needed.

    Any number of threads may use one object, as long as none changes the mesh or the scene meanwhile.

    Parameters
    ----------
    options : EngineOptions

    Attributes
    ----------
    last_use : float
        Seconds on a clock of its own.
    open_tracer : Tracer or None
        The tracer, if there is one now.
    """

    def __init__(self, options: EngineOptions) -> None:
        self.options = options
        self.last_use = 0.0
        self.open_tracer: Tracer | None = None
        self._known: Any = None  # a FollowedMesh or a FollowedScene
        self._counted_bytes = 0
        self._lock = make_lock()

    def cast(self, thing: Any, query: str, rays: tuple[NDArray[Any], NDArray[Any]], **more: Any) -> Any:
        """Run a ray query of the tracer; rays that it refuses hit nothing."""
        return self.ask(thing, lambda tracer, known: _cast_any_rays(tracer, query, rays, **more))

    def ask(self, thing: Any, query: Callable[[Tracer, Any], Any]) -> Any:
        """Return `query(tracer, known)`, with a tracer of the mesh or the scene as it is now."""
        self.last_use = time.monotonic()
        while True:
            with self._lock:
                known = self._follow(thing)
                tracer = self.open_tracer
                if tracer is None:
                    self.open_tracer = tracer = known.open(self.options)
                    self._counted_bytes = 0
                before, self._counted_bytes = self._counted_bytes, tracer.memory_bytes
                has_grown = before < self._counted_bytes
            if has_grown:
                make_room(self, tracer.device)
            try:
                return query(tracer, known)
            except QueryError:
                # Another thread may have closed it meanwhile: try again with a new one.
                if not tracer.is_closed:
                    raise

    def nodes(self, scene: Any) -> list[Node]:
        """Return the nodes of the scene as it is now."""
        known = self._known
        return known.nodes if known is not None and known.graph == read_graph(scene) else read_nodes(scene)[0]

    def find_tree(self, mesh: Any) -> Bvh:
        """Return the tree of the mesh as it is now; this needs no device."""
        self.last_use = time.monotonic()
        with self._lock:
            return self._follow(mesh).bvh

    def close(self) -> None:
        """Give the device's and the host's memory back, after the queries of other threads."""
        with self._lock:
            self._known = None
            self._give_back()

    def give_way(self) -> bool:
        """Give the device's memory back, unless a thread is about to use it; return whether it did."""
        if not self._lock.acquire(blocking=False):
            return False
        try:
            return self._give_back()
        finally:
            self._lock.release()

    def _follow(self, thing: Any) -> Any:
        """Return the mesh or the scene as it is now; the tracer, if it is open, has the same one."""
        if self.open_tracer is not None and self.open_tracer.is_closed:
            self._give_back()
        # A change that fails or is interrupted leaves a tracer of nothing that is known: the next is new.
        known, self._known = self._known, None
        if known is not None:
            known = known.follow(thing, self.open_tracer)
        if known is None:
            self._give_back()
            known = FollowedScene(thing) if isinstance(thing, trimesh.Scene) else FollowedMesh.read(thing)
        self._known = known
        return known

    def _give_back(self) -> bool:
        """Close the tracer, and return whether there was one; called under the lock."""
        tracer, self.open_tracer = self.open_tracer, None
        if tracer is not None:
            tracer.close()
        return tracer is not None


def _cast_any_rays(tracer: Tracer, query: str, rays: tuple[NDArray[Any], NDArray[Any]], **more: Any) -> Any:
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


_lock = make_lock()
_shared: WeakValueDictionary[tuple[int, EngineOptions], FollowingTracer] = WeakValueDictionary()

# Tracers that live as long as a mesh, by its identity. A reference that dies is removed before the identity is free,
# by a callback of the garbage collector, which takes no lock: it may run while its thread holds one.
kept: dict[int, tuple[ref[Any], set[FollowingTracer]]] = {}


def find_tracer(thing: Any, options: EngineOptions, *, keep: bool) -> FollowingTracer:
    """Return the tracer of a mesh or a scene with these options, which all engines share.

    Parameters
    ----------
    thing : trimesh.Trimesh or trimesh.Scene
    options : EngineOptions
    keep : bool
        Whether it lives as long as the mesh, and not only as long as somebody refers to it.
    """
    thing_id = id(thing)
    with _lock:
        tracer = _shared.get((thing_id, options))
        if tracer is None:
            tracer = _shared[thing_id, options] = FollowingTracer(options)
        if keep:
            if thing_id not in kept:
                kept[thing_id] = ref(thing, lambda _: kept.pop(thing_id, None)), set()
            kept[thing_id][1].add(tracer)
        return tracer


# After this many trees have gone to a device, meshes that nobody uses are collected: a collection takes about 50 ms
# with trimesh and what it imports loaded, so it adds less than 1 ms to each tree.
_TREES_PER_COLLECTION = 64

# Trees take this share of a device's memory at most, as far as those in use allow; then the ones that have not been
# used for longest leave it, until half of that is free.
_MEMORY_SHARE = 0.25

_openings = itertools.count(1)


def open_tracers() -> dict[FollowingTracer, Tracer]:
    """Return the tracers that hold memory of a device."""
    with _lock:
        pairs = [(following, following.open_tracer) for following in _shared.values()]
    return {following: tracer for following, tracer in pairs if tracer is not None}


def make_room(newest: FollowingTracer, device: DeviceInfo) -> None:
    """Collect unused meshes from time to time, and remove trees from a device that has too many."""
    limit = device.memory_bytes * _MEMORY_SHARE
    if next(_openings) % _TREES_PER_COLLECTION == 0 or sum(_sizes_on(device).values()) > limit:
        gc.collect()
    sizes = _sizes_on(device)
    held = sum(sizes.values())
    if held > limit:
        for following in sorted(sizes.keys() - {newest}, key=lambda one: one.last_use):
            held -= sizes[following] * following.give_way()
            if held <= limit / 2:
                break


def _sizes_on(device: DeviceInfo) -> dict[FollowingTracer, int]:
    """Return the bytes that each tracer holds on a device."""
    return {each: tracer.memory_bytes for each, tracer in open_tracers().items() if tracer.device == device}
