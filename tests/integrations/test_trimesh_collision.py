"""Collisions and distances of trimesh's meshes: boxes by formula, surfaces against a tracer, and changes."""

import time
from itertools import combinations, product
from threading import Thread

import numpy as np
import pytest
import trimesh

from clbvh import MeshError, Scene, SceneError, Tracer
from clbvh.integrations.trimesh import CollisionManager, bodies

TO = trimesh.transformations.translation_matrix
BOX, BALL = trimesh.creation.box(), trimesh.creation.icosphere(2)
TORUS = trimesh.creation.torus(1.0, 0.3)


def draw_boxes(seed, count=24, far=5):
    """Return the lower and the upper corners of boxes on a grid, many of which touch, overlap or hold another."""
    random = np.random.default_rng(seed)
    lower = random.integers(-far, far + 1, (count, 3)).astype(float)
    return lower, lower + random.integers(1, 4, (count, 3))


def fill(boxes):
    """Return a manager of boxes, by their numbers."""
    manager = CollisionManager()
    for number, (lower, upper) in enumerate(zip(*boxes, strict=True)):
        transform = np.diag([*(upper - lower), 1.0])
        transform[:3, 3] = (lower + upper) / 2
        manager.add_object(number, BOX, transform)
    return manager


def measure(boxes, one, other):
    """Return the distance of two boxes; minus the depth where they overlap."""
    lower, upper = boxes
    overlaps = np.minimum(upper[one] - lower[other], upper[other] - lower[one])
    return -overlaps.min() if overlaps.min() >= 0 else np.linalg.norm(np.minimum(overlaps, 0.0))


@pytest.mark.parametrize("seed", range(3))
def test_boxes_collide_and_are_as_deep_as_their_sides_say(seed):
    boxes = draw_boxes(seed)
    manager = fill(boxes)
    distances = {pair: measure(boxes, *pair) for pair in combinations(range(24), 2)}
    expected = {pair for pair, distance in distances.items() if distance <= 0}
    is_collision, names, contacts = manager.in_collision_internal(return_names=True, return_data=True)
    assert is_collision == bool(expected) == manager.in_collision_internal()
    assert names == expected
    assert {tuple(sorted(contact.names)) for contact in contacts} == expected
    for contact in contacts:
        one, other = sorted(contact.names)
        assert contact.depth == pytest.approx(-distances[one, other], abs=1e-12)
        assert np.abs(contact.normal).max() == pytest.approx(1.0)
        for number in (one, other):  # the point is in both, or half the depth outside
            outside = np.maximum(boxes[0][number] - contact.point, contact.point - boxes[1][number])
            assert outside.max() <= contact.depth / 2 + 1e-12
    distance, pair = manager.min_distance_internal(return_names=True)
    assert distance == pytest.approx(min(distances.values()))
    assert distances[pair] == pytest.approx(distance)


@pytest.mark.parametrize("seed", range(3))
def test_boxes_apart_are_measured_as_their_corners_say(seed):
    lower, upper = draw_boxes(seed, far=40)
    chosen = []
    for number in range(len(lower)):
        if all(measure((lower, upper), number, other) > 0 for other in chosen):
            chosen.append(number)
    boxes = lower[chosen], upper[chosen]
    manager = fill(boxes)
    distances = {pair: measure(boxes, *pair) for pair in product(range(len(chosen)), repeat=2) if len({*pair}) == 2}
    distance, names, data = manager.min_distance_internal(return_names=True, return_data=True)
    assert distance == data.distance == pytest.approx(min(distances.values()))
    assert distances[names] == pytest.approx(distance)
    assert np.linalg.norm(data.point(names[0]) - data.point(names[1])) == pytest.approx(distance)
    assert all(data.index(name) in range(12) for name in names)
    assert manager.in_collision_internal(return_names=True, return_data=True) == (False, set(), [])
    for one in range(len(chosen)):
        expected = min(distances[one, other] for other in range(len(chosen)) if other != one)
        assert manager.min_distance_internal(one) == pytest.approx(expected)


def test_one_mesh_and_other_managers_are_tested_as_pairs_of_one():
    boxes = draw_boxes(7, count=30)
    own, other = fill((boxes[0][:18], boxes[1][:18])), fill((boxes[0][18:], boxes[1][18:]))
    distances = {(a, b): measure(boxes, a, 18 + b) for a in range(18) for b in range(12)}
    expected = {pair for pair, distance in distances.items() if distance <= 0}
    assert own.in_collision_other(other, return_names=True) == (True, expected)
    assert own.min_distance_other(other) == pytest.approx(min(distances.values()))
    for b in range(12):
        mesh = trimesh.creation.box(bounds=(boxes[0][18 + b], boxes[1][18 + b]))
        names = {a for a in range(18) if (a, b) in expected}
        assert own.in_collision_single(mesh, return_names=True) == (bool(names), names)
        distance, name = own.min_distance_single(mesh, return_name=True)
        assert distance == pytest.approx(min(distances[a, b] for a in range(18)))
        assert distances[name, b] == pytest.approx(distance)
        transform = TO([100, 0, 0])
        assert not own.in_collision_single(mesh, transform)


