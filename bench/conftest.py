"""The benchmark mesh: the dragon where it is, the knot of the same size where it is not."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import clbvh


@pytest.fixture(scope="session")
def mesh() -> clbvh.Mesh:
    """About 871,000 triangles."""
    path = Path(os.environ.get("CLBVH_MESHES", "")) / "dragon_871k.ply"
    mesh = clbvh.load_mesh(path) if path.is_file() else clbvh.make_shape("knot", triangles=871_200, seed=1)
    print(f"\n{mesh}")
    return mesh


@pytest.fixture(scope="session")
def open3d():
    """Return the peer, if it is installed."""
    return pytest.importorskip("open3d", reason="peers: open3d is not installed, `make bench` does it")
