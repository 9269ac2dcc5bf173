"""Speed of rays in every layout, beside Open3D: kernel times, the best of several runs, measured in turn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import clbvh
from clbvh.trace import put_rays
from clbvh.trace.rays.pieces import Piece, cut_rays
from clbvh.tree_layouts import TREE_LAYOUTS
from clbvh.views.cameras.framing import frame_mesh

from .paired import DEFAULT_RUNS, measure_ms

WIDTH, HEIGHT = 1920, 1080
AXIS_GRID = 1000
LIGHT = (0.3, 0.8, 0.5)


@pytest.fixture(autouse=True)
def unsorted_rays(monkeypatch):
    """Kernels are compared on rays in their own order; bench/test_queries.py has the gain and the cost of sorting."""

    def cut_unsorted(*arguments, **options):
        for piece in cut_rays(*arguments, **options):
            yield piece if piece.order is None else Piece(piece.begin, piece.end)

    monkeypatch.setattr(put_rays, "cut_rays", cut_unsorted)


@pytest.fixture(scope="module")
def rays(mesh):
    """Primary rays of a Full HD picture: (n, 3) origins and directions, float32."""
    camera = frame_mesh(mesh, aspect=WIDTH / HEIGHT)
    origins, directions = camera.rays(WIDTH, HEIGHT)
    return origins.reshape(-1, 3).astype(np.float32), directions.reshape(-1, 3).astype(np.float32)


@pytest.fixture(scope="module")
def tracers(mesh):
    """One tracer for each layout."""
    bvh = clbvh.build(mesh)
    tracers = {layout: clbvh.Tracer(bvh, layout=layout) for layout in TREE_LAYOUTS}
    for layout, tracer in tracers.items():
        print(f"\n{layout}: {tracer.memory_bytes / mesh.face_count:.1f} bytes per triangle on the device")
    yield tracers
    for tracer in tracers.values():
        tracer.close()


def kernel_ms(tracer: clbvh.Tracer, query: str, rays: Any) -> Callable[[], float]:
    """Return a function that casts the rays and returns the milliseconds of the kernel."""

    def run() -> float:
        before = tracer.timings_ms.get("kernel", 0.0)
        getattr(tracer, query)(*rays)
        return tracer.timings_ms["kernel"] - before

    return run


def shadow_rays(tracer: clbvh.Tracer, rays: Any) -> tuple[Any, Any]:
    """Return origins just in front of the hits of rays, and directions towards a light."""
    hits = tracer.closest_hit(*rays)
    share = (1 - 1e-4) * hits.t[hits.is_hit, None]
    starts = rays[0][hits.is_hit] + share * rays[1][hits.is_hit]
    return starts.astype(np.float32), np.broadcast_to(np.float32(LIGHT), starts.shape)


def race(title: str, ray_count: int, tasks: dict[str, Callable[[], float]]) -> dict[str, float]:
    """Run tasks in turn; print and return the millions of rays per second of the best run of each."""
    for task in tasks.values():
        task()
    best = dict.fromkeys(tasks, np.inf)
    for _ in range(DEFAULT_RUNS):
        for name, task in tasks.items():
            best[name] = min(best[name], task())
    speeds = {name: ray_count / ms / 1e3 for name, ms in best.items()}
    listed = ", ".join(f"{name} {speed:.1f}" for name, speed in speeds.items())
    print(f"\n{title}, Mray/s, best of {DEFAULT_RUNS}: {listed}")
    return speeds


@pytest.mark.parametrize("order", ["coherent", "shuffled"])
def test_layouts_and_open3d(mesh, rays, tracers, open3d, order):
    origins, directions = rays
    if order == "shuffled":
        shuffle = np.random.default_rng(1).permutation(len(origins))
        origins, directions = origins[shuffle], directions[shuffle]
    packed = open3d.pack(origins, directions)
    tasks = {layout: kernel_ms(tracer, "closest_hit", (origins, directions)) for layout, tracer in tracers.items()}
    tasks["Open3D"] = lambda: measure_ms(lambda: open3d.scene.cast_rays(packed))
    speeds = race(f"closest hit, {len(origins):,} {order} rays", len(origins), tasks)
    print(
        f"bvh8: {speeds['bvh8'] / speeds['Open3D']:.2f} times Open3D, {speeds['bvh8'] / speeds['bvh2']:.2f} times bvh2"
    )


@pytest.mark.parametrize("kind", ["picture", "shadow"])
def test_gain_of_entry_points(rays, tracers, monkeypatch, kind):
    """The same kernel, with rays that begin at the entry points of their tiles, and at the root."""
    tracer = tracers["bvh8"]
    cast = rays if kind == "picture" else shadow_rays(tracer, rays)
    with_entry_points = kernel_ms(tracer, "closest_hit", cast)

    def cut_incoherent(*arguments, **options):
        for piece in cut_rays(*arguments, **options):
            yield piece._replace(order=None, is_coherent=False)

    def from_the_root() -> float:
        with monkeypatch.context() as patch:
            patch.setattr(put_rays, "cut_rays", cut_incoherent)
            return with_entry_points()

    tasks = {"with entry points": with_entry_points, "from the root": from_the_root}
    speeds = race(f"bvh8, {len(cast[0]):,} {kind} rays", len(cast[0]), tasks)
    print(f"entry points: {speeds['with entry points'] / speeds['from the root']:.2f} times as fast")


def test_any_hit_of_shadow_rays(mesh, rays, tracers):
    shadow = shadow_rays(tracers["bvh8"], rays)
    for layout, tracer in tracers.items():
        queries = ("any_hit", "closest_hit")
        speeds = race(
            f"{layout}, {len(shadow[0]):,} shadow rays",
            len(shadow[0]),
            {query: kernel_ms(tracer, query, shadow) for query in queries},
        )
        print(f"any hit: {speeds['any_hit'] / speeds['closest_hit']:.2f} times closest hit")


def test_axis_parallel_rays(mesh, tracers):
    lowest, highest = (mesh.vertices.min(axis=0), mesh.vertices.max(axis=0))
    for axis in range(3):
        # A grid across the box, from one box away.
        steps = np.stack(np.meshgrid(*[np.linspace(0, 1, AXIS_GRID)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
        origins = lowest + np.insert(steps, axis, -1, axis=1) * (highest - lowest)
        direction = np.eye(3)[axis]
        tilted = direction + 1e-3 * np.roll(direction, 1) + 1e-3 * np.roll(direction, 2)
        casts = {
            name: kernel_ms(tracers["bvh8"], "closest_hit", (origins, np.broadcast_to(along, origins.shape)))
            for name, along in (("parallel", direction), ("slightly tilted", tilted))
        }
        speeds = race(f"bvh8, {len(origins):,} rays along {'xyz'[axis]}", len(origins), casts)
        print(f"parallel rays take {speeds['slightly tilted'] / speeds['parallel']:.2f} times as long as tilted ones")
