"""clbvh and its peers, all with the same few verbs, and a process of its own for each.

A peer is imported when it is opened. Every query takes numpy arrays and gives the engine what its users would give
it; conversions to the engine's own types are made before the time is taken where its users can keep them, and are part
of the call where they cannot. In one process, engines disturb each other by the threads they leave running.
"""

from __future__ import annotations

import math
import multiprocessing
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property, partial
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..builders.build import build
from ..errors import ClbvhError
from ..geometry import Mesh
from ..support.context_manager import ContextManager
from ..trace.tracer import Tracer

Array = NDArray[Any]
# The functions that a process of its own calls and times, by the names of the queries.
Queries = dict[str, Callable[[], Any]]

# The method of an engine that answers a query, and the file of its rays or points.
_QUERIES = {
    "coherent": ("closest", "coherent"),
    "shuffled": ("closest", "shuffled"),
    "scattered": ("closest", "scattered"),
    "any": ("any", "coherent"),
    "all": ("all", "coherent"),
    "points": ("points", "points"),
}

# An engine that does not answer for so long is given up; opening one compiles code for a minute on a slow machine.
_PATIENCE_S = 900.0


class Engine:
    """One engine and one mesh, opened with vertices and faces; the tree is built by `build`, anew each time.

    The methods of a query return the number of its answers, by which the page shows that engines agree: hits, hit rays,
    or points. An engine without a method has no such query.

    Attributes
    ----------
    name : str
    packages : tuple of str
        Packages that must be installed.
    threads : str
        How many threads it uses.
    most_triangles, most_items : float
        Larger meshes and batches would take minutes: they are not measured, or cut.
    """

    name = ""
    packages: tuple[str, ...] = ()
    threads = "all cores"
    most_triangles = most_items = math.inf

    def pack(self, *arrays: Array) -> Any:
        """Return origins and directions, or points, all float32, as the methods of the queries take them."""
        return arrays

    @classmethod
    def has(cls, query: str) -> bool:
        """Return whether the engine has a query; all can build."""
        return query == "build" or hasattr(cls, _QUERIES[query][0])


class Clbvh(Engine):
    """clbvh, with the layout that suits the device."""

    name = "clbvh"

    def __init__(self, vertices: Array, faces: Array) -> None:
        self._mesh = Mesh.from_arrays(vertices, faces)

    def build(self) -> None:
        self._bvh = build(self._mesh)

    @cached_property
    def _tracer(self) -> Tracer:
        return Tracer(self._bvh)

    def closest(self, rays: Any) -> Any:
        return np.count_nonzero(self._tracer.closest_hit(*rays).is_hit)

    def any(self, rays: Any) -> Any:
        return np.count_nonzero(self._tracer.any_hit(*rays))

    def all(self, rays: Any) -> Any:
        return len(self._tracer.all_hits(*rays).t)

    def points(self, points: Any) -> Any:
        return len(self._tracer.closest_point(*points).distance)


class Open3D(Engine):
    """Open3D's `RaycastingScene`, which is Embree 4."""

    name = "Open3D"
    packages = ("open3d",)

    def __init__(self, vertices: Array, faces: Array) -> None:
        self._open3d: Any = import_module("open3d")
        self._mesh = self.pack(vertices), self._open3d.core.Tensor(faces.astype(np.uint32))

    def pack(self, *arrays: Array) -> Any:
        """Return arrays of equal length side by side, as a tensor of float32."""
        return self._open3d.core.Tensor(np.concatenate(arrays, axis=-1).astype(np.float32, copy=False))

    def build(self) -> None:
        self.scene = self._open3d.t.geometry.RaycastingScene()
        self.scene.add_triangles(*self._mesh)
        # Embree builds when the first query needs the tree; one ray costs nothing beside that.
        self.scene.cast_rays(self.pack(np.array([[0, 0, 0, 0, 0, 1]])))

    def closest(self, rays: Any) -> Any:
        return np.count_nonzero(np.isfinite(self.scene.cast_rays(rays)["t_hit"].numpy()))

    def any(self, rays: Any) -> Any:
        return np.count_nonzero(self.scene.test_occlusions(rays).numpy())

    def all(self, rays: Any) -> Any:
        return len(self.scene.list_intersections(rays)["t_hit"])

    def points(self, points: Any) -> Any:
        return len(self.scene.compute_closest_points(points)["points"])


