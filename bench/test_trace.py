"""How long rays take: every layout, beside Open3D. Kernel times, the best of several runs, measured in turn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import clbvh
from clbvh.layout import LAYOUT_WIDTHS
from clbvh.render.camera import frame_points
from clbvh.trace import caster
from clbvh.trace.ray_order import RayOrder

from .paired import DEFAULT_RUNS, measure_ms

WIDTH, HEIGHT = 1920, 1080
AXIS_GRID = 1000
LIGHT = (0.3, 0.8, 0.5)


@pytest.fixture(autouse=True)
def rays_as_given(monkeypatch):
    """Kernels are compared on the rays that are named: what sorting gains, and takes, is in bench/test_queries.py."""
    find_order = caster.find_order

    def find_no_order(*arguments, is_picture):
        return RayOrder(None, find_order(*arguments, is_picture=is_picture).is_coherent)

    monkeypatch.setattr(caster, "find_order", find_no_order)


@pytest.fixture(scope="module")
def rays(mesh):
    """Primary rays of a Full HD picture: (n, 3) origins and directions, float32."""
    camera = frame_points(mesh.vertices, mesh.origin, aspect=WIDTH / HEIGHT)
    origins, directions = camera.rays(WIDTH, HEIGHT)
    return origins.reshape(-1, 3).astype(np.float32), directions.reshape(-1, 3).astype(np.float32)


@pytest.fixture(scope="module")
def tracers(mesh):
    """One tracer for each layout."""
    bvh = clbvh.build(mesh)
    tracers = {layout: clbvh.Tracer(bvh, layout=layout) for layout in LAYOUT_WIDTHS}
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
    """Return origins a little in front of what rays hit, and directions towards a light."""
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
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles((mesh.vertices + mesh.origin).astype(np.float32), mesh.faces.astype(np.uint32))
    packed = open3d.core.Tensor(np.concatenate([origins, directions], axis=1))
    tasks = {layout: kernel_ms(tracer, "closest_hit", (origins, directions)) for layout, tracer in tracers.items()}
    tasks["Open3D"] = lambda: measure_ms(lambda: scene.cast_rays(packed))
    speeds = race(f"closest hit, {len(origins):,} {order} rays", len(origins), tasks)
    print(
        f"bvh8: {speeds['bvh8'] / speeds['Open3D']:.2f} times Open3D, {speeds['bvh8'] / speeds['bvh2']:.2f} times bvh2"
    )


@pytest.mark.parametrize("kind", ["picture", "shadow"])
def test_what_entries_gain(rays, tracers, monkeypatch, kind):
    """The same kernel, with rays that begin where their tile enters the tree, and at the root."""
    tracer = tracers["bvh8"]
    cast = rays if kind == "picture" else shadow_rays(tracer, rays)
    with_entries = kernel_ms(tracer, "closest_hit", cast)

    def from_the_root() -> float:
        with monkeypatch.context() as patch:
            patch.setattr(caster, "find_order", lambda *arguments, is_picture: RayOrder(None, False))
            return with_entries()

    tasks = {"with entries": with_entries, "from the root": from_the_root}
    speeds = race(f"bvh8, {len(cast[0]):,} {kind} rays", len(cast[0]), tasks)
    print(f"entries: {speeds['with entries'] / speeds['from the root']:.2f} times as fast")


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
    lowest, highest = (mesh.vertices.min(axis=0) + mesh.origin, mesh.vertices.max(axis=0) + mesh.origin)
    for axis in range(3):
        # A grid across the box, from one box away.
        steps = np.stack(np.meshgrid(*[np.linspace(0, 1, AXIS_GRID)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
        origins = lowest + np.insert(steps, axis, -1, axis=1) * (highest - lowest)
        direction = np.eye(3)[axis]
        turned = direction + 1e-3 * np.roll(direction, 1) + 1e-3 * np.roll(direction, 2)
        casts = {
            name: kernel_ms(tracers["bvh8"], "closest_hit", (origins, np.broadcast_to(along, origins.shape)))
            for name, along in (("parallel", direction), ("slightly turned", turned))
        }
        speeds = race(f"bvh8, {len(origins):,} rays along {'xyz'[axis]}", len(origins), casts)
        print(f"parallel rays take {speeds['slightly turned'] / speeds['parallel']:.2f} times as long as turned ones")
