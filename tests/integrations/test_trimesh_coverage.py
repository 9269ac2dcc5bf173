"""The table in docs/trimesh.md: which parts of trimesh call the engine once it is installed, and which do not."""

import contextlib
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from clbvh.integrations.trimesh import install
from clbvh.integrations.trimesh.tracers import FollowingTracer

PAGE = Path(__file__).parents[2] / "docs" / "trimesh.md"
POINTS = np.random.default_rng(95).uniform(-1, 1, (20, 3))
RAYS = POINTS, -POINTS
SPECIAL = {
    "mesh.contains": lambda mesh: mesh.contains(POINTS),
    "trimesh.proximity.longest_ray": lambda mesh: trimesh.proximity.longest_ray(mesh, *RAYS),
    "trimesh.ray.ray_util.contains_points(mesh.ray, ...)": lambda mesh: trimesh.ray.ray_util.contains_points(
        mesh.ray, POINTS
    ),
    "trimesh.ray.ray_triangle.RayMeshIntersector(mesh)": lambda mesh: trimesh.ray.ray_triangle.RayMeshIntersector(
        mesh
    ).intersects_any(*RAYS),
    'mesh.voxelized(..., method="ray")': lambda mesh: mesh.voxelized(0.2, method="ray"),
    'mesh.voxelized(..., method="subdivide")': lambda mesh: mesh.voxelized(0.2, method="subdivide"),
    "trimesh.voxel.creation.local_voxelize": lambda mesh: trimesh.voxel.creation.local_voxelize(
        mesh, mesh.vertices[0], 0.1, 3
    ),
    "trimesh.sample.volume_mesh": lambda mesh: trimesh.sample.volume_mesh(mesh, 20),
    "mesh.sample": lambda mesh: mesh.sample(20),
    "scene.camera_rays": lambda mesh: mesh.scene().camera_rays(),
    "trimesh.registration.mesh_other": lambda mesh: trimesh.registration.mesh_other(
        mesh, mesh.copy(), samples=20, icp_first=1, icp_final=1
    ),
    "trimesh.registration.icp with a mesh": lambda mesh: trimesh.registration.icp(POINTS, mesh, max_iterations=2),
    "trimesh.registration.nricp_sumner": lambda mesh: trimesh.registration.nricp_sumner(
        mesh, mesh.copy(), steps=[[1, 0.1, 1, 0, 0]], face_pairs_type="edge"
    ),
    "mesh.kdtree": lambda mesh: mesh.kdtree,
    "mesh.triangles_tree": lambda mesh: mesh.triangles_tree,
    "mesh.section": lambda mesh: mesh.section([0, 0, 1], [0, 0, 0]),
}


def call(name, mesh):
    """Do what a line of the table names: a query of rays, of points, or something special."""
    if name in SPECIAL:
        return SPECIAL[name](mesh)
    owner, _, query = name.rpartition(".")
    if owner == "mesh.ray":
        return getattr(mesh.ray, query)(*(RAYS if query.startswith("intersects") else RAYS[:1]))
    if owner == "mesh.nearest":
        return getattr(mesh.nearest, query)(POINTS)
    if owner == "trimesh.proximity.ProximityQuery(mesh)":
        return getattr(trimesh.proximity.ProximityQuery(mesh), query)(POINTS)
    assert owner == "trimesh.proximity", name
    return getattr(trimesh.proximity, query)(mesh, POINTS)


def read_table():
    """The answer of each line of the table."""
    rows = re.findall(r"^\| (.*?`.*?) \| (yes|no|in part)[^|]* \|$", PAGE.read_text(), re.MULTILINE)
    return {name.replace("`", ""): answer for name, answer in rows}


@pytest.fixture
def calls(monkeypatch):
    """The names of the engine's queries that were called."""
    called = []

    def count(method):
        def counted(self, *arguments, **more):
            called.append(method.__name__)
            return method(self, *arguments, **more)

        return counted

    for method in (FollowingTracer.ask, FollowingTracer.find_tree):
        monkeypatch.setattr(FollowingTracer, method.__name__, count(method))
    return called


@pytest.mark.parametrize("name", read_table())
def test_the_table_is_right(session, calls, name):
    mesh = trimesh.creation.icosphere(2)
    with install(device=session.info.number):
        try:
            call(name, mesh)
        except (ImportError, AttributeError) as error:
            if not re.search(r"scipy|rtree|cKDTree|networkx|coo_matrix|spsolve|index", str(error)):
                raise
            pytest.skip(f"peers: trimesh misses a library here: {error}")
    assert bool(calls) == (read_table()[name] != "no")


def test_the_table_has_every_line_and_without_installing_nothing_is_called(session, calls):
    assert len(read_table()) >= 32
    assert SPECIAL.keys() <= read_table().keys()
    mesh = trimesh.creation.icosphere(2)
    with install():
        _ = mesh.ray, mesh.nearest
    for name in ("mesh.contains", 'mesh.voxelized(..., method="ray")'):
        # trimesh's own engine is asked, which may miss rtree.
        with contextlib.suppress(ImportError):
            call(name, mesh)
    assert calls == []


def test_voxels_and_samples_are_those_of_the_mesh(session):
    ball, torus = trimesh.creation.icosphere(3), trimesh.creation.torus(1.0, 0.3)
    with install():
        grid = ball.voxelized(0.1, method="ray")
        inside = trimesh.sample.volume_mesh(torus, 500)
    assert grid.filled_count > 500
    assert np.abs(np.linalg.norm(grid.points, axis=1) - 1).max() < 0.15
    assert len(inside) > 50
    assert (np.hypot(np.hypot(inside[:, 0], inside[:, 1]) - 1, inside[:, 2]) <= 0.305).all()  # the facets' share
