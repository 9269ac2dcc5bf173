"""How long it takes to move a finished tree, and to read it from a file."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh
from clbvh.rendering.heat_map import measure_rays
from clbvh.views.cameras.framing import frame_mesh

from .paired import compare, measure_ms


@pytest.fixture(scope="module")
def bvh(mesh):
    return clbvh.build(mesh)


def test_refit_against_a_build(mesh, bvh):
    vertices = mesh.vertices
    vertices += 0.01 * np.ptp(vertices) * np.sin(vertices[:, ::-1] / np.ptp(vertices))
    compare("refit, build in one process", lambda: measure_ms(lambda: bvh.refit(vertices)),
            lambda: measure_ms(lambda: clbvh.build(mesh)))  # fmt: skip


def test_load_against_a_build(mesh, bvh, tmp_path):
    path = tmp_path / "a.tree"
    bvh.save(path)
    print(f"\n{path.stat().st_size / mesh.face_count:.1f} bytes per triangle in the file")

    def load() -> float:
        # A new mesh, which has not taken its fingerprint yet.
        fresh = clbvh.Mesh(mesh.vertices, mesh.faces, mesh.origin)
        return measure_ms(lambda: clbvh.Bvh.load(path, fresh))

    compare("load with fingerprint, build in one process", load, lambda: measure_ms(lambda: clbvh.build(mesh)))


def test_high_against_default(mesh):
    compare("quality high, default, both in one process", lambda: measure_ms(lambda: clbvh.build(mesh, quality="high")),
            lambda: measure_ms(lambda: clbvh.build(mesh)), runs=3)  # fmt: skip


@pytest.mark.parametrize("shape", [None, "palace", "boxes", "blobs", "knot"])
def test_what_rays_save_by_high(mesh, shape):
    """Node steps and triangle tests per ray: no time is measured, so the figures are exact."""
    measured = mesh if shape is None else clbvh.make_shape(shape, triangles=200_000, seed=1)
    aspect = 16 / 9
    camera = frame_mesh(measured, aspect=aspect)
    default, high = (measure_rays(clbvh.build(measured, quality=word), camera, aspect) for word in ("default", "high"))
    print(f"\n{measured}")
    for kind in default:
        tests, default_tests = high[kind].tests_per_ray, default[kind].tests_per_ray
        print(f"  {kind} rays: {tests:.2f} tests, default {default_tests:.2f}, ratio {tests / default_tests:.3f}")
        assert tests < default_tests
