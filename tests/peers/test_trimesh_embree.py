"""The same rays through trimesh with embreex and with this engine.

trimesh's own tests of its ray engines are in its source distribution, without the meshes they load; they pass with this
class as `trimesh.ray.ray_pyembree.RayMeshIntersector` and stand-ins of the same shapes.
"""

import numpy as np
import pytest
import trimesh

from clbvh.integrations.trimesh import RayMeshIntersector

COUNT = 50_000
AGREEMENT = 0.9999

SHAPES = {
    "icosphere": lambda: trimesh.creation.icosphere(4),
    "torus": lambda: trimesh.creation.torus(1.0, 0.3, major_sections=90, minor_sections=60),
    "annulus": lambda: trimesh.creation.annulus(0.5, 1.0, 0.7, sections=100),
    "capsule": lambda: trimesh.creation.capsule(1.0, 0.4, count=[60, 60]),
}


@pytest.fixture(scope="module")
def embree():
    """The peer's class, if it is installed."""
    try:
        from trimesh.ray.ray_pyembree import RayMeshIntersector as Embree
    except ImportError as error:
        pytest.skip(f"peers: embreex cannot be imported: {error}")
    return Embree


@pytest.fixture(scope="module", params=SHAPES)
def engines(request, _opened_device, embree):
    mesh = SHAPES[request.param]()
    ours = RayMeshIntersector(mesh, device=_opened_device.info.number)
    yield ours, embree(mesh)
    ours.close()


@pytest.fixture(scope="module")
def rays():
    generator = np.random.default_rng(85)
    origins = generator.uniform(-2, 2, (COUNT, 3))
    return origins, generator.uniform(-1, 1, (COUNT, 3)) - origins


def test_first_and_any(engines, rays):
    (ours, theirs), (first, expected) = engines, (engine.intersects_first(*rays) for engine in engines)
    assert (first == expected).mean() >= AGREEMENT
    assert (first.dtype, first.shape) == (expected.dtype, expected.shape)
    any_hit, expected = ours.intersects_any(*rays), theirs.intersects_any(*rays)
    assert (any_hit == expected).mean() >= AGREEMENT
    assert any_hit.dtype == expected.dtype
    assert 0.1 < any_hit.mean() < 0.99


@pytest.mark.parametrize("multiple_hits", [False, True])
def test_locations_and_orders(engines, rays, multiple_hits):
    obtained, expected = (engine.intersects_location(*rays, multiple_hits=multiple_hits) for engine in engines)
    for array, peer in zip(obtained, expected, strict=True):
        assert array.dtype == peer.dtype
        assert array.shape[1:] == peer.shape[1:]
    counts, peer_counts = (np.bincount(index_ray, minlength=COUNT) for _, index_ray, _ in (obtained, expected))
    same = counts == peer_counts
    assert same.mean() >= AGREEMENT
    # Of rays on whose number of hits both agree, the first hits stand in the same order, and so do each one's hits. The
    # peer's later hits come later still where it was stuck on a triangle.
    kept, peer_kept = same[obtained[1]], same[expected[1]]
    first_count = np.count_nonzero(same & (counts > 0))
    np.testing.assert_array_equal(obtained[1][kept][:first_count], expected[1][peer_kept][:first_count])
    kept, peer_kept = (
        np.flatnonzero(rows)[np.argsort(index_ray[rows], kind="stable")]
        for rows, index_ray in ((kept, obtained[1]), (peer_kept, expected[1]))
    )
    np.testing.assert_array_equal(obtained[1][kept], expected[1][peer_kept])
    assert (obtained[2][kept] == expected[2][peer_kept]).mean() >= AGREEMENT
    distance = np.linalg.norm(obtained[0][kept] - expected[0][peer_kept], axis=1)
    assert np.quantile(distance, AGREEMENT) < 1e-5


def test_contains(engines):
    points = np.random.default_rng(86).uniform(-1.5, 1.5, (COUNT, 3))
    obtained, expected = (engine.contains_points(points) for engine in engines)
    assert (obtained == expected).mean() >= AGREEMENT
    assert 0.01 < obtained.mean() < 0.9


def test_nothing_looks_alike(engines):
    for origins, directions in ((np.empty((0, 3)), np.empty((0, 3))), ([[9, 9, 9]], [[1, 0, 0]])):
        for query in ("intersects_first", "intersects_any", "intersects_id", "intersects_location"):
            answers = [getattr(engine, query)(origins, directions) for engine in engines]
            obtained, expected = (answer if isinstance(answer, tuple) else (answer,) for answer in answers)
            assert [(a.dtype, a.shape) for a in obtained] == [(a.dtype, a.shape) for a in expected]
