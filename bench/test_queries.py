"""Whole Python calls, arrays in and arrays out, beside embreex and trimesh over embreex."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh
from clbvh.integrations.trimesh import RayMeshIntersector
from clbvh.study.experiments.peers import choose_points, scatter_rays
from clbvh.views.cameras.framing import frame_mesh

from .paired import compare, measure_ms

WIDTH, HEIGHT = 1920, 1080
TRIMESH_WIDTH, TRIMESH_HEIGHT = 1155, 866  # about a million rays
POINTS = 1_000_000


@pytest.fixture(scope="module")
def primary(mesh):
    """Primary rays of a Full HD picture: (n, 3) origins and directions, float32."""
    camera = frame_mesh(mesh, aspect=WIDTH / HEIGHT)
    return tuple(np.ascontiguousarray(a.reshape(-1, 3), np.float32) for a in camera.rays(WIDTH, HEIGHT))


@pytest.fixture(scope="module")
def tracer(mesh):
    with clbvh.Tracer(clbvh.build(mesh)) as opened:
        print(f"\n{opened}, {opened.memory_bytes / mesh.face_count:.0f} bytes per triangle")
        yield opened


@pytest.fixture(scope="module")
def engines(mesh):
    """Return this engine and trimesh's own over embreex, of one trimesh."""
    trimesh = pytest.importorskip("trimesh")
    embree = pytest.importorskip("trimesh.ray.ray_pyembree", reason="peers: embreex is not installed")
    loaded = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return RayMeshIntersector(loaded), embree.RayMeshIntersector(loaded)


@pytest.fixture(scope="module", params=["primary", "scattered"])
def million(request, mesh):
    """Return a million rays in float64: those of a picture, or from all around towards the box in any order."""
    if request.param == "primary":
        camera = frame_mesh(mesh, aspect=TRIMESH_WIDTH / TRIMESH_HEIGHT)
        return tuple(np.ascontiguousarray(a.reshape(-1, 3)) for a in camera.rays(TRIMESH_WIDTH, TRIMESH_HEIGHT))
    return scatter_rays(mesh, TRIMESH_WIDTH * TRIMESH_HEIGHT, np.random.default_rng(1))


def host_share(tracer, call) -> None:
    """Print what a call takes beside the kernel."""
    shares = []
    for _ in range(5):
        before = tracer.timings_ms.get("kernel", 0.0)
        whole = measure_ms(call)
        kernel = tracer.timings_ms["kernel"] - before
        shares.append((whole - kernel, whole, kernel))
    host, whole, kernel = min(shares)
    print(f"whole {whole:.1f} ms, kernel {kernel:.1f} ms, host {host:.1f} ms, {host / kernel:.0%} of the kernel")


@pytest.fixture(params=["coherent", "shuffled"])
def ordered(request, primary):
    """Return the order's name and the primary rays in it."""
    if request.param == "coherent":
        return request.param, primary
    shuffle = np.random.default_rng(1).permutation(len(primary[0]))
    return request.param, tuple(values[shuffle] for values in primary)


def test_closest_hit_against_open3d(ordered, tracer, open3d):
    order, rays = ordered
    packed = open3d.pack(*rays)
    ratio = compare(
        f"{len(rays[0]):,} {order} rays, whole closest_hit, Open3D's cast_rays",
        lambda: measure_ms(lambda: tracer.closest_hit(*rays)),
        lambda: measure_ms(lambda: open3d.scene.cast_rays(packed)),
    )
    print(f"{1 / ratio:.2f} times Open3D's rays per second")


def test_closest_hit_against_embreex(ordered, tracer, embreex):
    order, rays = ordered
    host_share(tracer, lambda: tracer.closest_hit(*rays))
    ratio = compare(
        f"{len(rays[0]):,} {order} rays, whole closest_hit, embreex's run",
        lambda: measure_ms(lambda: tracer.closest_hit(*rays)),
        lambda: measure_ms(lambda: embreex.scene.run(*rays)),
    )
    print(f"{1 / ratio:.2f} times embreex's rays per second")


@pytest.mark.parametrize("query", ["intersects_first", "intersects_any", "intersects_location"])
def test_trimesh_against_embreex(engines, million, query):
    ours, theirs = (getattr(engine, query) for engine in engines)
    print(
        f"\n{len(engines[0].intersects_id(*million)[0]):,} hits, {engines[0].intersects_any(*million).mean():.0%} hit"
    )
    ratio = compare(
        f"{len(million[0]):,} rays, {query}, trimesh over embreex",
        lambda: measure_ms(lambda: ours(*million)),
        lambda: measure_ms(lambda: theirs(*million)),
        runs=5,
    )
    print(f"{1 / ratio:.2f} times trimesh over embreex")


def test_any_hit_against_closest_hit(primary, tracer, mesh):
    """Shadow rays: from what the primary rays hit towards one light."""
    hits = tracer.closest_hit(*primary)
    found = hits.is_hit
    size = float(np.ptp(mesh.vertices, axis=0).max())
    away = hits.normals[found] * -np.sign((hits.normals[found] * primary[1][found]).sum(axis=1))[:, None]
    origins = hits.locations[found] + 1e-4 * size * away
    directions = np.broadcast_to([0.4, 0.8, 0.45], origins.shape)

    def kernel_ms(query) -> float:
        before = tracer.timings_ms["kernel"]
        query(origins, directions)
        return tracer.timings_ms["kernel"] - before

    ratio = compare(
        f"{len(origins):,} shadow rays, any_hit, closest_hit, kernels",
        lambda: kernel_ms(tracer.any_hit),
        lambda: kernel_ms(tracer.closest_hit),
    )
    print(f"{1 / ratio:.2f} times the rays per second")


def test_closest_point_against_open3d(mesh, tracer, open3d):
    """Points near the surface, and anywhere in the box."""
    points = choose_points(mesh, POINTS, np.random.default_rng(2))
    packed = open3d.pack(points)
    host_share(tracer, lambda: tracer.closest_point(points))
    ratio = compare(
        f"{POINTS:,} points, whole closest_point, Open3D's compute_closest_points",
        lambda: measure_ms(lambda: tracer.closest_point(points)),
        lambda: measure_ms(lambda: open3d.scene.compute_closest_points(packed)),
        runs=3,
    )
    print(f"{1 / ratio:.2f} times Open3D's points per second")
