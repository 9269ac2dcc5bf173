"""Distance and collision of instances: exact for any triangles, the nearest pair of any two meshes, and the API."""

import os
import signal
import time
from contextlib import nullcontext
from itertools import combinations
from threading import Thread, Timer

import numpy as np
import pytest
import trimesh

from clbvh import ConfigError, QueryError, Scene, SceneError, Spheres, Tracer, Transform, make_shape
from clbvh.support import memory
from clbvh.trace.clearance.triangles import measure_exactly

FACE = [[0, 1, 2]]
BOX = trimesh.creation.box()


def place_triangles(triangles):
    """Return a scene of triangles, each an instance of its own."""
    scene = Scene()
    for corners in triangles:
        scene.place(scene.add((corners, FACE)))
    return scene


def find_touching(triangles, pairs):
    """Return which pairs of triangles with small whole coordinates touch, by all axes that can separate two of them."""
    one, other = (triangles[pairs[:, which]] for which in range(2))
    edges = np.concatenate([np.roll(each, -1, axis=1) - each for each in (one, other)], axis=1)
    ways = (one[:, :, None] - other[:, None]).reshape(len(pairs), 9, 3)
    normals = np.cross(edges[:, :, None], np.concatenate([edges, ways], axis=1)[:, None])
    across = np.cross(normals, edges[:, :, None])
    axes = np.concatenate([edges, ways, *(each.reshape(len(pairs), -1, 3) for each in (normals, across))], axis=1)
    mine, others = (np.einsum("pak,pck->pac", axes, each) for each in (one, other))
    is_apart = (mine.max(axis=2) < others.min(axis=2)) | (others.max(axis=2) < mine.min(axis=2))
    return ~is_apart.any(axis=1)


def have_areas(triangles, pairs):
    """Return of which pairs both are triangles: degenerate ones count for nothing."""
    a, b, c = triangles.astype(float).swapaxes(0, 1)
    return np.cross(b - a, c - a).any(axis=1)[pairs].all(axis=1)


def draw_triangles(seed, count):
    """Return triangles on a grid: a third of them in one plane, some segments, some points."""
    random = np.random.default_rng(seed)
    triangles = random.integers(-3, 4, (count, 3, 3))
    triangles[::3, :, 2] = 1
    triangles[1::7, 2] = triangles[1::7, 1]
    triangles[2::11] = triangles[2::11, :1]
    return triangles


@pytest.mark.parametrize("seed", range(2))
def test_triangles_collide_if_and_only_if_they_touch(session, seed):
    triangles = draw_triangles(seed, 60)
    pairs = np.array(list(combinations(range(len(triangles)), 2)))
    is_touching = find_touching(triangles, pairs) & have_areas(triangles, pairs)
    assert 300 < is_touching.sum() < len(pairs) - 300
    with Tracer(place_triangles(triangles)) as tracer:
        assert tracer.collisions().tolist() == pairs[is_touching].tolist()
        for pair, touches in list(zip(pairs.tolist(), is_touching, strict=True))[:: len(pairs) // 150]:
            assert tracer.is_colliding(*pair) == touches
            assert (tracer.closest_pair(*pair).distance == 0) == touches


def test_turned_triangles_touch_as_integers_say(session):
    """Those that touch on the grid may do so or not where their corners are rounded."""
    turn = Transform(rotate=(20, 40, 70)).matrix[:3, :3]
    triangles, pairs = draw_triangles(4, 60) @ turn.T, np.array(list(combinations(range(60), 2)))
    is_touching = [measure_exactly(np.concatenate([triangles[a], triangles[b]]))[0] == 0 for a, b in pairs]
    is_touching &= have_areas(draw_triangles(4, 60), pairs)
    assert np.sum(find_touching(draw_triangles(4, 60), pairs) & ~is_touching) > 50
    with Tracer(place_triangles(triangles)) as tracer:
        assert tracer.collisions().tolist() == pairs[is_touching].tolist()


def test_no_nearer_points_of_two_triangles_are_there(session):
    """Planes through the two points, across the way between, have the triangles on their outer sides."""
    triangles = draw_triangles(5, 80)
    with Tracer(place_triangles(triangles)) as tracer:
        for one, other in zip(range(40), range(40, 80), strict=True):
            found = tracer.closest_pair(one, other)
            if not have_areas(triangles, np.array([[one, other]])).all():
                assert found.distance == np.inf
                continue
            way = found.points[1] - found.points[0]
            assert found.distance == pytest.approx(np.linalg.norm(way), rel=1e-14, abs=1e-14)
            for which, corners in enumerate((triangles[one], triangles[other])):
                heights = (corners - found.points[which]) @ way * (1 - 2 * which)
                assert heights.max() <= 1e-13
                weights = np.linalg.lstsq(np.vstack([corners.T, [1, 1, 1]]), [*found.points[which], 1], rcond=None)[0]
                assert (np.vstack([corners.T, [1, 1, 1]]) @ weights)[:3] == pytest.approx(
                    found.points[which], abs=1e-12
                )


@pytest.mark.parametrize("exponent", [-900, -200, -50, 0, 50, 200])
def test_distances_are_exact_at_any_size(session, exponent):
    unit = 2.0**exponent
    plate = np.array([[0, 0, 0], [8, 0, 0], [0, 8, 0]]) * min(unit, 2.0**400)
    scene, gap = Scene(), unit * 2.0**-40
    if exponent < -400:  # too small for a mesh: only the gap is
        plate, gap = plate / unit, unit
    below, above = scene.place(scene.add((plate, FACE))), scene.place(scene.add((plate, FACE)))
    with Tracer(scene) as tracer:
        tracer.set_transforms(above, Transform(translate=(0, 0, gap)).matrix)
        assert tracer.closest_pair(below, above).distance == gap
        assert not tracer.is_colliding(below, above)
        tracer.set_transforms(above, np.eye(4))
        assert tracer.is_colliding(below, above)


def list_corners(instance, matrix):
    """Return the corners of a placed mesh's faces, rounded as the tracer rounds them."""
    x, y, z = instance.geometry.shape.vertices.T
    placed = [(row[0] * x + row[1] * y + row[2] * z) + row[3] for row in matrix[:3]]
    return np.stack(placed, axis=1)[instance.geometry.shape.faces]


SHAPES = [
    BOX,
    trimesh.creation.icosphere(1),
    trimesh.creation.cone(1, 2, sections=8),
    trimesh.creation.torus(1, 0.3, major_sections=8, minor_sections=6),
]


def draw_pose(random, kind):
    turn = trimesh.transformations.random_rotation_matrix(random.random(3))
    if kind == "stretched":
        turn[:3, :3] = turn[:3, :3] @ np.diag([1, -0.1, 3])
    if kind == "sheared":
        turn[:3, :3] = turn[:3, :3] @ [[1, 2, 0], [0, 1, 0], [0.3, 0, 1]]
    turn[:3, 3] = random.normal(size=3) * random.choice([0.3, 1.5, 4, 100])
    if kind == "on a grid":
        turn = Transform(translate=np.round(turn[:3, 3])).matrix
    if kind == "far":
        turn[:3, 3] += 1e9
    if kind == "small":
        turn[:3] *= 1e-9
    return turn


@pytest.mark.parametrize("kind", ["rigid", "stretched", "sheared", "on a grid", "far", "small"])
def test_the_nearest_triangles_are_found(session, kind):
    random, scene = np.random.default_rng(11), Scene()
    placed = [scene.place(scene.add(shape)) for shape in SHAPES]
    touching = 0
    with Tracer(scene) as tracer:
        for _ in range(4):
            poses = [draw_pose(random, kind) for _ in placed]
            tracer.set_transforms(placed, poses)
            for a, b in combinations(range(len(placed)), 2):
                one, other = (list_corners(placed[each], poses[each]) for each in (a, b))
                found, size = tracer.closest_pair(a, b), np.ptp(np.concatenate([one, other]), axis=(0, 1)).max()
                assert found.distance == pytest.approx(measure_all(one, other), abs=1e-14 * size, rel=0)
                assert tracer.is_colliding(a, b) == (found.distance == 0)
                corners = np.concatenate([one[found.prim_ids[0]], other[found.prim_ids[1]]])
                assert measure_exactly(corners)[0] == found.distance
                again = tracer.closest_pair(b, a)
                assert again.points[::-1].tolist() == found.points.tolist()
                assert again.prim_ids[::-1].tolist() == found.prim_ids.tolist()
                assert found.instance_ids.tolist() == [a, b]
                touching += found.distance == 0
    assert 0 < touching < 24


def measure_all(one, other):
    """Return the least distance of triangles, by all pairs that could have it."""
    ways = np.maximum(one.min(axis=1)[:, None] - other.max(axis=1), other.min(axis=1) - one.max(axis=1)[:, None])
    gaps, least = np.linalg.norm(np.maximum(ways, 0), axis=2), np.inf
    for a, b in zip(*np.unravel_index(np.argsort(gaps, axis=None), gaps.shape), strict=True):
        if gaps[a, b] * (1 - 1e-12) > least or least == 0:
            break
        least = min(least, measure_exactly(np.concatenate([one[a], other[b]]))[0])
    return least


def test_what_float64_cannot_decide_is_decided_and_the_search_goes_on(session):
    """Two plates in one tilted plane, a ten-millionth of a triangle apart: no determinant has a sign."""
    x, y = (each.ravel() for each in np.meshgrid(np.arange(5.0), np.arange(5.0)))
    corner = (np.arange(4)[:, None] * 5 + np.arange(4)).ravel()
    faces = np.concatenate(
        [np.stack((corner, corner + 1, corner + 6), 1), np.stack((corner, corner + 6, corner + 5), 1)]
    )
    turn = trimesh.transformations.rotation_matrix(1.0, [1, 2, 3])
    left = np.column_stack((x, y, 0 * x)) @ turn[:3, :3].T
    right = np.column_stack((x + 4 + 1e-7, y + 0.3, 0 * x)) @ turn[:3, :3].T
    scene = Scene()
    plates = [scene.place(scene.add((vertices, faces))) for vertices in (left, right)]
    with Tracer(scene) as tracer:
        found = tracer.closest_pair(*plates)
        assert found.distance == measure_all(left[faces], right[faces]) == pytest.approx(1e-7, rel=1e-6)
        assert not tracer.is_colliding(*plates)


def test_a_part_inside_another_one_is_some_way_from_its_wall(session):
    scene = Scene()
    scene.place(scene.add(BOX), Transform(scale=4))
    scene.place(scene.add(BOX), Transform(translate=(1, 0, 0)))
    with Tracer(scene) as tracer:
        assert tracer.closest_pair(0, 1).distance == 0.5
        assert not tracer.is_colliding(0, 1)


@pytest.fixture
def row(session):
    """A tracer of boxes at 0, 1, 4, 4.5 and 9, and the scene."""
    scene = Scene()
    crate = scene.add(BOX, name="crate")
    for x in (0, 1, 4, 4.5, 9):
        scene.place(crate, Transform(translate=(x, 0, 0)))
    with Tracer(scene) as tracer:
        yield tracer, scene


def test_several_instances_and_all_others(row):
    tracer, scene = row
    assert tracer.collisions().tolist() == [[0, 1], [2, 3]]
    assert tracer.collisions([1, 2, 4]).tolist() == []
    assert [tracer.is_colliding(0), tracer.is_colliding(4), tracer.is_colliding([0, 1], [2, 3, 4])] == [
        True,
        False,
        False,
    ]
    assert tracer.closest_pair(scene.instances[4]).instance_ids.tolist() == [4, 3]
    found = tracer.closest_pair([2, 3, 4], (0, 1))
    assert (found.distance, found.instance_ids.tolist(), found.points[:, 0].tolist()) == (2.0, [2, 1], [3.5, 1.5])
    # Of pairs that are equally near, the smaller ids.
    assert tracer.closest_pair(range(5), range(5)).instance_ids.tolist() == [0, 1]


def test_what_is_beyond_the_limit_is_nothing(row):
    tracer, _ = row
    assert tracer.closest_pair(1, 2, max_distance=2).distance == 2
    assert tracer.closest_pair(0, 1, max_distance=0).distance == 0
    nothing = tracer.closest_pair(1, 2, max_distance=np.nextafter(2, 0))
    assert nothing.distance == np.inf
    assert np.isnan(nothing.points).all()
    assert nothing.prim_ids.tolist() == nothing.instance_ids.tolist() == [-1, -1]


def test_more_pairs_than_fit_are_refused_before_the_work(row, monkeypatch):
    tracer, _ = row
    monkeypatch.setattr(memory, "_LEAST_CHECKED", 0)
    monkeypatch.setattr(memory, "free_memory_bytes", lambda: 0)
    for ask, count in ((tracer.collisions, 2), (lambda: tracer.closest_pair([0, 1], [2, 3, 4]), 6)):
        with pytest.raises(QueryError, match=f"results of {count} pairs need about .* are free: ask for fewer pairs"):
            ask()


def test_ctrl_c_ends_a_long_search_early(session):
    scene, times = Scene(), []
    crate = scene.add(BOX)
    for _ in range(600):  # in one place, where each pair is decided by integers: 36 times the work of 100
        scene.place(crate)
    with Tracer(scene) as tracer:
        tracer.collisions(range(9))
        for count in (100, 600):
            begin = time.process_time()
            with pytest.raises(KeyboardInterrupt) if count == 600 else nullcontext():
                if count == 600:
                    Timer(times[0], os.kill, (os.getpid(), signal.SIGINT)).start()
                assert len(tracer.collisions(range(count))) == 4950
            times.append(time.process_time() - begin)
        assert times[1] < 12 * times[0]
        assert len(tracer.collisions(range(3))) == 3


def test_removed_parts_are_measured_only_where_they_are_named(row):
    tracer, _ = row
    pairs, other = tracer.collisions().tolist(), tracer.closest_pair(4)
    tracer.set_masks(1, 0)
    assert tracer.collisions().tolist() == [pair for pair in pairs if 1 not in pair]
    assert tracer.is_colliding(0, 1)
    assert not tracer.is_colliding(0)
    assert tracer.collisions([0, 1]).tolist() == [[0, 1]]
    tracer.set_masks(range(4), 0)
    assert tracer.closest_pair(4).distance == np.inf
    assert (tracer.is_colliding(4), tracer.collisions().tolist()) == (False, [])
    assert tracer.closest_pair(4, range(4)).distance == other.distance


def test_moved_parts_are_measured_where_they_are(row):
    tracer, scene = row
    tracer.set_transforms(4, Transform(translate=(7, 0, 0)).matrix)
    assert tracer.closest_pair(4).distance == 1.5
    tracer.set_vertices(scene.geometries[0], BOX.vertices * [3, 1, 1])
    assert tracer.collisions().tolist() == [[0, 1], [1, 2], [2, 3], [2, 4], [3, 4]]
    tracer.set_vertices(scene.geometries[0], BOX.vertices * [0.5, 1, 1])
    assert tracer.closest_pair(4).distance == 2


def test_threads_get_the_same_answers(session):
    random, scene = np.random.default_rng(3), Scene()
    knot = scene.add(make_shape("knot", triangles=2000))
    size = np.ptp(knot.shape.vertices, axis=0).max()
    for _ in range(40):
        scene.place(knot, Transform(translate=random.random(3) * 4 * size, rotate=random.random(3) * 360))
    answers = []
    with Tracer(scene) as tracer:
        pairs = [pair for pair in combinations(range(40), 2) if tracer.is_colliding(*pair)]
        threads = [Thread(target=lambda: answers.append(tracer.collisions().tolist())) for _ in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(pairs) > 10
    assert answers == [[list(pair) for pair in pairs]] * 3


def test_wrong_arguments_are_refused(session):
    scene = Scene()
    scene.place(scene.add(BOX))
    scene.place(scene.add(Spheres([[0, 0, 0]], 1)), name="ball")
    with Tracer(scene) as tracer:
        with pytest.raises(QueryError, match="two different instances"):
            tracer.closest_pair(0, 0)
        for ask, first in ((tracer.is_colliding, 0), (tracer.closest_pair, 0), (tracer.collisions, None)):
            with pytest.raises(QueryError, match="'ball' is of spheres"):
                ask(first)
        with pytest.raises(SceneError, match="no instance 7"):
            tracer.is_colliding(0, 7)
        for wrong in (-1, np.nan, None, "near", [1, 2]):
            with pytest.raises(ConfigError, match="max_distance"):
                tracer.closest_pair(0, 1, max_distance=wrong)
    with pytest.raises(QueryError, match="closed"):
        tracer.closest_pair(0, 1)
    with Tracer(BOX) as tracer, pytest.raises(QueryError, match="two different instances"):
        tracer.closest_pair(0)
