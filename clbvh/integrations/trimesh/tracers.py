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
from ...device.info import DeviceInfo
from ...errors import ConfigError, DeviceError, QueryError, SceneError
from ...geometry import Mesh
from ...geometry.as_mesh import as_mesh
from ...geometry.loading.file_parts import find_hidden
from ...geometry.loading.trimesh import list_nodes
from ...geometry.topology import find_corner_faces, find_points
from ...scene.handles import Geometry
from ...scene.scene import Scene
from ...scene.transforms import check_transforms
from ...support.forks import make_lock
from ...trace.tracer import Tracer
from ...trace.world.trees import check_layout

# The names of a node that places a triangle mesh, and of its geometry.
Node = tuple[Any, Any]

# Both of a mesh without a scene.
_MESH = "trimesh"


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
class Followed:
    """A mesh or a scene of trimesh as it was seen last. A mesh is a node that is in its own place.

    Attributes
    ----------
    graph : tuple
        See `read_graph`.
    nodes : list of Node
        Those that are not hidden, in the order of the graph, as are the instances.
    transforms : (n, 4, 4) float64
    hashes : dict of any to int
        Trimesh's hash of each mesh, by the name of its geometry.
    shapes : dict of any to Mesh
        As they are now; of a scene, as they were read.
    source : Bvh or Scene
        The tracer is opened with it. The tree of a mesh needs no device, and outlives the tracer.
    geometries : dict of any to Geometry
        Of a scene.
    has_moved : bool
        Whether this is no longer where the source is.
    """

    graph: tuple[Any, ...]
    nodes: list[Node]
    transforms: NDArray[np.float64]
    hashes: dict[Any, int]
    shapes: dict[Any, Mesh]
    source: Any
    geometries: dict[Any, Geometry]
    has_moved: bool = False

    @classmethod
    def read(cls, thing: Any) -> Followed:
        """Read a mesh or a scene, and build the tree of a mesh.

        Raises
        ------
        MeshError, SceneError
            A mesh or a node cannot be used, or there is none.
        """
        graph, (nodes, transforms) = read_graph(thing), read_nodes(thing)
        meshes = _find_meshes(thing, nodes)
        hashes = {name: hash(mesh) for name, mesh in meshes.items()}
        shapes = {name: Mesh.from_arrays(mesh.vertices, mesh.faces, name=str(name)) for name, mesh in meshes.items()}
        if not isinstance(thing, trimesh.Scene):
            return cls(graph, nodes, transforms, hashes, shapes, build(shapes[_MESH]), {})
        scene = Scene()
        geometries = {name: scene.add(shape) for name, shape in shapes.items()}
        for (_, name), transform in zip(nodes, transforms, strict=True):
            scene.place(geometries[name], transform)
        if not nodes and not list_nodes(thing):
            raise SceneError("the scene has no node with a triangle mesh: rays need a surface")
        return cls(graph, nodes, transforms, hashes, shapes, scene, geometries)

    @property
    def mesh(self) -> Mesh:
        """The mesh as it is now."""
        return self.shapes[_MESH]

    @cached_property
    def bvh(self) -> Bvh:
        """The tree of the mesh as it is now; a tracer that was updated does not need it."""
        return self.source.refit(self.mesh.vertices) if self.has_moved else self.source

    @cached_property
    def corner_faces(self) -> tuple[NDArray[np.int64], ...]:
        """The mesh's `CornerFaces`, widened. Those that the mesh has may be of its vertices before it moved."""
        return find_corner_faces(find_points(self.mesh.vertices), self.mesh.faces).widened()

    def follow(self, thing: Any, tracer: Tracer | None) -> Followed | None:
        """Move the tracer to the mesh or the scene as it is now; return None where only a new one can follow.

        After that, an error or an interrupt, neither is of use.
        """
        graph = read_graph(thing)
        nodes, transforms = (self.nodes, self.transforms) if graph == self.graph else read_nodes(thing)
        if nodes != self.nodes:
            return None
        meshes = _find_meshes(thing, nodes)
        hashes = {name: hash(mesh) for name, mesh in meshes.items()}
        changed = {name: mesh for name, mesh in meshes.items() if hashes[name] != self.hashes[name]}
        moved = np.flatnonzero((self.transforms != transforms).any(axis=(1, 2)))
        if not changed and not len(moved) and not (tracer is None and self.has_moved):
            return replace(self, graph=graph) if graph != self.graph else self
        if tracer is None or not all(_has_faces(self.shapes[name], mesh) for name, mesh in changed.items()):
            return None
        shapes = self.shapes
        try:
            if len(moved):
                tracer.set_transforms(moved, transforms[moved])
            for name, mesh in changed.items():
                vertices = np.asarray(mesh.vertices)
                if name in self.geometries:
                    tracer.set_vertices(self.geometries[name], vertices)
                else:
                    tracer.update(vertices)
                    shapes = {name: tracer.mesh}
        except (DeviceError, QueryError):
            return None  # no room for a second copy, or closed by another thread
        return replace(self, graph=graph, transforms=transforms, hashes=hashes, shapes=shapes, has_moved=True)


def read_graph(thing: Any) -> tuple[Any, ...]:
    """Return what changes when a node is moved, added or taken away, or gets another geometry; nothing of a mesh."""
    if not isinstance(thing, trimesh.Scene):
        return ()
    return hash(thing.graph), thing.graph.base_frame, *thing.geometry


def read_nodes(thing: Any) -> tuple[list[Node], NDArray[np.float64]]:
    """Return the nodes that place triangle meshes and are not hidden, and their transforms, (n, 4, 4) float64.

    Raises
    ------
    SceneError
        A transform is not finite; the message names the node.
    """
    if not isinstance(thing, trimesh.Scene):
        return [(_MESH, _MESH)], np.eye(4)[None]
    nodes = list_nodes(thing)
    matrices = np.array([matrix for *_, matrix in nodes]).reshape(-1, 4, 4)
    is_shown = ~find_hidden(matrices)
    shown = [(node, name) for node, name, *_ in itertools.compress(nodes, is_shown)]
    return shown, check_transforms(matrices[is_shown], lambda index: f"the transform of the node {shown[index][0]!r}")


def _find_meshes(thing: Any, nodes: list[Node]) -> dict[Any, Any]:
    """Return the meshes that nodes place, by the names of their geometries."""
    return {name: thing.geometry[name] if isinstance(thing, trimesh.Scene) else thing for _, name in nodes}


def _has_faces(known: Mesh, mesh: Any) -> bool:
    """Return whether a mesh of trimesh has the faces of the one that was known, and as many vertices."""
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
        self._known: Followed | None = None
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
                    self.open_tracer = tracer = Tracer(known.source, **self.options._asdict())
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
            known = Followed.read(thing)
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
        more["t_max"] = np.where(bad, -1.0, more.get("t_max", np.inf))
        return getattr(tracer, query)(origins, directions, **more)


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
