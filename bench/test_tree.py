"""How long it takes to move a finished tree, and to read it from a file."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh

from .paired import compare, measure_ms


@pytest.fixture(scope="module")
def bvh(mesh):
    return clbvh.build(mesh)


def test_refit_against_a_build(mesh, bvh):
    vertices = mesh.vertices + mesh.origin
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
