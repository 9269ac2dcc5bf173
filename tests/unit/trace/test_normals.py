"""Normals of hits as an array, and as a function: smooth, and facing the ray."""

import copy
import pickle

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh.errors import ConfigError
from clbvh.trace.hits.hits import Hits
from clbvh.trace.hits.surface import Surface

BALL = clbvh.make_shape("icosphere", triangles=1280)
THIRD = np.full(BALL.face_count, 1 / 3)
MIDDLES = Hits(
    THIRD, THIRD, THIRD, np.arange(BALL.face_count, dtype=np.int32), BALL,
    is_front=np.arange(BALL.face_count) % 2 == 0,
)  # fmt: skip


def placed(mesh, transform, hits):
    surface = Surface.from_shapes([mesh], ["mesh"], np.zeros(1, np.int32), np.asarray(transform)[None])
    return Hits(
        hits.t, hits.u, hits.v, hits.prim_id, is_front=hits.is_front,
        surface=surface, known_instance_id=hits.instance_id,
    )  # fmt: skip


def random_hits(mesh, count, seed):
    generator = np.random.default_rng(seed)
    u, v = generator.uniform(0, 0.5, (2, count))
    prim_id = generator.integers(-1, mesh.face_count, count).astype(np.int32)
    return Hits(u, u, v, prim_id, mesh, is_front=generator.random(count) < 0.5)


def test_normals_behave_as_a_plain_array():
    normals = MIDDLES.normals
    plain = np.asarray(normals)
    assert type(plain) is np.ndarray
    assert repr(normals[:2]) == repr(plain[:2])
    assert repr(normals) == repr(plain)
    assert str(normals) == str(plain)
    results = {
        "ufunc": normals * 2, "reflected": 2 * normals, "negative": -normals, "comparison": normals > 0,
        "product": normals @ np.eye(3), "sum": normals.sum(axis=1), "index": normals[0], "mask": normals[plain > 0],
        "function": np.where(plain > 0, normals, 0), "list": np.concatenate([normals, normals]),
        "einsum": np.einsum("ij,ij->i", normals, normals), "named": np.stack(arrays=(normals, normals)),
        "copy": np.array(normals), "pickle": pickle.loads(pickle.dumps(normals)), "method": np.add.reduce(normals),
        "deep copy": copy.deepcopy(normals),
    }  # fmt: skip
    for name, result in results.items():
        assert type(result) is np.ndarray, name
    np.testing.assert_array_equal(results["pickle"], plain)
    np.testing.assert_array_equal(results["list"], np.concatenate([plain, plain]))
    assert type(normals[0, 0]) is np.float64


def test_changes_in_place_leave_plain_arrays_and_reach_the_memory():
    normals = MIDDLES.normals
    expected = -np.asarray(normals)
    np.negative(normals, out=normals)
    np.testing.assert_array_equal(normals, expected)
    normals *= 2
    assert type(normals) is np.ndarray
    np.testing.assert_array_equal(normals, 2 * expected)


def test_only_the_normals_of_hits_can_be_called():
    with pytest.raises(TypeError, match="only the normals of hits can be called"):
        MIDDLES.normals.reshape(-1)()
    with pytest.raises(TypeError):
        MIDDLES.normals(True)


def test_without_wishes_the_call_returns_the_array():
    assert MIDDLES.normals().tobytes() == MIDDLES.normals.tobytes()
    assert type(MIDDLES.normals()) is np.ndarray


def test_facing_turns_the_normals_of_hits_from_behind():
    turned = MIDDLES.normals(facing=True)
    np.testing.assert_array_equal(turned[::2], MIDDLES.normals[::2])
    np.testing.assert_array_equal(turned[1::2], -MIDDLES.normals[1::2])


def test_facing_needs_the_side_of_the_ray():
    hits = Hits(MIDDLES.t, MIDDLES.u, MIDDLES.v, MIDDLES.prim_id, BALL)
    assert hits.normals(smooth=True).shape == (BALL.face_count, 3)
    with pytest.raises(ConfigError, match="from which side"):
        hits.normals(facing=True)


def test_facing_normals_point_against_the_rays():
    generator = np.random.default_rng(0)
    origins, directions = generator.normal(size=(2, 2000, 3))
    with clbvh.Tracer(clbvh.make_shape("knot", triangles=2000)) as tracer:
        hits = tracer.closest_hit(origins, directions)
    along = (hits.normals(facing=True) * directions).sum(axis=1)[hits.is_hit]
    assert len(along) > 100
    assert (along <= 0).all()


def test_smooth_normals_of_a_sphere_are_close_to_its_own():
    hits = random_hits(BALL, 3000, 0)[random_hits(BALL, 3000, 0).is_hit]
    outwards = hits.locations / np.linalg.norm(hits.locations, axis=1, keepdims=True)
    assert np.abs(hits.normals - outwards).max() > 0.03
    assert np.abs(hits.normals(smooth=True) - outwards).max() < 5e-3


