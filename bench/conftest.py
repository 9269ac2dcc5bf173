"""The benchmark mesh: the dragon where it is, the knot of the same size where it is not."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

import clbvh
from clbvh.study.engines import ENGINES


@pytest.fixture(scope="session")
def mesh() -> clbvh.Mesh:
    """About 871,000 triangles."""
    path = Path(os.environ.get("CLBVH_MESHES", "")) / "dragon_871k.ply"
    mesh = clbvh.load_mesh(path) if path.is_file() else clbvh.make_shape("knot", triangles=871_200, seed=1)
    print(f"\n{mesh}")
    return mesh


@pytest.fixture(scope="session")
def open3d(mesh):
    """Return the peer with the mesh, if it is installed."""
    return open_peer("Open3D", mesh)


@pytest.fixture(scope="session")
def embreex(mesh):
    """Return the peer with the mesh, if it is installed."""
    return open_peer("embreex", mesh)


def open_peer(name: str, mesh: clbvh.Mesh) -> Any:
    """Return an engine that has built its tree."""
    for package in ENGINES[name].packages:
        pytest.importorskip(package, reason=f"peers: {package} is not installed, `make bench` does it")
    engine = ENGINES[name](mesh.vertices, mesh.faces)
    engine.build()
    return engine
