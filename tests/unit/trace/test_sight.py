"""What rays do not see: a primitive of each, one side of all; and rays that begin on a surface.

Expected hits are chosen from all hits of the same rays without limits.
"""

import numpy as np
import pytest

from clbvh import ConfigError, Hits, QueryError, Scene, ShardedTracer, Spheres, Tracer, make_shape, shard_mesh
from clbvh.trace.rays import pieces
from clbvh.tree_layouts import TREE_LAYOUTS

from ...soup import make_soup


@pytest.fixture(scope="module")
def tiny():
    """A scene that float64 decides: instances of sizes that float32 cannot hold together, one of them mirrored."""
    scene, knot = Scene(), make_shape("knot", triangles=400)
    shape, ball = scene.add(knot), scene.add(Spheres([[0, 0, 0]], 1))
    for size, x in ((1, 0), (-1e-7, 0.5), (1e-7, 3)):
        matrix = np.diag([size, abs(size), abs(size), 1.0])
        matrix[0, 3] = x
        scene.place(shape, matrix)
        scene.place(ball, matrix)
    return scene


def choose_first(every, is_kept, count):
    """The first kept hit of each ray, and -1 where none is: its index in `every`, and the number of kept ones."""
    counts = np.bincount(every.ray_id[is_kept], minlength=count)
    rows, first = np.flatnonzero(is_kept), np.full(count, -1)
    first[every.ray_id[rows[::-1]]] = rows[::-1]
    return first, counts


def is_same(hits, others):
    return (hits.prim_id == others.prim_id) & (hits.instance_id == others.instance_id)


def check_rays(tracer, rays, is_kept, **sight):
    """Compare all queries of rays that see less with what they see otherwise."""
    every, count = tracer.all_hits(*rays), len(rays[0])
    first, counts = choose_first(every, is_kept(every), count)
    hits, expected = tracer.closest_hit(*rays, **sight), every[first]
    # Entries of -1 are misses. Of all hits, a t is not smaller than the one before it, and float64 may see two that are
    # next to each other in the other order.
    np.testing.assert_allclose(hits.t, np.where(first < 0, np.inf, expected.t), rtol=1e-6)
    assert (is_same(hits, expected) | (first < 0)).mean() > 0.99
    assert (tracer.closest_prim(*rays, **sight) == hits.prim_id).all()
    assert (tracer.any_hit(*rays, **sight) == (first >= 0)).all()
    assert (tracer.count_hits(*rays, **sight) == counts).all()
    limited = tracer.all_hits(*rays, **sight)
    assert (limited.counts == counts).all()
    assert (limited.prim_id == every.prim_id[is_kept(every)]).all()
    assert 0 < (first >= 0).sum() < count
    return hits


@pytest.mark.on_both
@pytest.mark.parametrize("layout", TREE_LAYOUTS)
def test_one_side_is_seen(open_tracer, source, rays, layout):
    tracer = open_tracer(source, layout=layout)
    # A shared edge of a front and a back face is a hit of one of them: all hits have the same one.
    front = check_rays(tracer, rays, lambda every: every.is_front, side="front")
    back = check_rays(tracer, rays, lambda every: ~every.is_front, side="back")
    assert front.is_front[front.is_hit].all()
    assert not back.is_front.any()


@pytest.mark.on_both
@pytest.mark.parametrize("layout", ["bvh2", "bvh8"])
def test_a_primitive_is_not_seen(open_tracer, source, rays, layout):
    tracer = open_tracer(source, layout=layout)
    first = tracer.closest_hit(*rays)

    second = check_rays(tracer, rays, lambda every: ~is_same(every, first[every.ray_id]), exclude=first)
    assert not (is_same(second, first) & first.is_hit).any()
    # One for all rays, and none.
    one = first[int(np.flatnonzero(first.is_hit)[0])]
    check_rays(tracer, rays, lambda every: ~is_same(every, one), exclude=one)
    check_rays(tracer, rays, lambda every: every.t >= 0, exclude=first[~first.is_hit][0])


@pytest.mark.on_both
def test_float64_sees_the_same_sides(open_tracer, tiny):
    tracer, generator = open_tracer(tiny), np.random.default_rng(51)
    places = ((0, 1), (0.5, 1e-7), (3, 1e-7))
    targets = np.concatenate([(x, 0, 0) + 2 * size * generator.uniform(-1, 1, (300, 3)) for x, size in places])
    origins = targets + 3 * generator.normal(size=targets.shape)
    rays = origins, targets - origins
    assert tracer._caster.world.is_exact
    for side, is_front in (("front", True), ("back", False)):
        check_rays(tracer, rays, lambda every, is_front=is_front: every.is_front == is_front, side=side)
    assert len(np.unique(tracer.closest_hit(*rays, side="back").instance_id)) == 7
    first = tracer.closest_hit(*rays)
    check_rays(tracer, rays, lambda every: ~is_same(every, first[every.ray_id]), exclude=first)