def test_smooth_normals_are_the_vertex_normals_at_vertices_and_the_same_from_both_sides_of_an_edge():
    knot = clbvh.make_shape("knot", triangles=2000)
    at_a, at_b, at_c = (
        Hits(*np.array([[1.0], [u], [v]]) * np.ones(knot.face_count), np.arange(knot.face_count, dtype=np.int32), knot)
        for u, v in ((0, 0), (1, 0), (0, 1))
    )
    for corner, hits in enumerate((at_a, at_b, at_c)):
        np.testing.assert_allclose(
            hits.normals(smooth=True), knot.vertex_normals[knot.faces[:, corner]], rtol=0, atol=1e-15
        )


def test_misses_have_no_normals_of_any_kind():
    hits = random_hits(BALL, 4000, 1)
    assert not hits.is_hit.all()
    for normals in (hits.normals(smooth=True), hits.normals(smooth=True, facing=True)):
        np.testing.assert_array_equal(np.isnan(normals).any(axis=1), ~hits.is_hit)
        np.testing.assert_allclose((normals[hits.is_hit] ** 2).sum(axis=1), 1, atol=1e-14)


def soup(seed):
    """Triangles at random around few points: faces disagree about their sides, and vertex normals cancel."""
    generator = np.random.default_rng(seed)
    return clbvh.Mesh.from_arrays(generator.normal(size=(12, 3)), generator.integers(0, 12, (200, 3)))


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("stretch", [None, 1.0, 1e-2, 1e9])
def test_smooth_normals_keep_to_the_side_of_the_face(stretch, seed):
    mesh = soup(seed)
    hits = random_hits(mesh, 3000, seed)
    if stretch is not None:
        transform = np.eye(4)
        transform[:3] = np.random.default_rng(seed).normal(size=(3, 4))
        transform[:3, 0] *= stretch
        hits = placed(mesh, transform, hits)
    flat, smooth = hits.normals, hits.normals(smooth=True)
    known = hits.is_hit & ~np.isnan(flat).any(axis=1)
    cosines = (flat * smooth).sum(axis=1)[known]
    assert (cosines > 0).all()
    assert (cosines < 0.99).any()
    sides = (hits.normals(smooth=True, facing=True) * flat).sum(axis=1)[known] > 0
    np.testing.assert_array_equal(sides, hits.is_front[known])


def test_a_mesh_of_one_flat_face_and_its_back_has_the_normal_of_the_face():
    both = clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 1]])
    hits = Hits(*np.full((3, 2), 0.25), np.array([0, 1], np.int32), both)
    np.testing.assert_array_equal(hits.normals(smooth=True), [[0, 0, 1], [0, 0, -1]])


@pytest.mark.parametrize("unit", [1e-30, 1.0, 1e30])
def test_smooth_normals_of_an_ellipsoid_are_those_of_the_formula(unit):
    axes = np.array([1, 2, 0.25])
    hits = placed(BALL, np.diag([*axes * unit, 1]), random_hits(BALL, 2000, 3))
    points = hits.locations[hits.is_hit] / unit
    exact = points / axes**2
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    assert np.abs(hits.normals(smooth=True)[hits.is_hit] - exact).max() < 0.02
    assert np.abs(hits.normals[hits.is_hit] - exact).max() > 0.1


def test_smooth_normals_of_spheres_and_meshes_in_one_scene():
    spheres = clbvh.Spheres([[0, 0, 0], [3, 0, 0]], [1, 2])
    surface = Surface.from_shapes([spheres, BALL], ["spheres", "ball"], np.array([1, 0, 1]), np.stack([np.eye(4)] * 3))
    hits = Hits(
        *np.full((3, 4), 0.25), np.array([0, 1, -1, 7], np.int32),
        surface=surface, known_instance_id=np.array([2, 1, -1, 0], np.int32),
    )  # fmt: skip
    smooth = hits.normals(smooth=True)
    np.testing.assert_array_equal(smooth[1], hits.normals[1])
    assert np.isnan(smooth[2]).all()
    for hit in (0, 3):
        location = hits.locations[hit]
        np.testing.assert_allclose(smooth[hit], location / np.linalg.norm(location), atol=5e-3)


@pytest.mark.parametrize("shape", [(), (0,), (2, 3)])
def test_normals_have_the_shape_of_the_hits(shape):
    ids = np.zeros(shape, np.int32)
    hits = Hits(*np.full((3, *shape), 0.25), ids, BALL, is_front=np.ones(shape, bool))
    assert hits.normals.shape == hits.normals(smooth=True, facing=True).shape == (*shape, 3)


def test_normals_are_taken_by_queries():
    box = trimesh.creation.box()
    with clbvh.Tracer(box) as tracer:
        hits = tracer.closest_hit([[0.1, 0.2, 5]], [[0, 0, -1]])
        assert not tracer.any_hit(hits.offset_origins(), hits.normals).any()
        assert tracer.any_hit(hits.normals * 5, -hits.normals).all()
        assert hits.offset_origins(towards=hits.normals)[0, 2] > 0.5
