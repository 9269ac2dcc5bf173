"""Primitives within a distance of points, and in boxes: against all primitives, by slower ways than the tracer's."""

import pickle

import numpy as np
import pytest

from clbvh import QueryError, Scene, ShardedTracer, Spheres, Tracer, make_shape, shard_mesh
from clbvh.trace.points import pack, search
from clbvh.trace.rays import pieces

from .scene_distances import EXACT, SceneDistances, points_around
from .scene_states import affine, random_linear


@pytest.fixture(scope="module")
def scene():
    """Meshes and spheres, sheared and mirrored, of sizes that differ."""
    generator, made = np.random.default_rng(80), Scene()
    balls = made.add(Spheres(generator.normal(size=(20, 3)), 10.0 ** generator.uniform(-1.5, -0.3, 20)))
    knot = made.add(make_shape("knot", triangles=200))
    for index, size in enumerate((1, 0.1)):
        linear = size * random_linear(generator)
        made.place(knot, affine(linear, (3 * index, 0, 0)), mask=1 << index)
        made.place(balls, affine(linear, (3 * index, 1, 0)), mask=1 << index)
    return made


@pytest.fixture(scope="module")
def known(scene):
    generator = np.random.default_rng(81)
    return SceneDistances(scene.snapshot(), points_around(scene.snapshot(), generator, 60))


def columns_of(known, near):
    return known.column_of(near.instance_id, near.prim_id)


@pytest.mark.on_both
def test_all_that_is_near_is_found_once(open_tracer, scene, known, monkeypatch):
    generator = np.random.default_rng(82)
    radii = 10.0 ** generator.uniform(-3, 0.5, len(known.points))
    radii[:5], radii[5] = 0, 1e9
    masks = generator.integers(0, 4, len(known.points)).astype(np.uint32)
    is_seen = np.repeat((masks[:, None] & known.state.masks) != 0, known.prim_counts, axis=1)
    tracer = open_tracer(scene)
    for most_slots in (search.MOST_SLOTS, 2000):
        monkeypatch.setattr(search, "MOST_SLOTS", most_slots)
        near = tracer.prims_within(known.points, radii, mask=masks)
        found = np.zeros(known.to_prims.shape, int)
        np.add.at(found, (near.point_id, columns_of(known, near)), 1)
        slack = EXACT * known.reach
        assert (found <= is_seen).all()
        assert (found[is_seen & (known.to_prims < radii[:, None] - slack)] == 1).all()
        assert not found[known.to_prims > radii[:, None] + slack].any()
        assert near.counts[5] == is_seen[5].sum()
        np.testing.assert_array_equal(near.counts, found.sum(axis=1))
        ways = np.linalg.norm(near.point - known.points[near.point_id], axis=1)
        np.testing.assert_allclose(ways, near.distance, atol=slack)
        assert (np.diff(near.distance)[np.diff(near.point_id) == 0] >= 0).all()


@pytest.mark.on_both
def test_nothing_is_found_beyond_a_distance(open_tracer, scene, known):
    limits = 10.0 ** np.random.default_rng(83).uniform(-3, 1, len(known.points))
    for source in (scene, scene.snapshot().shapes[1]):
        tracer = open_tracer(source)
        for limit in (limits, 0.3):
            for every, near in (
                (tracer.closest_point(known.points), tracer.closest_point(known.points, max_distance=limit)),
                (tracer.closest_points(known.points, 7), tracer.closest_points(known.points, 7, max_distance=limit)),
            ):
                is_kept = (limit >= every.distance.T).T
                assert 0.1 < is_kept.mean() < 0.9
                np.testing.assert_array_equal(near.distance, np.where(is_kept, every.distance, np.inf))
                for name in ("prim_id", "instance_id", "geometry_id"):
                    np.testing.assert_array_equal(getattr(near, name), np.where(is_kept, getattr(every, name), -1))
                np.testing.assert_array_equal(near.u, np.where(is_kept, every.u, 0))
                assert np.isnan(near.point[~is_kept]).all()


def clip(corners, lower, upper):
    """The corners of a triangle's part in a box (Sutherland and Hodgman, 1974)."""
    polygon = list(corners)
    for axis in range(3):
        for sign, bound in ((1, lower[axis]), (-1, -upper[axis])):
            kept = []
            for before, after in zip([*polygon[-1:], *polygon[:-1]], polygon, strict=True):
                a, b = sign * before[axis] - bound, sign * after[axis] - bound
                if (a < 0) != (b < 0):
                    kept.append(before + (after - before) * a / (a - b))
                if b >= 0:
                    kept.append(after)
            polygon = kept
    return polygon


