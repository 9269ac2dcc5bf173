"""The engines of the contest, all with the same few verbs: open, then one whole call of each query.

This module runs in a process of its own for each engine, and imports an engine only when it is opened. Every call takes
arrays as they come from the shared files and gives the engine what its users would give it; conversions to the engine's
own types are made before the time is taken where its users can keep them, and are part of the call where they cannot.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


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

    def prepare(self, query: str, items: dict[str, Array]) -> Callable[[], int]:
        """Return a function that does the query once and returns the number of its answers."""
        raise NotImplementedError

    def kernel_ms(self) -> float | None:
        """Return the device's event time so far, None where there is none."""
        return None

    def close(self) -> None:
        """Free what must be freed."""


class Clbvh(Engine):
    """clbvh, with the layout that suits the device."""

    name = "clbvh"
    queries = ("build", "coherent", "shuffled", "scattered", "any", "all", "points")

    def open(self, vertices: Array, faces: Array) -> None:
        import clbvh

        self._clbvh = clbvh
        self._mesh = clbvh.Mesh.from_arrays(vertices, faces)
        self._tracer: Any = None

    def build(self) -> None:
        self._bvh = self._clbvh.build(self._mesh)

    def prepare(self, query: str, items: dict[str, Array]) -> Callable[[], int]:
        if self._tracer is None:
            self._tracer = self._clbvh.Tracer(self._bvh)
        tracer = self._tracer
        if query == "points":
            return lambda: len(tracer.closest_point(items["points"]).distance)
        rays = items["origins"], items["directions"]
        if query == "any":
            return lambda: int(np.count_nonzero(tracer.any_hit(*rays)))
        if query == "all":
            return lambda: len(tracer.all_hits(*rays).t)
        return lambda: int(np.count_nonzero(tracer.closest_hit(*rays).is_hit))

    def kernel_ms(self) -> float | None:
        return None if self._tracer is None else self._tracer.timings_ms.get("kernel", 0.0)

    def close(self) -> None:
        if self._tracer is not None:
            self._tracer.close()


class Open3D(Engine):
    """Open3D's `RaycastingScene`, which is Embree 4."""

    name = "Open3D"
    packages = ("open3d",)
    queries = ("build", "coherent", "shuffled", "scattered", "any", "all", "points")

    def open(self, vertices: Array, faces: Array) -> None:
        open3d: Any = import_module("open3d")

        self._open3d = open3d
        self._tensor = open3d.core.Tensor
        self._vertices = self._tensor(vertices.astype(np.float32))
        self._faces = self._tensor(faces.astype(np.uint32))

    def build(self) -> None:
        self._scene = self._open3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(self._vertices, self._faces)
        # Embree builds when the first query needs the tree; one ray costs nothing beside that.
        self._scene.cast_rays(self._tensor(np.array([[0, 0, 0, 0, 0, 1]], np.float32)))

    def prepare(self, query: str, items: dict[str, Array]) -> Callable[[], int]:
        scene = self._scene
        if query == "points":
            points = self._tensor(items["points"].astype(np.float32))
            return lambda: len(scene.compute_closest_points(points)["points"])
        rays = self._tensor(np.concatenate([items["origins"], items["directions"]], axis=1).astype(np.float32))
        if query == "any":
            return lambda: int(np.count_nonzero(scene.test_occlusions(rays).numpy()))
        if query == "all":
            return lambda: len(scene.list_intersections(rays)["t_hit"])
        return lambda: int(np.count_nonzero(np.isfinite(scene.cast_rays(rays)["t_hit"].numpy())))


