"""All hits and their counts through the tracer: they agree with the other queries, however the batch is cut."""

import numpy as np
import pytest

from clbvh import AllHits, Mesh, Scene, Tracer, Transform, build, make_shape
from clbvh.integrations.trimesh.ray import order_by_depth
from clbvh.trace.hits import all_hits as crossings_module
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


def test_all_queries_agree(tracer, rays, expected):
    np.testing.assert_array_equal(tracer.count_hits(*rays), expected.counts)
    np.testing.assert_array_equal(tracer.any_hit(*rays), expected.counts > 0)
    closest = tracer.closest_hit(*rays)
    np.testing.assert_array_equal(tracer.closest_prim(*rays), closest.prim_id)
    np.testing.assert_array_equal(closest.is_hit, expected.counts > 0)
    first = expected.offsets[:-1][closest.is_hit]
    for field in ("t", "u", "v", "prim_id", "locations", "normals"):
        np.testing.assert_array_equal(getattr(expected, field)[first], getattr(closest, field)[closest.is_hit])


def test_crossings_are_ordered_and_belong_to_their_rays(rays, expected):
    assert expected.offsets.dtype == expected.ray_id.dtype == np.int64
    np.testing.assert_array_equal(np.bincount(expected.ray_id, minlength=len(rays[0])), expected.counts)
    same_ray = np.diff(expected.ray_id) == 0
    assert (np.diff(expected.t)[same_ray] >= 0).all()
    assert (np.diff(expected.ray_id) >= 0).all()
    assert expected.is_hit.all()
    on_ray = rays[0][expected.ray_id] + expected.t[:, None] * rays[1][expected.ray_id]
    distance = np.linalg.norm(on_ray - expected.locations, axis=1)
    assert np.quantile(distance, 0.95) < 1e-13
    assert distance.max() < 1e-3


def test_the_reference_agrees(mesh, rays, expected):
    assert find_wrong_crossings(mesh, *rays, expected).tolist() == []