def least_in_box(matrix, lower, upper):
    """The least length that a matrix gives to a point of a box, by one coordinate after the other."""
    square, point = matrix.T @ matrix, np.clip(np.zeros(3), lower, upper)
    for _ in range(500):
        for axis in range(3):
            rest = square[axis] @ point - square[axis, axis] * point[axis]
            point[axis] = np.clip(-rest / square[axis, axis], lower[axis], upper[axis])
    return np.linalg.norm(matrix @ point)


def meets(state, instance, prim, lower, upper):
    """How far a primitive is inside a box: above zero if it surely meets it, below if it surely does not."""
    shape, transform = state.shapes[state.geometry_ids[instance]], state.transforms[instance]
    linear, offset = transform[:3, :3], transform[:3, 3]
    if isinstance(shape, Spheres):
        centre = linear @ shape.centres[prim] + offset
        return 1 - least_in_box(np.linalg.inv(linear) / shape.radii[prim], lower - centre, upper - centre)
    corners = shape.vertices[shape.faces[prim]] @ linear.T + offset
    wide, narrow = (len(clip(corners, lower - room, upper + room)) > 0 for room in (1e-12, -1e-12))
    return 1 if narrow else 0 if wide else -1


@pytest.mark.on_both
def test_boxes_have_all_that_meets_them(open_tracer, scene):
    generator, state = np.random.default_rng(84), scene.snapshot()
    middles = points_around(state, generator, 4)
    sizes = 10.0 ** generator.uniform(-2, 0.3, middles.shape)
    sizes[:3] = 0
    lower, upper = middles - sizes, middles + sizes
    near, counts = open_tracer(scene).prims_in_boxes(lower, upper), []
    columns = np.cumsum([0, *(state.shapes[geometry].prim_count for geometry in state.geometry_ids)])
    found = np.zeros((len(middles), columns[-1]), bool)
    found[near.point_id, columns[near.instance_id] + near.prim_id] = True
    for box, (below, above) in enumerate(zip(lower, upper, strict=True)):
        for instance, geometry in enumerate(state.geometry_ids):
            for prim in range(0, state.shapes[geometry].prim_count, 7):
                depth = meets(state, instance, prim, below, above)
                counts.append(depth > 1e-9)
                assert abs(depth) < 1e-9 or (depth > 0) == found[box, columns[instance] + prim]
    assert 0.02 < np.mean(counts) < 0.98


def test_boxes_that_touch():
    """A face, an edge and a corner of a box count; the next number does not."""
    corners = np.array([[0.7, 0.1, 0.1], [0.7, 0.6, 0.2], [0.7, 0.2, 0.9]])
    with Tracer((corners, [[0, 1, 2]])) as tracer:
        lower, upper = np.array([0.1, 0, 0]), np.array([0.7, 1, 1])
        assert tracer.prims_in_boxes(lower, upper).counts.tolist() == [1]
        assert tracer.prims_in_boxes(lower, np.nextafter(upper, -1)).counts.tolist() == [0]
        assert tracer.prims_in_boxes(corners, corners).counts.tolist() == [1, 1, 1]
        assert tracer.prims_in_boxes(upper, [9, 9, 9]).counts.tolist() == [0]
        # At a corner of the triangle, and of the box, whatever the size of the box.
        for end in (0.70001, 0.9, 1e3, np.inf):
            assert tracer.prims_in_boxes(corners, np.maximum(corners, end)).counts.tolist() == [1, 1, 1]
        assert tracer.prims_in_boxes([0.7, 0.6, 0.2], [9, 9, 9]).counts.tolist() == [1]
        near = tracer.prims_in_boxes([-1e9] * 3, [1e9] * 3)
        assert (near.prim_id == 0).all()
        with pytest.raises(QueryError, match="box 1 has no upper corner above its lower one"):
            tracer.prims_in_boxes([[0, 0, 0], [0, 2, 0]], [1, 1, 1])
        with pytest.raises(QueryError, match=r"lower \(2, 3\) and upper \(3, 3\)"):
            tracer.prims_in_boxes(np.zeros((2, 3)), np.ones((3, 3)))
        with pytest.raises(QueryError, match=r"^distance must be a number from 0, not -1"):
            tracer.prims_within(lower, -1)


