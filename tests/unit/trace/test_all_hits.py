"""All hits of rays and their counts: they agree with the oracle and the other queries, however they are collected."""

import numpy as np
import pytest

from clbvh import AllHits, Mesh, Scene, Tracer, Transform, make_shape
from clbvh.integrations.trimesh.ray import order_by_depth
from clbvh.trace.hits import all_hits as module
from clbvh.trace.rays import pieces

from ...mesh_reference import find_wrong_crossings
from ...rays import hard_rays

FIELDS = ("t", "u", "v", "prim_id", "offsets")


@pytest.fixture(scope="module")
def expected(tracer, rays):
    hits = tracer.all_hits(*rays)
    assert hits.counts.max() >= 4
    assert (hits.counts == 0).sum() > 100
    return hits


def assert_same(obtained, expected):
    for field in FIELDS:
        assert getattr(obtained, field).tobytes() == getattr(expected, field).tobytes(), field


def test_all_queries_and_the_oracle_agree(tracer, mesh, rays, expected):
    assert find_wrong_crossings(mesh, *rays, expected).tolist() == []
    np.testing.assert_array_equal(tracer.count_hits(*rays), expected.counts)
    np.testing.assert_array_equal(tracer.any_hit(*rays), expected.counts > 0)
    closest = tracer.closest_hit(*rays)
    np.testing.assert_array_equal(tracer.closest_prim(*rays), closest.prim_id)
    first = expected.offsets[:-1][closest.is_hit]
    for field in ("t", "u", "v", "prim_id", "locations", "normals"):
        np.testing.assert_array_equal(getattr(expected, field)[first], getattr(closest, field)[closest.is_hit])
    np.testing.assert_array_equal(np.bincount(expected.ray_id, minlength=len(rays[0])), expected.counts)
    assert (np.diff(expected.t)[np.diff(expected.ray_id) == 0] >= 0).all()
    on_ray = rays[0][expected.ray_id] + expected.t[:, None] * rays[1][expected.ray_id]
    distance = np.linalg.norm(on_ray - expected.locations, axis=1)
    assert np.quantile(distance, 0.95) < 1e-13
    assert distance.max() < 1e-3


