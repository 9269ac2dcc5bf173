"""The nearest point of a surface, and which side of it a point is on; `tests/property` has all layouts."""

import copy
import pickle

import numpy as np
import pytest
import trimesh

from clbvh import Mesh, OpenMeshWarning, QueryError, Scene, SceneError, Spheres, Tracer
from clbvh.trace.points import pack
from clbvh.trace.rays import pieces
from clbvh.trace.world.tree_box import TreeBox

from ...rays import order_by_keys
from .scene_distances import SceneDistances, points_around
from .scene_states import affine, make_state, scene_of

QUERIES = ("closest_point", "contains", "signed_distance")
BOX = trimesh.creation.box()
OPEN = BOX.vertices, BOX.faces[1:]


def state_of(source):
    return (source if isinstance(source, Scene) else Scene(source)).snapshot()


def ask(tracer, points, **options):
    """All answers about points, as arrays."""
    closest = tracer.closest_point(points, **options)
    rest = [getattr(tracer, query)(points, **options) for query in QUERIES[1:]]
    return [*closest, closest.instance_id, closest.geometry_id, *rest]


def assert_same(answers, expected):
    for one, other in zip(answers, expected, strict=True):
        assert one.tobytes() == other.tobytes()


@pytest.fixture(scope="module")
def known(source):
    """Points around a mesh or a scene, and how they lie to it."""
    state = state_of(source)
    return SceneDistances(state, points_around(state, np.random.default_rng(90)))


def test_points_and_sides_are_right(open_tracer, source, known):
    tracer = open_tracer(source)
    closest = tracer.closest_point(known.points)
    known.check_point(closest)
    contains = tracer.contains(known.points)
    assert known.check_insides(contains, tracer.signed_distance(known.points)) > 0.5 * len(known.points)
    assert 0.05 < contains.mean() < 0.9
    for again in (copy.copy(closest), pickle.loads(pickle.dumps(closest))):
        assert (type(again), again.instance_id.tobytes()) == (type(closest), closest.instance_id.tobytes())


def test_only_what_is_seen_counts(open_tracer, world):
    state = world.snapshot()
    points = points_around(state, np.random.default_rng(91), 16)
    known, tracer, ids = SceneDistances(state, points), open_tracer(world), np.arange(len(state.masks))
    masks = np.random.default_rng(92).integers(0, 4, len(points)).astype(np.uint32)
    of_knot = state.geometry_ids == 0
    for options, seen in (
        ({"mask": masks}, (masks[:, None] & state.masks) != 0),
        ({"geometry": world.geometries[0], "mask": 1}, of_knot & ((state.masks & 1) != 0)),
        ({"instance": world.instances[1]}, ids == 1),
        ({"instance": [world.instances[3], 2]}, ids > 1),
        ({"instance": []}, ids < 0),
    ):
        known.check_point(tracer.closest_point(points, **options), seen)
        known.check_insides(tracer.contains(points, **options), tracer.signed_distance(points, **options), seen)