class Embreex(Engine):
    """The Python binding of Embree, with one thread; all hits by trimesh's engine over it."""

    name = "embreex"
    packages = ("embreex", "trimesh")
    threads = "1"

    def __init__(self, vertices: Array, faces: Array) -> None:
        self._scene_class: Any = import_module("embreex.rtcore_scene").EmbreeScene
        self._mesh_class: Any = import_module("embreex.mesh_construction").TriangleMesh
        self._arrays = vertices, faces
        self._packed = {"vertices": vertices.astype(np.float32), "indices": faces.astype(np.int32)}

    def build(self) -> None:
        self.scene = self._scene_class()
        self._mesh_class(scene=self.scene, **self._packed)
        # As above.
        self.scene.run(np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32))

    @cached_property
    def _over(self) -> Any:
        mesh = import_module("trimesh").Trimesh(*self._arrays, process=False)
        return import_module("trimesh.ray.ray_pyembree").RayMeshIntersector(mesh)

    def closest(self, rays: Any) -> Any:
        return np.count_nonzero(np.asarray(self.scene.run(*rays)) >= 0)

    def any(self, rays: Any) -> Any:
        return np.count_nonzero(np.asarray(self.scene.run(*rays, query="OCCLUDED")) != -1)

    def all(self, rays: Any) -> Any:
        return len(self._over.intersects_location(*rays)[0])


class Trimesh(Engine):
    """trimesh's own engine, in numpy over an R-tree."""

    name = "trimesh"
    packages = ("trimesh", "rtree")
    threads = "1"
    most_triangles = 100_000
    most_items = 200

    def __init__(self, vertices: Array, faces: Array) -> None:
        self._trimesh: Any = import_module("trimesh")
        self._arrays = vertices, faces

    def pack(self, *arrays: Array) -> Any:
        return [array.astype(np.float64) for array in arrays]

    def build(self) -> None:
        # A new object, because trimesh keeps the R-tree of the one before.
        self._mesh = self._trimesh.Trimesh(*self._arrays, process=False)
        self._ray = self._trimesh.ray.ray_triangle.RayMeshIntersector(self._mesh)
        _ = self._mesh.triangles_tree

    def closest(self, rays: Any) -> Any:
        return np.count_nonzero(self._ray.intersects_first(*rays) >= 0)

    def any(self, rays: Any) -> Any:
        return np.count_nonzero(self._ray.intersects_any(*rays))

    def all(self, rays: Any) -> Any:
        return len(self._ray.intersects_location(*rays)[0])

    def points(self, points: Any) -> Any:
        return len(self._trimesh.proximity.closest_point(self._mesh, *points)[1])


ENGINES: dict[str, Any] = {engine.name: engine for engine in (Clbvh, Open3D, Embreex, Trimesh)}


def open_engine(name: str, folder: str) -> Queries:
    """Return the queries of an engine whose tree is built, for the mesh, the rays and the points of a folder.

    Each returns the numbers of items and of answers. An engine that is slow gets an even share of the items.
    """
    vertices, faces = (np.load(f"{folder}/{file}.npy") for file in ("vertices", "faces"))
    engine = ENGINES[name](vertices, faces)
    engine.build()
    queries: Queries = {"build": lambda: (len(faces), engine.build())}
    for query, (method, file) in _QUERIES.items():
        if engine.has(query):
            arrays = np.load(f"{folder}/{file}.npy")
            step = math.ceil(arrays.shape[1] / engine.most_items) or 1
            arrays = np.ascontiguousarray(arrays[:, ::step])
            queries[query] = partial(_count, getattr(engine, method), engine.pack(*arrays), arrays.shape[1])
    return queries


def _count(method: Callable[[Any], int], packed: Any, item_count: int) -> tuple[int, int]:
    return item_count, int(method(packed))


class EngineError(ClbvhError, RuntimeError):
    """An engine's process failed or fell silent."""


class Measured(NamedTuple):
    """The time of a query in its process, and its result: of `open_engine`, the numbers of items and of answers."""

    wall_ms: float
    result: Any


class Rival(ContextManager):
    """The process of an engine, started by spawning, and idle while others are measured.

    Parameters
    ----------
    open_queries : function
        Called in the process, with the other arguments; returns the queries by their names, such as `open_engine`.
    """

    def __init__(self, open_queries: Callable[..., Queries], *arguments: Any) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, open_queries, arguments), daemon=True)
        self._process.start()
        theirs.close()

    def measure(self, query: str) -> Measured:
        """Ask a query once.

        Raises
        ------
        EngineError
            The engine cannot be opened or fails, or its process died or fell silent.
        """
        try:
            self._connection.send(query)
            if not self._connection.poll(_PATIENCE_S):
                self._process.kill()
            failure, *measured = self._connection.recv()
        except (EOFError, OSError):
            self._process.join()
            raise EngineError(f"the engine's process died (exit code {self._process.exitcode})") from None
        if failure:
            raise EngineError(f"the engine fails: {failure}")
        return Measured(*measured)

    def close(self) -> None:
        """End the process. Closing twice is allowed."""
        self._process.kill()
        self._process.join()
        self._connection.close()


def _serve(connection: Connection, open_queries: Callable[..., Queries], arguments: Sequence[Any]) -> None:
    """Answer queries until the other end is closed, also by the death of its process; the life of the process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    queries: Queries = {}
    with suppress(EOFError):
        while query := connection.recv():
            try:
                queries = queries or open_queries(*arguments)
                begin = time.perf_counter()
                result = queries[query]()
                connection.send(("", (time.perf_counter() - begin) * 1e3, result))
            except Exception as error:
                connection.send((f"{type(error).__name__}: {error}",))
