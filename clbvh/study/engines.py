"""Adapters of this engine and its peers, all with the same few verbs: open, then one whole call of each query.

An engine is imported when it is opened. Every call takes numpy arrays and gives the engine what its users would give
it; conversions to the engine's own types are made before the time is taken where its users can keep them, and are part
of the call where they cannot.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

_RAY_QUERIES = ("build", "coherent", "shuffled", "scattered", "any", "all")
_ALL_QUERIES = (*_RAY_QUERIES, "points")


class Engine:
    """One engine and one mesh.

    A query returns the number of its answers, by which the page shows that engines agree: hits, hit rays, or points.

    Attributes
    ----------
    name : str
    packages : tuple of str
        Packages that must be installed.
    queries : tuple of str
        The queries that it has.
    threads : str
        How many threads it uses.
    most_triangles, most_items : int or None
        Larger meshes and batches would take minutes: they are not measured, or cut.
    """

    name = ""
    packages: tuple[str, ...] = ()
    queries: tuple[str, ...] = ()
    threads = "all cores"
    most_triangles: int | None = None
    most_items: int | None = None

    def open(self, vertices: Array, faces: Array) -> None:
        """Import the engine and keep the mesh in the engine's own form."""
        raise NotImplementedError

    def build(self) -> None:
        """Build the acceleration structure anew, all of it."""
        raise NotImplementedError

    def prepare(self, query: str, *arrays: Array) -> Callable[[], Any]:
        """Return a function that does a query of origins and directions, or of points, and counts its answers."""
        raise NotImplementedError

    def kernel_ms(self) -> float:
        """Return the device's event time so far; 0 where there is none."""
        return 0.0

    def close(self) -> None:
        """Free what must be freed."""


class Clbvh(Engine):
    """clbvh, with the layout that suits the device."""

    name = "clbvh"
    queries = _ALL_QUERIES

    def open(self, vertices: Array, faces: Array) -> None:
        import clbvh

        self._clbvh = clbvh
        self._mesh = clbvh.Mesh.from_arrays(vertices, faces)
        self._tracer: Any = None

    def build(self) -> None:
        self._bvh = self._clbvh.build(self._mesh)

    def prepare(self, query: str, *arrays: Array) -> Callable[[], Any]:
        if self._tracer is None:
            self._tracer = self._clbvh.Tracer(self._bvh)
        tracer = self._tracer
        calls: dict[str, Callable[[], Any]] = {
            "points": lambda: len(tracer.closest_point(*arrays).distance),
            "any": lambda: np.count_nonzero(tracer.any_hit(*arrays)),
            "all": lambda: len(tracer.all_hits(*arrays).t),
        }
        return calls.get(query, lambda: np.count_nonzero(tracer.closest_hit(*arrays).is_hit))

    def kernel_ms(self) -> float:
        return 0.0 if self._tracer is None else self._tracer.timings_ms.get("kernel", 0.0)

    def close(self) -> None:
        if self._tracer is not None:
            self._tracer.close()


class Open3D(Engine):
    """Open3D's `RaycastingScene`, which is Embree 4."""

    name = "Open3D"
    packages = ("open3d",)
    queries = _ALL_QUERIES

    def open(self, vertices: Array, faces: Array) -> None:
        self._open3d: Any = import_module("open3d")
        self._mesh = self.pack(vertices), self._open3d.core.Tensor(faces.astype(np.uint32))

    def pack(self, *arrays: Array) -> Any:
        """Return arrays of equal length side by side, as a tensor of float32."""
        joined = np.concatenate(arrays, axis=1) if len(arrays) > 1 else arrays[0]
        return self._open3d.core.Tensor(joined.astype(np.float32, copy=False))

    def build(self) -> None:
        self.scene = self._open3d.t.geometry.RaycastingScene()
        self.scene.add_triangles(*self._mesh)
        # Embree builds when the first query needs the tree; one ray costs nothing beside that.
        self.scene.cast_rays(self.pack(np.array([[0, 0, 0, 0, 0, 1]])))

    def prepare(self, query: str, *arrays: Array) -> Callable[[], Any]:
        scene, packed = self.scene, self.pack(*arrays)
        calls: dict[str, Callable[[], Any]] = {
            "points": lambda: len(scene.compute_closest_points(packed)["points"]),
            "any": lambda: np.count_nonzero(scene.test_occlusions(packed).numpy()),
            "all": lambda: len(scene.list_intersections(packed)["t_hit"]),
        }
        return calls.get(query, lambda: np.count_nonzero(np.isfinite(scene.cast_rays(packed)["t_hit"].numpy())))