@pytest.mark.parametrize("far", [1e3, 1e7, 1e39, 1e300])
def test_what_is_nearest_to_a_far_point_reaches_furthest_towards_it(open_tracer, source, far):
    """As far as docs/points.md promises: to 2^-9 of half the size."""
    state = state_of(source)
    directions = np.random.default_rng(95).normal(size=(100, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    tracer = open_tracer(source)
    closest = tracer.closest_point(far * directions)
    assert not tracer.contains(far * directions).any()
    np.testing.assert_array_equal(tracer.signed_distance(far * directions), -closest.distance)
    furthest = np.full(len(directions), -np.inf)
    for geometry, transform in zip(state.geometry_ids, state.transforms, strict=True):
        shape, linear = state.shapes[geometry], transform[:3, :3]
        is_ball = isinstance(shape, Spheres)
        along = ((shape.centres if is_ball else shape.vertices) @ linear.T + transform[:3, 3]) @ directions.T
        along += shape.radii[:, None] * np.linalg.norm(directions @ linear, axis=1) if is_ball else 0
        furthest = np.maximum(furthest, along.max(axis=0))
    slack = 2.0**-9 * furthest.max()
    assert ((closest.point * directions).sum(axis=1) >= furthest - slack).all()
    np.testing.assert_allclose(closest.distance, far - furthest, rtol=0, atol=slack + far * 1e-15)


def test_signs_and_distances_of_a_cube_at_faces_edges_and_corners(session):
    points = np.stack(np.meshgrid(*[[-0.75, -0.25, 0.25, 0.5625]] * 3), axis=-1).reshape(-1, 3)
    beyond, within = np.maximum(np.abs(points) - 0.5, 0), (0.5 - np.abs(points)).min(axis=1)
    expected = np.where((beyond > 0).any(axis=1), -np.linalg.norm(beyond, axis=1), within)
    for faces in (BOX.faces, BOX.faces[:, ::-1]):
        with Tracer((BOX.vertices, faces), device=session.info) as tracer:
            np.testing.assert_allclose(tracer.signed_distance(points), expected, atol=1e-14)


def test_the_inside_of_a_hollow_is_outside(session):
    hollow = trimesh.util.concatenate([BOX, trimesh.creation.box(extents=[0.2] * 3)])
    with Tracer(hollow, device=session.info) as tracer:
        points, expected = [[0, 0, 0], [0.3, 0.2, 0.1], [2, 0, 0]], [False, True, False]
        assert tracer.contains(points).tolist() == expected


def test_chunks_and_shapes_change_no_answer(open_tracer, source, monkeypatch):
    tracer, points = open_tracer(source), np.random.default_rng(96).uniform(-1, 1, (480, 3)).astype(np.float32)
    masks = np.random.default_rng(97).integers(0, 4, len(points))
    whole, hidden = ask(tracer, points), ask(tracer, points, mask=masks)
    monkeypatch.setattr(pieces, "CHUNK_RAYS", 250)
    told = []
    tracer.contains(points, progress=lambda done, total: told.append((done, total)))
    assert told == [(250, 480), (480, 480)]
    assert_same(ask(tracer, points.reshape(16, 30, 3)), whole)
    assert_same(ask(tracer, points.reshape(16, 30, 3), mask=masks.reshape(16, 30)), hidden)
    rows = ask(tracer, points.reshape(16, 30, 3), mask=np.arange(16)[:, None])
    assert_same([array[7] for array in rows], ask(tracer, points[210:240], mask=7))


def test_what_is_refused(session, world):
    tracer = Tracer(world, device=session.info)
    refused = (
        ({"mask": 0.5}, QueryError, "mask must be integers"),
        ({"mask": [1, 2]}, QueryError, "shape that broadcasts to that of the points"),
        ({"geometry": Scene().add(BOX)}, SceneError, "belongs to another scene"),
        ({"instance": 99}, SceneError, "there is no instance 99"),
        ({}, QueryError, "the tracer is closed"),
    )
    for options, error, words in refused:
        if not options:
            tracer.close()
        for query in QUERIES:
            with pytest.raises(error, match=words):
                getattr(tracer, query)([[0, 0, 0]], **options)


@pytest.mark.parametrize("query", QUERIES[1:])
def test_an_open_mesh_is_told_once_and_answers_all_the_same(session, query):
    points = [[5.0, 0, 0]]
    shapes = Mesh.from_arrays(*OPEN), Spheres([[0, 0, 0]], 1)
    scene = scene_of(make_state(shapes, (0, affine((2, 2, 2))), (1, affine())))
    with Tracer(scene, device=session.info) as tracer:
        # Warnings are errors here: other queries, and those about closed shapes, tell nothing.
        tracer.closest_point(points)
        tracer.contains(points, geometry=scene.geometries[1])
        with pytest.warns(OpenMeshWarning, match=f"^mesh is not closed.*{query}") as caught:
            answer = getattr(tracer, query)(points)
        assert caught[0].filename == __file__
        assert answer[0] <= 0
        ask(tracer, points)


def order_of(points, half=(1.0, 1.0, 1.0)):
    return pack.find_point_order(points, TreeBox(np.zeros(3), 1.0, np.array(half)), order_by_keys)


def test_many_points_come_once_each_in_an_order_in_which_neighbours_are_close():
    generator = np.random.default_rng(1)
    points = generator.uniform(-1, 1, (40_000, 3)).astype(np.float32)
    order = order_of(points)
    steps = [np.linalg.norm(np.diff(some, axis=0), axis=1).mean() for some in (points[order], points)]
    # About 40,000 ** (1 / 3) = 34 points lie along each axis.
    assert steps[0] < steps[1] / 15

    points = generator.normal(size=(40_000, 3)) * 10.0 ** generator.uniform(-40, 40, (40_000, 1))
    points[::7], points[1::7, 1], points[2::7, 2] = 0.0, np.nan, np.inf
    for half in ((1, 1, 1), (1, 0, 1), (0, 0, 0), (1e-30, 1e30, 1)):
        np.testing.assert_array_equal(np.sort(order_of(points, half)), np.arange(len(points)))


def test_no_answer_depends_on_the_order_and_the_first_bad_point_is_named(tracer, monkeypatch):
    points = np.random.default_rng(4).uniform(-1, 1, (1000, 3))
    expected = []
    for least in (len(points) + 1, 1):
        monkeypatch.setattr(pack, "LEAST_POINTS", least)
        expected.append(ask(tracer, points))
    assert_same(*expected)
    points[[700, 800], 2] = np.nan
    with pytest.raises(QueryError, match=r"points\[700\] is not finite"):
        tracer.closest_point(points)