def test_faces_by_number_and_both_together(tracer, mesh, rays):
    first = tracer.closest_hit(*rays)
    expected = tracer.closest_hit(*rays, exclude=first, side="back")
    assert (tracer.closest_prim(*rays, exclude=first.prim_id, side="back") == expected.prim_id).all()
    grid = [np.reshape(each, (48, 64, 3)) for each in rays]
    picture = tracer.closest_prim(*grid, exclude=first.prim_id.reshape(48, 64), side="back")
    assert (picture.reshape(-1) == expected.prim_id).all()


@pytest.mark.on_both
def test_many_rays_in_an_order_of_their_own(open_tracer, monkeypatch):
    """Chunks of rays that are sorted, each with its own primitive."""
    monkeypatch.setattr(pieces, "CHUNK_RAYS", 9000)
    monkeypatch.setattr(pieces, "LEAST_RAYS", 1000)
    soup, generator = make_soup(3000, 52, grid=60), np.random.default_rng(53)
    tracer = open_tracer(soup)
    origins, directions = soup.origin + 40 * generator.normal(size=(2, 20_000, 3))
    first = tracer.closest_prim(origins, directions)
    second = tracer.closest_prim(origins, directions, exclude=first)
    every = tracer.all_hits(origins, directions, max_hits=2)
    expected = np.full(len(origins), -1)
    has_two = every.counts == 2
    expected[has_two] = every.prim_id[every.offsets[:-1][has_two] + 1]
    assert has_two.sum() > 1000
    assert (second == expected).all()


def test_shards_see_as_little(tmp_path, mesh, rays, open_tracer):
    shard_mesh(mesh, tmp_path / "parts", triangles=300)
    whole = open_tracer(mesh)
    first = whole.closest_hit(*rays)
    with ShardedTracer(tmp_path / "parts") as tracer:
        for sight in ({"side": "front"}, {"side": "back", "exclude": first}, {"exclude": first.prim_id}):
            assert tracer.closest_hit(*rays, **sight).t.tobytes() == whole.closest_hit(*rays, **sight).t.tobytes()
            assert (tracer.count_hits(*rays, **sight) == whole.count_hits(*rays, **sight)).all()
            assert (tracer.all_hits(*rays, **sight).prim_id == whole.all_hits(*rays, **sight).prim_id).all()


def test_rays_leave_hits_and_closest_points(open_tracer, source, rays):
    tracer = open_tracer(source)
    hits = tracer.closest_hit(*rays)
    hits = hits[hits.is_hit]
    away = np.random.default_rng(54).normal(size=(len(hits), 3))
    expected = tracer.closest_hit(hits.offset_origins(towards=away), away)
    assert tracer.closest_hit(hits, away).t.tobytes() == expected.t.tobytes()
    assert (tracer.all_hits(hits, away).counts == tracer.count_hits(hits.offset_origins(towards=away), away)).all()
    closest = tracer.closest_point(rays[0])
    assert (tracer.any_hit(closest, away[0]) == tracer.any_hit(closest.offset_origins(towards=away[0]), away[0])).all()


def test_points_on_faces(open_tracer, source, rays):
    tracer = open_tracer(source)
    hits = tracer.closest_hit(*rays)
    hits = hits[hits.is_hit & (hits.instance_id < 3)]
    instance = None if isinstance(source, type(hits.mesh)) else hits.instance_id
    points = tracer.points_on(hits.prim_id, np.stack((hits.u, hits.v), axis=-1), instance=instance)
    assert isinstance(points, Hits)
    assert points.locations.tobytes() == hits.locations.tobytes()
    assert points.normals.tobytes() == hits.normals.tobytes()
    if instance is not None:
        with pytest.raises(QueryError, match="on which of the 4 instances"):
            tracer.points_on([0])
        centroids = tracer.points_on([[0], [1]], instance=[1, 0])
        assert centroids.instance_id.tolist() == [[1, 0], [1, 0]]


def test_what_is_refused(open_tracer, source, rays):
    tracer = open_tracer(source)
    with pytest.raises(ConfigError, match="side must be 'front', 'back' or None, not 'left'"):
        tracer.any_hit(*rays, side="left")
    wrong = [("exclude must", [0.5]), ("exclude must", [2**31]), ("exclude must", [-2])]
    if isinstance(source, Scene):
        wrong = [("exclude must be hits or closest points in a scene", [0])]
    else:
        wrong.append(("exclude must be a number or have a shape", [0, 1]))
    for message, exclude in wrong:
        with pytest.raises(QueryError, match=message):
            tracer.any_hit(*rays, exclude=exclude)
    with pytest.raises(QueryError, match=r"origins.* is not finite"):
        tracer.any_hit(tracer.closest_hit(*rays), [0, 0, 1])


def test_coincident_faces_are_told_apart():
    """A face that is there twice, once turned: each side sees its own, and without that nothing."""
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    with Tracer((corners, [[0, 1, 2], [0, 2, 1]])) as tracer:
        ray = [0.2, 0.2, 1], [0, 0, -1]
        assert tracer.closest_hit(*ray, side="front").prim_id == 0
        assert tracer.closest_hit(*ray, side="back").prim_id == 1
        assert not tracer.any_hit(*ray, side="back", exclude=1)