def test_boxes_are_the_same_in_pieces_and_without_an_end(open_tracer, source, monkeypatch):
    tracer, generator = open_tracer(source), np.random.default_rng(88)
    lower = generator.uniform(-2, 2, (3000, 3))
    upper = lower + generator.uniform(0, 0.5, lower.shape)
    whole = tracer.prims_in_boxes(lower, upper)
    alone = [tracer.prims_in_boxes(lower[box], upper[box]) for box in range(0, 3000, 100)]
    monkeypatch.setattr(pack, "LEAST_POINTS", 100)
    monkeypatch.setattr(pieces, "CHUNK_RAYS", 700)
    monkeypatch.setattr(search, "MOST_SLOTS", 3000)
    cut = tracer.prims_in_boxes(lower, upper)
    for name in ("offsets", "distance", "point", "prim_id", "instance_id"):
        np.testing.assert_array_equal(getattr(cut, name), getattr(whole, name))
    for box, one in zip(range(0, 3000, 100), alone, strict=True):
        np.testing.assert_array_equal(one.prim_id, whole.prim_id[whole.offsets[box] : whole.offsets[box + 1]])
    # What lies beyond the scene changes nothing.
    for far in (np.inf, 1e308):
        slab = tracer.prims_in_boxes([-far, 0.1, -far], [far, 0.2, far])
        expected = tracer.prims_in_boxes([-99, 0.1, -99], [99, 0.2, 99])
        assert sorted(slab.prim_id) == sorted(expected.prim_id)
        assert np.isfinite(slab.distance).all()
        assert len(slab.prim_id) > 0
    assert tracer.prims_in_boxes([np.inf] * 3, [np.inf] * 3).counts.tolist() == [0]
    with pytest.raises(QueryError, match="box 0 has no upper corner"):
        tracer.prims_in_boxes([np.nan] * 3, [1, 1, 1])


def test_lists_of_nothing_and_of_many_points(open_tracer, mesh):
    tracer = open_tracer(mesh)
    assert tracer.prims_within(np.empty((0, 3)), 1).offsets.tolist() == [0]
    assert tracer.prims_in_boxes(np.empty((0, 3)), [1, 1, 1]).counts.tolist() == []
    grid = np.random.default_rng(86).uniform(-1, 1, (40, 50, 3))
    told = []
    near = tracer.prims_within(grid, 0.2, progress=lambda done, total: told.append((done, total)))
    assert told[-1] == (2000, 2000)
    assert len(near.counts) == 2000
    alone = tracer.prims_within(grid[3, 7], 0.2)
    begin, end = near.offsets[157:159]
    np.testing.assert_array_equal(near.prim_id[begin:end], alone.prim_id)
    again = pickle.loads(pickle.dumps(near))
    np.testing.assert_array_equal(again.offsets, near.offsets)
    np.testing.assert_array_equal(again.normals, near.normals)
    assert (tracer.prims_within(np.broadcast_to(grid[3, 7], (5, 3)), 0.2).counts == alone.counts[0]).all()


@pytest.mark.on_both
def test_closest_points_know_where_they_are(open_tracer, scene, known):
    tracer = open_tracer(scene)
    for closest in (tracer.closest_point(known.points), tracer.closest_points(known.points, 3)):
        hits = closest.as_hits()
        np.testing.assert_allclose(hits.locations, closest.point, atol=EXACT * known.reach)
        is_mesh = closest.geometry_id == 1
        assert is_mesh.any()
        assert not is_mesh.all()
        shape = known.state.shapes[1]
        expected = np.linalg.norm(closest.normals[is_mesh], axis=1)
        np.testing.assert_allclose(expected, 1)
        values = closest.interpolate({1: shape.vertices})
        assert np.isnan(values[~is_mesh]).all()
        placed = np.einsum("nij,nj->ni", known.state.transforms[closest.instance_id[is_mesh], :3, :3], values[is_mesh])
        placed += known.state.transforms[closest.instance_id[is_mesh], :3, 3]
        np.testing.assert_allclose(placed, closest.point[is_mesh], atol=EXACT * known.reach)
    # Off the surface, the way to the closest point is along the normal there, unless it is on an edge.
    closest = tracer.closest_point(known.points)
    is_ball = (closest.geometry_id == 0) & (closest.distance > 1e-3)
    ways = (known.points - closest.point)[is_ball] / closest.distance[is_ball, None]
    assert is_ball.sum() > 20
    np.testing.assert_allclose(np.abs((ways * closest.normals[is_ball]).sum(axis=1)), 1, atol=1e-6)


def test_shards_find_nothing_beyond_a_distance(tmp_path, mesh, open_tracer):
    shard_mesh(mesh, tmp_path / "parts", triangles=300)
    points = np.random.default_rng(87).uniform(-1, 1, (500, 3))
    expected = open_tracer(mesh).closest_point(points, max_distance=0.2)
    with ShardedTracer(tmp_path / "parts") as tracer:
        closest = tracer.closest_point(points, max_distance=0.2)
    assert 0 < (closest.prim_id >= 0).sum() < 500
    for name in ("distance", "point", "prim_id", "u", "v", "normals"):
        np.testing.assert_array_equal(getattr(closest, name), getattr(expected, name))