def test_surfaces_collide_as_a_tracer_says():
    random = np.random.default_rng(3)
    transforms = [trimesh.transformations.random_rotation_matrix(random.random(3)) for _ in range(40)]
    manager, scene = CollisionManager(), Scene()
    ring = scene.add(TORUS)
    for number, transform in enumerate(transforms):
        transform[:3, 3] = random.uniform(-3, 3, 3)
        manager.add_object(number, TORUS, transform)
        scene.place(ring, transform)
    with Tracer(scene) as tracer:
        expected = {tuple(pair) for pair in tracer.collisions().tolist()}
        _, names, contacts = manager.in_collision_internal(return_names=True, return_data=True)
        assert names == expected
        for contact in contacts:
            assert np.isnan([contact.depth, *contact.normal]).all()
            for name in contact.names:
                found = tracer.closest_point([contact.point], instance=name, max_distance=1e-9)
                assert found.distance[0] < 1e-12
                face = TORUS.triangles[contact.index(name)] @ transforms[name][:3, :3].T + transforms[name][:3, 3]
                on_face = trimesh.triangles.closest_point(face[None], [contact.point])
                np.testing.assert_allclose(on_face[0], contact.point, atol=1e-12)
    assert manager.min_distance_internal() == 0.0


def test_a_solid_collides_with_what_is_inside_of_it_and_a_surface_does_not():
    manager = CollisionManager()
    manager.add_object("box", BOX, np.diag([9, 9, 9, 1]))
    assert manager.in_collision_single(TORUS, return_names=True) == (True, {"box"})
    assert manager.min_distance_single(TORUS) == 0.0
    assert manager.min_distance_single(BALL) == pytest.approx(-5.5, abs=0.02)
    assert not manager.in_collision_single(TORUS, TO([20, 0, 0]))
    # A corner of the box around it, and not in it.
    manager.add_object("box", BALL, np.diag([9, 9, 9, 1]))
    assert not manager.in_collision_single(BOX, TO([6, 6, 6]))
    assert manager.in_collision_single(BOX, TO([4, 4, 4]))
    manager.add_object("box", TORUS, np.diag([9, 9, 9, 1]))
    assert not manager.in_collision_single(BALL, TO([9, 0, 0]) @ np.diag([0.5, 0.5, 0.5, 1]))
    # An open box, two boxes in one mesh and a box turned inside out are surfaces.
    open_box, inverted = BOX.copy(), BOX.copy()
    open_box.update_faces(np.arange(12) > 0)
    inverted.invert()
    for mesh in (open_box, BOX + BOX.copy().apply_translation([5, 0, 0]), inverted):
        manager.add_object("box", mesh)
        assert not manager.in_collision_single(BALL, np.diag([0.1, 0.1, 0.1, 1]))


def turn(number):
    """Return a rotation."""
    return trimesh.transformations.rotation_matrix(number, [1, 2, 3])


@pytest.mark.parametrize("number", range(1, 7))
def test_a_solid_is_around_turned_bodies_also_by_slivers(number):
    manager = CollisionManager()
    manager.add_object("box", BOX, turn(2 * number))
    small = np.diag([0.45, 0.45, 0.45, 1])
    assert manager.in_collision_single(BALL, turn(number) @ small)
    assert manager.min_distance_single(BALL, turn(number) @ small) == pytest.approx(-0.945, abs=0.005)
    # A corner halfway along an edge makes a face without area, or with one by rounding, of any normal.
    start, end = BOX.face_adjacency_edges[0]
    index = BOX.face_adjacency[0][0]
    face = np.roll(BOX.faces[index], -next(k for k in range(3) if BOX.faces[index][k] not in (start, end)))
    vertices = np.vstack([BOX.vertices, BOX.vertices[[start, end]].mean(axis=0)])
    halves = [[face[0], face[1], 8], [face[0], 8, face[2]], [face[1], face[2], 8]]
    jointed = trimesh.Trimesh(vertices, [*np.delete(BOX.faces, index, 0), *halves], process=False)
    jointed.apply_transform(turn(number))
    assert jointed.is_watertight
    manager.add_object("box", jointed)
    for place in product((-0.3, 0.3), repeat=3):
        assert manager.in_collision_single(BALL, turn(number) @ TO(place) @ np.diag([0.05, 0.05, 0.05, 1]))