class Embreex(Engine):
    """The Python binding of Embree, with one thread; all hits by trimesh's engine over it."""

    name = "embreex"
    packages = ("embreex", "trimesh")
    queries = ("build", "coherent", "shuffled", "scattered", "any", "all")
    threads = "1"

    def open(self, vertices: Array, faces: Array) -> None:
        self._module: Any = import_module("embreex.rtcore_scene")
        self._mesh_class: Any = import_module("embreex.mesh_construction").TriangleMesh
        self._vertices, self._faces = vertices.astype(np.float32), faces.astype(np.int32)
        self._double = vertices.astype(np.float64)
        self._over: Any = None

    def build(self) -> None:
        self._scene = self._module.EmbreeScene()
        self._mesh_class(scene=self._scene, vertices=self._vertices, indices=self._faces)
        # As above.
        self._scene.run(np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32))

    def prepare(self, query: str, items: dict[str, Array]) -> Callable[[], int]:
        scene = self._scene
        if query == "all":
            import trimesh
            from trimesh.ray.ray_pyembree import RayMeshIntersector

            if self._over is None:
                self._over = RayMeshIntersector(trimesh.Trimesh(self._double, self._faces, process=False))
            over = self._over
            wide = items["origins"].astype(np.float64), items["directions"].astype(np.float64)
            return lambda: len(over.intersects_location(*wide)[0])
        rays = items["origins"].astype(np.float32), items["directions"].astype(np.float32)
        if query == "any":
            return lambda: int(np.count_nonzero(np.asarray(scene.run(*rays, query="OCCLUDED")) != -1))
        return lambda: int(np.count_nonzero(np.asarray(scene.run(*rays)) >= 0))


class Trimesh(Engine):
    """trimesh's own engine, in numpy over an R-tree."""

    name = "trimesh"
    packages = ("trimesh", "rtree")
    queries = ("build", "coherent", "shuffled", "scattered", "any", "all", "points")
    threads = "1"
    most_triangles = 100_000
    most_items = 200

    def open(self, vertices: Array, faces: Array) -> None:
        import trimesh
        from trimesh.ray.ray_triangle import RayMeshIntersector

        self._trimesh, self._class = trimesh, RayMeshIntersector
        self._arrays = vertices.astype(np.float64), faces

    def build(self) -> None:
        # A new object, because trimesh keeps the R-tree of the one before.
        self._mesh = self._trimesh.Trimesh(*self._arrays, process=False)
        self._engine = self._class(self._mesh)
        _ = self._mesh.triangles_tree

    def prepare(self, query: str, items: dict[str, Array]) -> Callable[[], int]:
        engine, mesh = self._engine, self._mesh
        if query == "points":
            points = items["points"].astype(np.float64)
            return lambda: len(self._trimesh.proximity.closest_point(mesh, points)[1])
        rays = items["origins"].astype(np.float64), items["directions"].astype(np.float64)
        if query == "any":
            return lambda: int(np.count_nonzero(engine.intersects_any(*rays)))
        if query == "all":
            return lambda: len(engine.intersects_location(*rays)[0])
        return lambda: int(np.count_nonzero(engine.intersects_first(*rays) >= 0))


ENGINES: dict[str, type[Engine]] = {engine.name: engine for engine in (Clbvh, Open3D, Embreex, Trimesh)}


class Contestant:
    """An opened engine in its process: builds, and times one whole call at a time."""

    def __init__(self, name: str, folder: str) -> None:
        self._engine = ENGINES[name]()
        self._folder = folder
        self._engine.open(self._load("vertices"), self._load("faces"))
        self._calls: dict[str, tuple[Callable[[], int], int]] = {}
        self._engine.build()

    def measure(self, query: str) -> dict[str, float]:
        """Return wall time, number of items and of answers; and the device's event time where it has one."""
        if query == "build":
            begin = time.perf_counter()
            self._engine.build()
            return {"wall_ms": (time.perf_counter() - begin) * 1e3, "items": len(self._load("faces"))}
        if query not in self._calls:
            items = self._load_items(query)
            self._calls[query] = self._engine.prepare(query, items), len(next(iter(items.values())))
        call, item_count = self._calls[query]
        before = self._engine.kernel_ms()
        begin = time.perf_counter()
        answers = call()
        values = {"wall_ms": (time.perf_counter() - begin) * 1e3, "items": item_count, "answers": answers}
        after = self._engine.kernel_ms()
        if before is not None and after is not None:
            values["kernel_ms"] = after - before
        return values

    def close(self) -> None:
        """Close the engine."""
        self._engine.close()

    def _load(self, name: str) -> Array:
        return np.load(f"{self._folder}/{name}.npy")

    def _load_items(self, query: str) -> dict[str, Array]:
        """Return the arrays of a query, thinned evenly for an engine that is slow."""
        names = ("points",) if query == "points" else ("origins", "directions")
        order = "coherent" if query in ("any", "all") else query
        items = {name: self._load(name if query == "points" else f"{order}-{name}") for name in names}
        limit = self._engine.most_items
        if limit is None:
            return items
        return {name: np.ascontiguousarray(array[:: max(1, -(-len(array) // limit))]) for name, array in items.items()}
