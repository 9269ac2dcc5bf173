"""The same points through `trimesh.proximity`, which needs rtree and scipy, and through this engine."""

import itertools

import numpy as np
import pytest
import trimesh

from clbvh.integrations import trimesh as engine
from clbvh.integrations.trimesh import ProximityQuery

COUNT = 3000

SHAPES = {
    "box": trimesh.creation.box,
    "torus": lambda: trimesh.creation.torus(1.0, 0.3),
    "annulus": lambda: trimesh.creation.annulus(0.5, 1.0, 0.7, sections=60),
    "open": lambda: trimesh.creation.icosphere(3).submesh([np.arange(900)], append=True),
    "soup": lambda: trimesh.Trimesh(
        trimesh.creation.box().triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False
    ),
}


@pytest.fixture(scope="module", params=SHAPES)
def mesh(request, _opened_device):
    for library in ("rtree", "scipy"):
        try:
            __import__(library)
        except (ImportError, OSError) as error:
            pytest.skip(f"peers: {library} cannot be imported: {error}")
    return SHAPES[request.param]()


@pytest.fixture(scope="module")
def points(mesh):
    generator = np.random.default_rng(96)
    size = np.ptp(mesh.bounds, axis=0).max()
    anywhere = mesh.bounds.mean(axis=0) + generator.uniform(-1, 1, (COUNT, 3)) * size
    close = mesh.triangles_center[generator.integers(0, len(mesh.faces), COUNT)]
    return np.concatenate((anywhere, close + generator.normal(0, size / 100, (COUNT, 3))))


def ask_both(query, *arguments, **options):
    """Ours and trimesh's arrays, of the same dtypes and shapes."""
    answers = [getattr(module, query)(*arguments, **options) for module in (engine, trimesh.proximity)]
    ours, theirs = (answer if isinstance(answer, tuple) else (answer,) for answer in answers)
    assert [(a.dtype, a.shape) for a in ours] == [(a.dtype, a.shape) for a in theirs]
    return ours, theirs


def check_distances(obtained, expected):
    """Ours are never larger; trimesh's are, as far as its tolerance for equal squares reaches."""
    assert (obtained <= expected + 2e-6).all()
    assert (expected**2 - obtained**2 < trimesh.tol.merge + 1e-12).all()
    assert np.isclose(obtained, expected, rtol=1e-6, atol=1e-9).mean() >= 0.995


def test_closest_points(mesh, points):
    obtained, expected = ask_both("closest_point", mesh, points)
    check_distances(obtained[1], expected[1])
    same = (np.linalg.norm(obtained[0] - expected[0], axis=1) < 1e-5) & np.isclose(obtained[1], expected[1], rtol=1e-6)
    assert same.mean() >= 0.995
    # Other faces where more than two are equally near, of which trimesh looks at two; then ours faces the point more.
    others = np.flatnonzero(same & (obtained[2] != expected[2]))
    ways = points[others] - obtained[0][others]
    ours, theirs = ((mesh.face_normals[ids[others]] * ways).sum(axis=1) for ids in (obtained[2], expected[2]))
    assert (ours >= theirs - 1e-6).all()
    turned = mesh.face_normals[obtained[2]] - mesh.face_normals[expected[2]]
    assert (np.linalg.norm(turned, axis=1) < 1e-6).mean() > 0.8


def test_signed_distances_and_nearest_vertices(mesh, points):
    (obtained,), (expected,) = ask_both("signed_distance", mesh, points)
    check_distances(np.abs(obtained), np.abs(expected))
    assert (np.sign(obtained) == np.sign(expected)).mean() >= (0.999 if mesh.is_watertight else 0.97)
    ours, theirs = (kind(mesh).vertex(points)[0] for kind in (ProximityQuery, trimesh.proximity.ProximityQuery))
    np.testing.assert_allclose(ours, theirs, rtol=1e-12)


def test_thickness_tangent_spheres_and_longest_rays(mesh, points):
    at, ways = mesh.triangles_center[::4], np.random.default_rng(97).normal(size=points.shape)
    queries = [("max_tangent_sphere", (mesh, at), {}), ("longest_ray", (mesh, points, ways), {})]
    for method, exterior in itertools.product(("ray", "max_sphere"), (False, True)):
        options = {"exterior": exterior, "normals": mesh.face_normals[::4], "method": method}
        queries.append(("thickness", (mesh, at), options))
    for query, arguments, options in queries:
        obtained, expected = (answer[-1] for answer in ask_both(query, *arguments, **options))
        rtol, share = (1e-5, 0.999) if query == "longest_ray" else (1e-4, 0.98)
        same = np.isclose(obtained, expected, rtol=rtol) | (np.isinf(obtained) & np.isinf(expected))
        assert same.mean() >= share, (query, options)