def test_the_oracle_finds_what_is_wrong(mesh, rays, expected):
    """One crossing of one ray at a time, of a ray that passes no edge closely."""
    inner = (expected.u > 0.1) & (expected.v > 0.1) & (expected.u + expected.v < 0.9) & (expected.t > 0.01)
    rows = np.flatnonzero(inner & (np.abs((expected.normals * rays[1][expected.ray_id]).sum(axis=1)) > 0.3))
    row = rows[len(rows) // 2]
    ray = int(expected.ray_id[row])
    later = np.arange(len(expected.offsets)) > ray
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    elsewhere = expected.prim_id.copy()
    elsewhere[row] = np.argmax(np.linalg.norm(centres - centres[elsewhere[row]], axis=1))
    for prim_id, offsets in (
        (np.delete(expected.prim_id, row), expected.offsets - later),
        (np.insert(expected.prim_id, row, expected.prim_id[row]), expected.offsets + later),
        (elsewhere, expected.offsets),
    ):
        nothing = np.zeros(len(prim_id))
        changed = AllHits(nothing, nothing, nothing, prim_id, mesh, offsets=offsets)
        assert find_wrong_crossings(mesh, *rays, changed).tolist() == [ray]


@pytest.mark.parametrize("most", [None, 1, 2, 1000])
@pytest.mark.parametrize("slots", [(1, 2), (2, 3), (8, 4)], ids=str)
def test_max_hits_keeps_the_nearest_however_many_slots_rays_begin_with(
    tracer, rays, expected, monkeypatch, slots, most
):
    monkeypatch.setattr(module, "FIRST_SLOTS", slots[0])
    monkeypatch.setattr(module, "SLOT_GROWTH", slots[1])
    hits = tracer.all_hits(*rays, max_hits=most, with_locations=True)
    kept = np.arange(len(expected)) - expected.offsets[expected.ray_id] < (most or np.inf)
    for field in ("t", "u", "v", "prim_id", "ray_id", "locations"):
        np.testing.assert_array_equal(getattr(hits, field), getattr(expected, field)[kept])
    counts = np.minimum(expected.counts, most or 2**31)
    np.testing.assert_array_equal(tracer.count_hits(*rays, max_hits=most), counts)
    order = np.lexsort((hits.ray_id, np.arange(len(hits)) - hits.offsets[hits.ray_id]))
    for obtained, by_depth in zip(order_by_depth(hits), (order, hits.ray_id[order]), strict=True):
        np.testing.assert_array_equal(obtained, by_depth)


def test_threads_share_the_hits(tracer, mesh, monkeypatch):
    """More hits than one thread is given, and each array as it is in one thread; rows in any layout."""
    rays = hard_rays(mesh, 60000, np.random.default_rng(12))
    expected = tracer.all_hits(*rays, with_locations=True)
    assert len(expected) > 40000
    monkeypatch.setattr(module, "LEAST_HITS", 1000)
    monkeypatch.setattr(tracer._caster.threads, "count", 5)
    monkeypatch.setattr(module, "_MOST_RAYS", 777)
    hits = tracer.all_hits(*map(np.asfortranarray, rays), with_locations=True)
    assert_same(hits, expected)
    assert hits.locations.tobytes() == expected.locations.tobytes()


@pytest.mark.parametrize(("chunk", "most"), [(2**20, 2**21), (100, 2**21), (1000, 64), (4096, 7), (4096, 1), (1, 1)])
def test_any_number_of_rays_in_any_chunks(tracer, rays, expected, monkeypatch, chunk, most):
    monkeypatch.setattr(pieces, "CHUNK_RAYS", chunk)
    monkeypatch.setattr(module, "MOST_SLOTS", most)
    for count in (0, 1, 63, 64, 65, 200, *((1024, 1025, 3072) if chunk > 1 else ())):
        told = []
        hits = tracer.all_hits(rays[0][:count], rays[1][:count], progress=lambda *now, told=told: told.append(now))
        np.testing.assert_array_equal(hits.offsets, expected.offsets[: count + 1])
        for field in ("t", "u", "v", "prim_id"):
            assert getattr(hits, field).tobytes() == getattr(expected, field)[: expected.offsets[count]].tobytes()
        if count:
            assert told[-1] == (count, count)
            assert len(told) == -(-count // min(chunk, max(1, most // module.FIRST_SLOTS)))
    if chunk > 1:
        np.testing.assert_array_equal(tracer.count_hits(*rays), expected.counts)


def test_limits_hold_for_every_hit(tracer, rays, expected):
    hits = tracer.all_hits(*rays, t_min=0.4, t_max=0.9)
    np.testing.assert_array_equal(tracer.count_hits(*rays, t_min=0.4, t_max=0.9), hits.counts)
    # Those that are closer to a limit than float32 resolves may count or not.
    surely, maybe = ((expected.t > 0.4 + blur) & (expected.t < 0.9 - blur) for blur in (1e-4, -1e-4))
    assert 500 < surely.sum() <= len(hits) <= maybe.sum()
    assert ((hits.t >= 0.4) & (hits.t <= 0.9)).all()


def test_each_ray_keeps_its_limits_when_it_is_cast_again(tracer, rays, monkeypatch):
    monkeypatch.setattr(module, "FIRST_SLOTS", 1)
    generator = np.random.default_rng(12)
    limits = {"t_min": generator.uniform(0, 0.8, len(rays[0])), "t_max": generator.uniform(0.4, 2, len(rays[0]))}
    hits = tracer.all_hits(*rays, **limits)
    assert (hits.counts > 1).sum() > 100
    np.testing.assert_array_equal(hits.counts, tracer.count_hits(*rays, **limits))
    assert (hits.t >= limits["t_min"][hits.ray_id]).all()
    assert (hits.t <= limits["t_max"][hits.ray_id]).all()


def test_a_stack_of_sheets_is_counted_sheet_by_sheet(session):
    sheets = 300
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float64)
    vertices = np.concatenate([corners + np.array([0, 0, height]) for height in range(sheets)])
    faces = np.arange(3 * sheets).reshape(-1, 3)[::-1]
    with Tracer(Mesh.from_arrays(vertices, faces), device=session.info) as tracer:
        hits = tracer.all_hits([[0.25, 0.25, -1], [5, 5, -1], [0.25, 0.25, 1000]], [[0, 0, 1], [0, 0, 1], [0, 0, -2]])
    assert hits.counts.tolist() == [sheets, 0, sheets]
    assert hits.t[:sheets].tolist() == list(range(1, sheets + 1))
    assert hits.prim_id.tolist() == list(range(sheets))[::-1] + list(range(sheets))
    assert hits.ray_id.tolist() == [0] * sheets + [2] * sheets


def test_equal_distances_are_in_the_order_of_the_faces(session):
    mesh = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]] * 4)
    with Tracer(mesh, device=session.info) as tracer:
        for most, found in ((None, [0, 1, 2, 3]), (2, [0, 1])):
            assert tracer.all_hits([[0.3, 0.2, 1]], [[0.01, 0.02, -0.7]], max_hits=most).prim_id.tolist() == found


def test_locations_in_a_scene_are_on_the_instance_that_is_hit(session):
    scene = Scene()
    ball = scene.add(make_shape("icosphere", triangles=320))
    for x in (-3.0, 0.0, 3.0):
        scene.place(ball, Transform(scale=(1, 2, 1), translate=(x, 1, 0)))
    with Tracer(scene, device=session.info) as tracer:
        hits, later = (tracer.all_hits([-9.0, 1.1, 0.2], [1.0, 0.0, 0.0], with_locations=now) for now in (True, False))
    assert hits.instance_id.tolist() == [0, 0, 1, 1, 2, 2]
    np.testing.assert_array_equal(hits.locations, later.locations)
    assert (np.abs(hits.locations[:, 0] - np.repeat([-3, 0, 3], 2)) <= 1).all()