@pytest.mark.parametrize("wrong", ["missing", "twice", "elsewhere"])
def test_the_reference_finds_what_is_wrong(mesh, rays, expected, wrong):
    """One crossing of one ray at a time, of a ray that passes no edge closely."""
    inner = (expected.u > 0.1) & (expected.v > 0.1) & (expected.u + expected.v < 0.9) & (expected.t > 0.01)
    rows = np.flatnonzero(inner & (np.abs((expected.normals * rays[1][expected.ray_id]).sum(axis=1)) > 0.3))
    row = rows[len(rows) // 2]
    ray = int(expected.ray_id[row])
    prim_id, offsets = expected.prim_id.copy(), expected.offsets.copy()
    if wrong == "missing":
        prim_id = np.delete(prim_id, row)
        offsets[ray + 1 :] -= 1
    elif wrong == "twice":
        prim_id = np.insert(prim_id, row, prim_id[row])
        offsets[ray + 1 :] += 1
    else:
        centres = mesh.vertices[mesh.faces].mean(axis=1)
        prim_id[row] = np.argmax(np.linalg.norm(centres - centres[prim_id[row]], axis=1))
    nothing = np.zeros(len(prim_id))
    changed = AllHits(nothing, nothing, nothing, prim_id, mesh, offsets=offsets)
    assert find_wrong_crossings(mesh, *rays, changed).tolist() == [ray]


@pytest.mark.parametrize("most", [1, 2, 3, 1000])
def test_max_hits_keeps_the_nearest(tracer, rays, expected, most):
    limited = tracer.all_hits(*rays, max_hits=most)
    kept = np.arange(len(expected)) - expected.offsets[expected.ray_id] < most
    for field in ("t", "u", "v", "prim_id", "ray_id"):
        np.testing.assert_array_equal(getattr(limited, field), getattr(expected, field)[kept])
    np.testing.assert_array_equal(tracer.count_hits(*rays, max_hits=most), np.minimum(expected.counts, most))


@pytest.mark.parametrize("most", [None, 2])
@pytest.mark.parametrize("slots", [(1, 2), (2, 3), (8, 4)], ids=str)
def test_depth_by_depth_is_another_order(tracer, rays, monkeypatch, slots, most):
    limited = tracer.all_hits(*rays, max_hits=most)
    depth = np.arange(len(limited)) - limited.offsets[limited.ray_id]
    order = np.lexsort((limited.ray_id, depth))
    monkeypatch.setattr(crossings_module, "FIRST_SLOTS", slots[0])
    monkeypatch.setattr(crossings_module, "SLOT_GROWTH", slots[1])
    hits = tracer.all_hits(*rays, max_hits=most, with_locations=True)
    assert_same(hits, limited)
    assert hits.locations.tobytes() == limited.locations.tobytes()
    obtained, ray_id = order_by_depth(hits)
    np.testing.assert_array_equal(obtained, order)
    np.testing.assert_array_equal(ray_id, limited.ray_id[order])


def test_threads_share_the_crossings(tracer, mesh, monkeypatch):
    """More hits than one thread is given, and each array as it is in one thread; rows in any layout."""
    origins, directions = hard_rays(mesh, 60000, np.random.default_rng(12))
    expected = tracer.all_hits(origins, directions, with_locations=True)
    assert len(expected) > 40000
    monkeypatch.setattr(crossings_module, "LEAST_HITS", 1000)
    monkeypatch.setattr(tracer._caster.threads, "count", 5)
    monkeypatch.setattr(crossings_module, "_MOST_RAYS", 777)
    turned = np.asfortranarray(origins), np.asfortranarray(directions)
    hits = tracer.all_hits(*turned, with_locations=True)
    assert_same(hits, expected)
    assert hits.locations.tobytes() == expected.locations.tobytes()


@pytest.mark.parametrize("count", [0, 1, 63, 64, 65, 1023, 1024, 1025])
def test_any_number_of_rays(tracer, rays, expected, count):
    hits = tracer.all_hits(rays[0][:count], rays[1][:count])
    assert len(hits.offsets) == count + 1
    assert len(hits) == expected.offsets[count]
    for field in ("t", "u", "v", "prim_id"):
        assert getattr(hits, field).tobytes() == getattr(expected, field)[: expected.offsets[count]].tobytes()


@pytest.mark.parametrize(("chunk", "most"), [(100, 2**21), (1000, 64), (4096, 7), (4096, 1), (1, 1)])
def test_chunks_are_not_seen(tracer, rays, expected, monkeypatch, chunk, most):
    count = 3072 if chunk > 1 else 200
    monkeypatch.setattr(pieces, "CHUNK_RAYS", chunk)
    monkeypatch.setattr(crossings_module, "MOST_SLOTS", most)
    told = []
    hits = tracer.all_hits(rays[0][:count], rays[1][:count], progress=lambda done, total: told.append((done, total)))
    np.testing.assert_array_equal(hits.offsets, expected.offsets[: count + 1])
    np.testing.assert_array_equal(hits.t, expected.t[: expected.offsets[count]])
    np.testing.assert_array_equal(hits.prim_id, expected.prim_id[: expected.offsets[count]])
    assert told[-1] == (count, count)
    assert len(told) == -(-count // min(chunk, max(1, most // crossings_module.FIRST_SLOTS)))
    if chunk > 1:
        np.testing.assert_array_equal(tracer.count_hits(*rays), expected.counts)


def test_limits_hold_for_every_crossing(tracer, rays, expected):
    hits = tracer.all_hits(*rays, t_min=0.4, t_max=0.9)
    np.testing.assert_array_equal(tracer.count_hits(*rays, t_min=0.4, t_max=0.9), hits.counts)
    # Those that are closer to a limit than float32 resolves may count or not.
    blur = 1e-4
    surely = (expected.t > 0.4 + blur) & (expected.t < 0.9 - blur)
    maybe = (expected.t > 0.4 - blur) & (expected.t < 0.9 + blur)
    assert surely.sum() <= len(hits) <= maybe.sum()
    assert surely.sum() > 500
    assert ((hits.t >= 0.4) & (hits.t <= 0.9)).all()


def test_each_ray_keeps_its_limits_when_it_is_cast_again(tracer, rays, monkeypatch):
    monkeypatch.setattr(crossings_module, "FIRST_SLOTS", 1)
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
    with Tracer(build(Mesh.from_arrays(vertices, faces)), device=session.info) as tracer:
        hits = tracer.all_hits([[0.25, 0.25, -1], [5, 5, -1], [0.25, 0.25, 1000]], [[0, 0, 1], [0, 0, 1], [0, 0, -2]])
    assert hits.counts.tolist() == [sheets, 0, sheets]
    assert hits.t[:sheets].tolist() == list(range(1, sheets + 1))
    assert hits.prim_id.tolist() == list(range(sheets))[::-1] + list(range(sheets))
    assert hits.ray_id.tolist() == [0] * sheets + [2] * sheets


def test_equal_distances_are_in_the_order_of_the_faces(session):
    mesh = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]] * 4)
    with Tracer(build(mesh), device=session.info) as tracer:
        hits = tracer.all_hits([[0.3, 0.2, 1]], [[0.01, 0.02, -0.7]])
        assert hits.prim_id.tolist() == [0, 1, 2, 3]
        assert tracer.all_hits([[0.3, 0.2, 1]], [[0.01, 0.02, -0.7]], max_hits=2).prim_id.tolist() == [0, 1]


@pytest.mark.parametrize("max_hits", [0, -1, 2**31])
def test_a_bad_limit_is_refused(tracer, max_hits):
    for query in (tracer.all_hits, tracer.count_hits):
        with pytest.raises(ValueError, match="max_hits must be None or a number from 1"):
            query([[0, 0, 0]], [[0, 0, 1]], max_hits=max_hits)


def test_bad_rays_are_named(tracer):
    origins = np.zeros((5, 3))
    origins[3] = np.nan
    for query in (tracer.all_hits, tracer.count_hits):
        with pytest.raises(ValueError, match=r"origins\[3\] is not finite"):
            query(origins, np.ones((5, 3)))


def test_locations_in_a_scene_are_on_the_instance_that_is_hit(session):
    scene = Scene()
    ball = scene.add(make_shape("icosphere", triangles=320))
    for x in (-3.0, 0.0, 3.0):
        scene.place(ball, Transform(scale=(1, 2, 1), translate=(x, 1, 0)))
    with Tracer(scene, device=session.info) as tracer:
        hits = tracer.all_hits([-9.0, 1.1, 0.2], [1.0, 0.0, 0.0], with_locations=True)
        later = tracer.all_hits([-9.0, 1.1, 0.2], [1.0, 0.0, 0.0])
    assert hits.instance_id.tolist() == [0, 0, 1, 1, 2, 2]
    np.testing.assert_array_equal(hits.locations, later.locations)
    assert (np.abs(hits.locations[:, 0] - np.repeat([-3, 0, 3], 2)) <= 1).all()
