"""The table in docs/trimesh.md: which parts of trimesh call the engine once it is installed, and which do not."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from clbvh.integrations.trimesh import install
from clbvh.integrations.trimesh.tracers import FollowingTracer

PAGE = Path(__file__).parents[2] / "docs" / "trimesh.md"
POINTS = np.random.default_rng(95).uniform(-1, 1, (20, 3))
# How a line of the table is called, where its name does not say it: rays, points, or something special.
CALLS = {
    "trimesh.proximity.longest_ray": "(mesh, points, -points)",
    "trimesh.ray.ray_util.contains_points(mesh.ray, ...)": "trimesh.ray.ray_util.contains_points(mesh.ray, points)",
    "trimesh.ray.ray_triangle.RayMeshIntersector(mesh)": ".intersects_any(points, -points)",
    'mesh.voxelized(..., method="ray")': 'mesh.voxelized(0.2, method="ray")',
    'mesh.voxelized(..., method="subdivide")': 'mesh.voxelized(0.2, method="subdivide")',
    "trimesh.voxel.creation.local_voxelize": "(mesh, mesh.vertices[0], 0.1, 3)",
    "trimesh.sample.volume_mesh": "(mesh, 20)",
    "mesh.sample": "(20)",
    "scene.camera_rays": "()",
    "trimesh.registration.mesh_other": "(mesh, mesh.copy(), samples=20, icp_first=1, icp_final=1)",
    "trimesh.registration.icp with a mesh": "trimesh.registration.icp(points, mesh, max_iterations=2)",
    "trimesh.registration.nricp_sumner": '(mesh, mesh.copy(), steps=[[1, 0.1, 1, 0, 0]], face_pairs_type="edge")',
    "mesh.kdtree": "",
    "mesh.triangles_tree": "",
    "mesh.section": "([0, 0, 1], [0, 0, 0])",
}


def call(name):
    """Do what a line of the table names, with a new mesh."""
    arguments = "(points)"
    if "intersects" in name:
        arguments = "(points, -points)"
    elif name.startswith("trimesh.proximity.") and "Query" not in name:
        arguments = "(mesh, points)"
    code = CALLS.get(name, arguments)
    mesh = trimesh.creation.icosphere(2)
    names = {"trimesh": trimesh, "mesh": mesh, "scene": mesh.scene(), "points": POINTS}
    return eval(code if code[:1].isalpha() else name + code, names)


def read_table():
    """The answer of each line of the table."""
    rows = re.findall(r"^\| (.*?`.*?) \| (yes|no|in part)[^|]* \|$", PAGE.read_text(), re.MULTILINE)
    return {name.replace("`", ""): answer for name, answer in rows}


@pytest.fixture
def calls(monkeypatch):
    """The names of the engine's queries that were called."""
    called = []

    def count(name):
        method = getattr(FollowingTracer, name)
        monkeypatch.setattr(FollowingTracer, name, lambda *a, **k: called.append(name) or method(*a, **k))

    count("ask")
    count("find_tree")
    return called


@pytest.mark.parametrize("name", read_table())
def test_the_table_is_right(session, calls, name):
    with install(device=session.info.number):
        try:
            call(name)
        except (ImportError, AttributeError) as error:
            if not re.search(r"scipy|rtree|cKDTree|networkx|coo_matrix|spsolve|index", str(error)):
                raise
            pytest.skip(f"peers: trimesh misses a library here: {error}")
    assert bool(calls) == (read_table()[name] != "no")


def test_the_table_has_every_line():
    assert len(read_table()) >= 32
    assert CALLS.keys() <= read_table().keys()
