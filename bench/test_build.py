"""How long a tree takes."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh

from .paired import compare, measure_ms


@pytest.fixture(scope="module")
def pool():
    with clbvh.SubtreePool() as pool:
        pool.wait_ready()
        yield pool


def test_build_against_open3d(mesh, pool, open3d):
    vertices = open3d.core.Tensor(mesh.vertices)
    faces = open3d.core.Tensor(mesh.faces.astype(np.uint32))

    def commit() -> float:
        scene = open3d.t.geometry.RaycastingScene()
        scene.add_triangles(vertices, faces)
        # Embree builds when the first query needs the tree; one ray costs nothing beside that.
        return measure_ms(lambda: scene.cast_rays(open3d.core.Tensor(np.float32([[0, 0, 0, 0, 0, 1]]))))

    compare(f"build, {pool.workers} workers, Open3D", lambda: measure_ms(lambda: clbvh.build(mesh, pool=pool)), commit)
    bvh = clbvh.build(mesh, pool=pool)
    print(f"{bvh}, SAH cost {clbvh.sah_cost(bvh):.2f}, phases in ms: {bvh.timings_ms}")


def test_workers_against_one_process(mesh, pool):
    compare(
        f"build, {pool.workers} workers, in one process",
        lambda: measure_ms(lambda: clbvh.build(mesh, pool=pool)),
        lambda: measure_ms(lambda: clbvh.build(mesh)),
    )


@pytest.mark.parametrize("alone", [False, True], ids=["pool", "alone"])
def test_fast_against_default(mesh, pool, alone):
    who = None if alone else pool
    compare(
        f"build, quality fast, {'one process' if alone else f'{pool.workers} workers'}, default",
        lambda: measure_ms(lambda: clbvh.build(mesh, pool=who, quality="fast")),
        lambda: measure_ms(lambda: clbvh.build(mesh, pool=who)),
    )
    fast, default = clbvh.build(mesh, pool=who, quality="fast"), clbvh.build(mesh, pool=who)
    print(f"SAH cost {clbvh.sah_cost(fast):.2f} against {clbvh.sah_cost(default):.2f}, phases in ms: {fast.timings_ms}")
