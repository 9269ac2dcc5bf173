"""The same points through `trimesh.proximity`, which needs rtree and scipy, and through this engine."""

import numpy as np
import pytest
import trimesh

from clbvh.integrations import trimesh as engine
from clbvh.integrations.trimesh import ProximityQuery

COUNT = 3000
AGREEMENT = 0.999

SHAPES = {
    "box": trimesh.creation.box,
    "icosphere": lambda: trimesh.creation.icosphere(3),
    "torus": lambda: trimesh.creation.torus(1.0, 0.3),
    "annulus": lambda: trimesh.creation.annulus(0.5, 1.0, 0.7, sections=60),
    "capsule": lambda: trimesh.creation.capsule(1.0, 0.4),
    "open": lambda: trimesh.creation.icosphere(3).submesh([np.arange(900)], append=True),
    "tetrahedron": lambda: trimesh.Trimesh(
        [[-1, 0.5, 0], [1, 0.5, 0], [0, -1, -0.5], [0, -1, 0.5]], [[0, 1, 2], [0, 2, 3], [0, 3, 1], [3, 2, 1]]
    ),
    "soup": lambda: trimesh.Trimesh(
        trimesh.creation.box().triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False
    ),
}


@pytest.fixture(scope="module", autouse=True)
def _rtree():
    for library in ("rtree", "scipy"):
        try:
            __import__(library)
        except (ImportError, OSError) as error:
            pytest.skip(f"peers: {library} cannot be imported: {error}")


@pytest.fixture(scope="module", params=SHAPES)
def mesh(request, _opened_device):
    return SHAPES[request.param]()


@pytest.fixture(scope="module")
def points(mesh):
    generator = np.random.default_rng(96)
    size = np.ptp(mesh.bounds, axis=0).max()
    anywhere = mesh.bounds.mean(axis=0) + generator.uniform(-1, 1, (COUNT, 3)) * size
    close = mesh.triangles_center[generator.integers(0, len(mesh.faces), COUNT)]
    return np.concatenate((anywhere, close + generator.normal(0, size / 100, (COUNT, 3))))


def check_types(obtained, expected):
    obtained, expected = (answer if isinstance(answer, tuple) else (answer,) for answer in (obtained, expected))
    assert [(a.dtype, a.shape) for a in obtained] == [(a.dtype, a.shape) for a in expected]


def check_distances(obtained, expected):
    """Ours are never larger; trimesh's are, as far as its tolerance for equal squares reaches."""
    assert (obtained <= expected + 2e-6).all()
    assert (expected**2 - obtained**2 < trimesh.tol.merge + 1e-12).all()
    assert np.isclose(obtained, expected, rtol=1e-6, atol=1e-9).mean() >= 0.995


def test_closest_points(mesh, points):
    obtained, expected = (module.closest_point(mesh, points) for module in (engine, trimesh.proximity))
    check_types(obtained, expected)
    check_distances(obtained[1], expected[1])
    same = (np.linalg.norm(obtained[0] - expected[0], axis=1) < 1e-5) & np.isclose(obtained[1], expected[1], rtol=1e-6)
    assert same.mean() >= 0.995
    # Other faces where more than two are equally near, of which trimesh looks at two; then ours faces the point more.
    others = np.flatnonzero(same & (obtained[2] != expected[2]))
    ways = points[others] - obtained[0][others]
    ours, theirs = ((mesh.face_normals[ids[others]] * ways).sum(axis=1) for ids in (obtained[2], expected[2]))
    assert (ours >= theirs - 1e-6).all()


def test_faces_beside_vertices_and_edges(mesh, points):
    """Where only two faces are equally near, the same one is chosen."""
    obtained, expected = (module.closest_point(mesh, points)[2] for module in (engine, trimesh.proximity))
    normals = mesh.face_normals
    alike = np.linalg.norm(normals[obtained] - normals[expected], axis=1) < 1e-6
    assert alike.mean() > 0.8


def test_signed_distances(mesh, points):
    obtained, expected = (module.signed_distance(mesh, points) for module in (engine, trimesh.proximity))
    check_types(obtained, expected)
    check_distances(np.abs(obtained), np.abs(expected))
    assert (np.sign(obtained) == np.sign(expected)).mean() >= (AGREEMENT if mesh.is_watertight else 0.97)


def test_vertices(mesh, points):
    obtained, expected = (
        query.vertex(points) for query in (ProximityQuery(mesh), trimesh.proximity.ProximityQuery(mesh))
    )
    check_types(obtained, expected)
    np.testing.assert_allclose(obtained[0], expected[0], rtol=1e-12)
    at, peer_at = (mesh.vertices[vertex_id] for vertex_id in (obtained[1], expected[1]))
    assert (at == peer_at).all(axis=1).mean() >= AGREEMENT


@pytest.mark.parametrize("exterior", [False, True])
@pytest.mark.parametrize("method", ["ray", "max_sphere"])
def test_thickness(mesh, method, exterior):
    at, face = mesh.triangles_center[::3], np.arange(len(mesh.faces))[::3]
    normals = mesh.face_normals[face]
    obtained, expected = (
        module.thickness(mesh, at, exterior=exterior, normals=normals, method=method)
        for module in (engine, trimesh.proximity)
    )
    check_types(obtained, expected)
    same = np.isclose(obtained, expected, rtol=1e-4) | (np.isinf(obtained) & np.isinf(expected))
    assert same.mean() >= 0.98


def test_tangent_spheres(mesh):
    at = mesh.triangles_center[::4]
    obtained, expected = (module.max_tangent_sphere(mesh, at) for module in (engine, trimesh.proximity))
    check_types(obtained, expected)
    same = np.isclose(obtained[1], expected[1], rtol=1e-4) | (np.isinf(obtained[1]) & np.isinf(expected[1]))
    assert same.mean() >= 0.98
    np.testing.assert_allclose(obtained[0][same], expected[0][same], atol=1e-3)


def test_longest_rays(mesh, points):
    ways = np.random.default_rng(97).normal(size=points.shape)
    obtained, expected = (module.longest_ray(mesh, points, ways) for module in (engine, trimesh.proximity))
    check_types(obtained, expected)
    same = np.isclose(obtained, expected, rtol=1e-5) | (np.isinf(obtained) & np.isinf(expected))
    assert same.mean() >= AGREEMENT
