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
}


@pytest.fixture(scope="module", params=SHAPES)
def engines(request, _opened_device):
    """Ours and the peer's."""
    try:
        from trimesh.ray.ray_pyembree import RayMeshIntersector as Embree
    except ImportError as error:
        pytest.skip(f"peers: embreex cannot be imported: {error}")
    mesh = SHAPES[request.param]()
    return RayMeshIntersector(mesh), Embree(mesh)


@pytest.fixture(scope="module")
def rays():
    generator = np.random.default_rng(85)
    origins = generator.uniform(-2, 2, (COUNT, 3))
    return origins, generator.uniform(-1, 1, (COUNT, 3)) - origins


def ask_both(engines, query, *arguments, **options):
    """Ours and the peer's arrays, of the same dtypes and number of axes."""
    answers = [getattr(engine, query)(*arguments, **options) for engine in engines]
    ours, theirs = (answer if isinstance(answer, tuple) else (answer,) for answer in answers)
    assert [(a.dtype, a.shape[1:]) for a in ours] == [(a.dtype, a.shape[1:]) for a in theirs]
    return ours, theirs


def test_first_hits_any_hits_and_what_is_inside(engines, rays):
    for query, arguments in (("intersects_first", rays), ("intersects_any", rays), ("contains_points", rays[:1])):
        (obtained,), (expected,) = ask_both(engines, query, *arguments)
        assert (obtained == expected).mean() >= AGREEMENT, query
        assert 0.01 < (obtained > 0).mean() < 0.99, query


@pytest.mark.parametrize("multiple_hits", [False, True])
def test_locations_and_orders(engines, rays, multiple_hits):
    obtained, expected = ask_both(engines, "intersects_location", *rays, multiple_hits=multiple_hits)
    counts, peer_counts = (np.bincount(index_ray, minlength=COUNT) for _, index_ray, _ in (obtained, expected))
    same = counts == peer_counts
    assert same.mean() >= AGREEMENT
    # Of rays on whose number of hits both agree, each one's hits stand in the same order.
    kept, peer_kept = (
        np.flatnonzero(same[index_ray])[np.argsort(index_ray[same[index_ray]], kind="stable")]
        for _, index_ray, _ in (obtained, expected)
    )
    np.testing.assert_array_equal(obtained[1][kept], expected[1][peer_kept])
    assert (obtained[2][kept] == expected[2][peer_kept]).mean() >= AGREEMENT
    distance = np.linalg.norm(obtained[0][kept] - expected[0][peer_kept], axis=1)
    assert np.quantile(distance, AGREEMENT) < 1e-5