class Embreex(Engine):
    """The Python binding of Embree, with one thread; all hits by trimesh's engine over it."""

    name = "embreex"
    packages = ("embreex", "trimesh")
    queries = _RAY_QUERIES
    threads = "1"

    def open(self, vertices: Array, faces: Array) -> None:
        self._scene_class: Any = import_module("embreex.rtcore_scene").EmbreeScene
        self._mesh_class: Any = import_module("embreex.mesh_construction").TriangleMesh
        self._vertices, self._faces = vertices.astype(np.float32), faces.astype(np.int32)
        self._wide_vertices = vertices.astype(np.float64)

    def build(self) -> None:
        self.scene = self._scene_class()
        self._mesh_class(scene=self.scene, vertices=self._vertices, indices=self._faces)
        # As above.
        self.scene.run(np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32))

    def prepare(self, query: str, *arrays: Array) -> Callable[[], Any]:
        scene = self.scene
        if query == "all":
            import trimesh
            from trimesh.ray.ray_pyembree import RayMeshIntersector

            over: Any = RayMeshIntersector(trimesh.Trimesh(self._wide_vertices, self._faces, process=False))
            wide = [array.astype(np.float64) for array in arrays]
            return lambda: len(over.intersects_location(*wide)[0])
        rays = [array.astype(np.float32) for array in arrays]
        if query == "any":
            return lambda: np.count_nonzero(np.asarray(scene.run(*rays, query="OCCLUDED")) != -1)
        return lambda: np.count_nonzero(np.asarray(scene.run(*rays)) >= 0)


class Trimesh(Engine):
    """trimesh's own engine, in numpy over an R-tree."""

    name = "trimesh"
    packages = ("trimesh", "rtree")
    queries = _ALL_QUERIES
    threads = "1"
    most_triangles = 100_000
    most_items = 200

    def open(self, vertices: Array, faces: Array) -> None:
        import trimesh
        from trimesh.ray.ray_triangle import RayMeshIntersector

        self._trimesh, self._engine_class = trimesh, RayMeshIntersector
        self._arrays = vertices.astype(np.float64), faces

    def build(self) -> None:
        # A new object, because trimesh keeps the R-tree of the one before.
        self._mesh = self._trimesh.Trimesh(*self._arrays, process=False)
        self._engine = self._engine_class(self._mesh)
        _ = self._mesh.triangles_tree

    def prepare(self, query: str, *arrays: Array) -> Callable[[], Any]:
        engine, wide = self._engine, [array.astype(np.float64) for array in arrays]
        calls: dict[str, Callable[[], Any]] = {
            "points": lambda: len(self._trimesh.proximity.closest_point(self._mesh, *wide)[1]),
            "any": lambda: np.count_nonzero(engine.intersects_any(*wide)),
            "all": lambda: len(engine.intersects_location(*wide)[0]),
        }
        return calls.get(query, lambda: np.count_nonzero(engine.intersects_first(*wide) >= 0))


ENGINES: dict[str, type[Engine]] = {engine.name: engine for engine in (Clbvh, Open3D, Embreex, Trimesh)}


class Contestant:
    """An opened engine in its process: builds, and times one whole call at a time."""

    def __init__(self, name: str, folder: str) -> None:
        self._engine = ENGINES[name]()
        self._folder = folder
        faces = self._load("faces")
        self._engine.open(self._load("vertices"), faces)
        self._engine.build()
        self._calls: dict[str, tuple[Callable[[], Any], int]] = {"build": (self._engine.build, len(faces))}

    def answer(self, query: str) -> dict[str, float]:
        """Return wall time, number of items and of answers; and the device's event time where it has one."""
        if query not in self._calls:
            arrays = self._load_arrays(query)
            self._calls[query] = self._engine.prepare(query, *arrays), len(arrays[0])
        call, item_count = self._calls[query]
        before_ms = self._engine.kernel_ms()
        begin = time.perf_counter()
        answers = call()
        values: dict[str, float] = {"wall_ms": (time.perf_counter() - begin) * 1e3, "items": item_count}
        if answers is not None:
            values["answers"] = int(answers)
        if (kernel_ms := self._engine.kernel_ms() - before_ms) > 0:
            values["kernel_ms"] = kernel_ms
        return values

    def close(self) -> None:
        """Close the engine."""
        self._engine.close()

    def _load(self, name: str) -> Array:
        return np.load(f"{self._folder}/{name}.npy")

    def _load_arrays(self, query: str) -> list[Array]:
        """Return the arrays of a query, thinned evenly for an engine that is slow."""
        order = "coherent" if query in ("any", "all") else query
        names = ["points"] if query == "points" else [f"{order}-origins", f"{order}-directions"]
        arrays = [self._load(name) for name in names]
        step = -(-len(arrays[0]) // (self._engine.most_items or len(arrays[0])))
        return [np.ascontiguousarray(array[::step]) for array in arrays]