def test_pieces_and_faces_without_area():
    manager = CollisionManager()
    manager.add_object("box", BOX)
    ball = BALL.copy().apply_scale(0.1)
    assert manager.in_collision_single(ball.copy().apply_translation([5, 0, 0]) + ball)
    assert manager.in_collision_single(ball + ball.copy().apply_translation([5, 0, 0]))
    soup = trimesh.Trimesh(ball.triangles.reshape(-1, 3), np.arange(960).reshape(-1, 3), process=False)
    assert len(bodies.CollisionGeometry(soup).pieces) == 1
    assert manager.in_collision_single(soup)
    far = trimesh.Trimesh(np.vstack([ball.vertices, [50, 0, 0]]), [*ball.faces, [162, 162, 162]], process=False)
    assert manager.in_collision_single(far)
    line = trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]], [[0, 1, 2]], process=False)
    assert not manager.in_collision_single(line)
    assert not manager.in_collision_single(trimesh.Trimesh(BOX.vertices * [0.3, 0, 0], BOX.faces, process=False))
    manager.add_object("line", line, TO([3, 0, 0]))
    manager.add_object("ball", ball, TO([6, 0, 0]))
    assert manager.min_distance_internal(return_names=True) == (pytest.approx(5.4, abs=0.01), ("ball", "box"))


def test_pieces_are_found_in_a_few_rounds():
    count = 25_000
    numbers = np.random.default_rng(1).permutation(2 * count)
    strip = np.column_stack([range(2 * count - 2), range(1, 2 * count - 1), range(2, 2 * count)])
    vertices = np.column_stack([np.arange(2 * count) // 2, np.arange(2 * count) % 2, np.zeros(2 * count)])
    mesh = trimesh.Trimesh(vertices[np.argsort(numbers)], numbers[strip], process=False)
    begin = time.process_time()
    assert len(bodies.CollisionGeometry(mesh).pieces) == 1
    assert time.process_time() - begin < 5  # 37 s where labels go one face in a round


def test_changes_are_seen():
    manager = CollisionManager()
    assert manager.in_collision_internal(return_names=True, return_data=True) == (False, set(), [])
    assert manager.min_distance_internal(return_names=True, return_data=True) == (np.inf, None, None)
    assert manager.min_distance_single(BOX) == np.inf
    manager.add_object("a", BOX)
    assert manager.min_distance_internal("a", return_names=True) == (np.inf, None)
    mesh = TORUS.copy()
    manager.add_object("b", mesh, TO([4, 0, 0]))
    mesh.apply_scale(100)  # it was read before
    assert manager.min_distance_internal() == pytest.approx(2.2)
    assert manager.in_collision_single(mesh, TO([130, 0, 0]))
    mesh.apply_scale(0.01)
    assert not manager.in_collision_single(mesh, TO([2.5, 4, 0]))
    manager.set_transform("b", TO([1, 0, 0]))
    assert manager.in_collision_internal(return_names=True) == (True, {("a", "b")})
    manager.add_object("a", BOX, TO([9, 0, 0]))
    assert manager.min_distance_internal() == pytest.approx(9 - 0.5 - 2.3)
    manager.remove_object("b")
    assert manager.min_distance_internal() == np.inf
    for change in (
        manager.remove_object,
        manager.min_distance_internal,
        lambda name: manager.set_transform(name, np.eye(4)),
    ):
        with pytest.raises(ValueError, match="b not in collision manager"):
            change("b")
    with pytest.raises(SceneError):
        manager.set_transform("a", np.zeros((4, 4)))
    with pytest.raises(MeshError):
        manager.add_object("c", trimesh.Trimesh())
    assert manager.min_distance_single((BOX.vertices, BOX.faces), TO([11, 0, 0])) == pytest.approx(1.0)


def test_a_query_goes_on_while_another_thread_adds_meshes():
    manager = fill(draw_boxes(2))
    group = manager._gather()
    manager.add_object("new", BALL)
    assert manager.in_collision_internal()
    assert len(group.find_collisions()) == len(fill(draw_boxes(2)).in_collision_internal(return_names=True)[1])


def test_threads_ask_one_manager_about_other_meshes():
    boxes = draw_boxes(11)
    manager, wrong = fill(boxes), []

    def ask(number):
        for step in range(20):
            mesh = trimesh.creation.icosphere(1, radius=0.5 + 0.01 * (number + 2 * step))
            place = TO(boxes[1][step] + 1.0)
            alone = fill(boxes).min_distance_single(mesh, place)
            if manager.min_distance_single(mesh, place) != alone:
                wrong.append(step)

    threads = [Thread(target=ask, args=(number,)) for number in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []
