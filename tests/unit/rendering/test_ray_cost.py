"""The rays that trees are compared by."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Mesh, build, make_shape
from clbvh.rendering.cameras.camera import Camera
from clbvh.rendering.cameras.framing import frame_mesh
from clbvh.rendering.heat_map import measure_rays


def test_a_closed_surface_sends_half_its_rays_inwards():
    mesh = make_shape("icosphere", triangles=2000)
    camera = frame_mesh(mesh, aspect=2.0)
    steps = measure_rays(build(mesh), camera, 2.0, ray_count=5000)
    assert list(steps) == ["picture", "random", "surface"]
    # A picture twice as wide as high is framed with a margin around the sphere, which fills pi / 6 of its box.
    shares = {kind: (counted["prim_id"] >= 0).mean() for kind, counted in steps.items()}
    assert 0.8 * np.pi / 8 < shares["picture"] < np.pi / 8
    assert 0.52 < shares["random"] < 0.9
    assert shares["surface"] == pytest.approx(0.5, abs=0.03)
    assert len(steps["picture"]) == pytest.approx(5000, rel=0.05)


def test_the_same_rays_each_time():
    mesh = make_shape("boxes", triangles=600, seed=1)
    bvh = build(mesh)
    camera = frame_mesh(mesh, aspect=1.0)
    first, second = (measure_rays(bvh, camera, 1.0, ray_count=200) for _ in range(2))
    for kind, counted in first.items():
        assert (counted == second[kind]).all()


def test_a_mesh_without_area():
    mesh = Mesh.from_arrays(np.zeros((3, 3)), [[0, 1, 2]])
    steps = measure_rays(build(mesh), Camera((0, 0, 5), (0, 0, 0)), 1.5, ray_count=10)
    assert len(steps["surface"]) == 0
    assert (steps["random"]["prim_id"] == -1).all()
