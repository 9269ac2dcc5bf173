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
PROXIMITY = trimesh.proximity


def register_icp(mesh):
    return trimesh.registration.icp(POINTS, mesh, max_iterations=2)


def register_sumner(mesh):
    other = mesh.copy()
    return trimesh.registration.nricp_sumner(mesh, other, steps=[[1, 0.1, 1, 0, 0]], face_pairs_type="edge")


# By the first column of the table.
CALLS = {
    "mesh.ray.intersects_location": lambda mesh: mesh.ray.intersects_location(*RAYS),
    "mesh.ray.intersects_id": lambda mesh: mesh.ray.intersects_id(*RAYS),
    "mesh.ray.intersects_first": lambda mesh: mesh.ray.intersects_first(*RAYS),
    "mesh.ray.intersects_any": lambda mesh: mesh.ray.intersects_any(*RAYS),
    "mesh.ray.contains_points": lambda mesh: mesh.ray.contains_points(POINTS),
    "mesh.contains": lambda mesh: mesh.contains(POINTS),
    "mesh.nearest.on_surface": lambda mesh: mesh.nearest.on_surface(POINTS),
    "mesh.nearest.signed_distance": lambda mesh: mesh.nearest.signed_distance(POINTS),
    "mesh.nearest.vertex": lambda mesh: mesh.nearest.vertex(POINTS),
    "trimesh.proximity.closest_point": lambda mesh: PROXIMITY.closest_point(mesh, POINTS),
    "trimesh.proximity.signed_distance": lambda mesh: PROXIMITY.signed_distance(mesh, POINTS),
    "trimesh.proximity.longest_ray": lambda mesh: PROXIMITY.longest_ray(mesh, *RAYS),
    "trimesh.proximity.max_tangent_sphere": lambda mesh: PROXIMITY.max_tangent_sphere(mesh, POINTS),
    "trimesh.proximity.thickness": lambda mesh: PROXIMITY.thickness(mesh, POINTS),
    "trimesh.proximity.ProximityQuery(mesh).on_surface": lambda mesh: PROXIMITY.ProximityQuery(mesh).on_surface(POINTS),
    "trimesh.proximity.ProximityQuery(mesh).vertex": lambda mesh: PROXIMITY.ProximityQuery(mesh).vertex(POINTS),
    "trimesh.proximity.closest_point_naive": lambda mesh: PROXIMITY.closest_point_naive(mesh, POINTS),
    "trimesh.proximity.nearby_faces": lambda mesh: PROXIMITY.nearby_faces(mesh, POINTS),
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
    "trimesh.registration.icp with a mesh": register_icp,
    "trimesh.registration.nricp_sumner": register_sumner,
    "mesh.kdtree": lambda mesh: mesh.kdtree,
    "mesh.triangles_tree": lambda mesh: mesh.triangles_tree,
    "mesh.section": lambda mesh: mesh.section([0, 0, 1], [0, 0, 0]),
}


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


def run(call, mesh):
    """Run a call of trimesh, or skip where it misses a library of its own."""
    try:
        call(mesh)
    except (ImportError, ModuleNotFoundError, AttributeError) as error:
        missing = re.search(r"scipy|rtree|cKDTree|networkx|coo_matrix|spsolve|index", str(error))
        if missing is None:
            raise
        pytest.skip(f"peers: trimesh misses a library here: {error}")


def test_every_line_has_its_call():
    assert list(read_table()) == list(CALLS)


@pytest.mark.parametrize("name", CALLS)
def test_the_table_is_right(session, calls, name):
    mesh = trimesh.creation.icosphere(2)
    with install(device=session.info.number):
        run(CALLS[name], mesh)
    assert bool(calls) == (read_table()[name] != "no")


@pytest.mark.parametrize("name", ["mesh.contains", 'mesh.voxelized(..., method="ray")'])
def test_without_installing_nothing_is_called(session, calls, name):
    mesh = trimesh.creation.icosphere(2)
    with install():
        _ = mesh.ray, mesh.nearest
    # trimesh's own engine is asked, which may miss rtree.
    with contextlib.suppress(ImportError):
        CALLS[name](mesh)
    assert calls == []


def test_voxels_are_those_of_the_surface(session):
    mesh = trimesh.creation.icosphere(3)
    with install():
        grid = mesh.voxelized(0.1, method="ray")
    assert grid.filled_count > 500
    assert np.abs(np.linalg.norm(grid.points, axis=1) - 1).max() < 0.15


def test_samples_of_the_volume_are_inside(session):
    mesh = trimesh.creation.torus(1.0, 0.3)
    with install():
        inside = trimesh.sample.volume_mesh(mesh, 500)
    assert len(inside) > 50
    assert (np.hypot(np.hypot(inside[:, 0], inside[:, 1]) - 1, inside[:, 2]) <= 0.305).all()  # the facets' share
