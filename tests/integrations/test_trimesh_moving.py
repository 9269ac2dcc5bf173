"""A mesh of trimesh whose vertices move between queries: what is kept, and that answers are those of a new engine."""

import threading

import numpy as np
import pytest
import trimesh

from clbvh.device import program
from clbvh.errors import DeviceError, MeshError
from clbvh.integrations.trimesh import ProximityQuery, RayMeshIntersector, tracers
from clbvh.trace.tracer import Tracer

FRAMES = 8
RAYS = np.random.default_rng(101).uniform(-1, 1, (2, 400, 3))
POINTS = RAYS[0]


@pytest.fixture
def torus(session):
    mesh = trimesh.creation.torus(1.0, 0.3)
    mesh.ray = RayMeshIntersector(mesh, device=session.info.number)
    mesh.nearest = ProximityQuery(mesh)
    yield mesh
    mesh.ray.close()


@pytest.fixture
def work(monkeypatch):
    """What was built, opened and compiled."""
    done = []

    def note(module, name):
        function = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *a, **k: done.append(name) or function(*a, **k))

    note(tracers, "build")
    note(tracers, "Tracer")
    note(program, "_compile")
    return done


def wobble(mesh, frame):
    """Move all vertices by about a tenth of the mesh's size."""
    vertices = np.array(mesh.vertices)
    mesh.vertices = vertices + 0.1 * np.sin(3 * vertices[:, ::-1] + frame)


def scatter(mesh):
    mesh.vertices = np.random.default_rng(102).permutation(np.array(mesh.vertices))


def ask(mesh):
    """Answers of every kind of query."""
    return (
        mesh.ray.intersects_first(*RAYS),
        *mesh.ray.intersects_location(*RAYS),
        mesh.ray.contains_points(POINTS),
        *mesh.nearest.on_surface(POINTS),
        *mesh.nearest.vertex(POINTS),
    )


def ask_new(mesh):
    """The same of a new mesh with new engines."""
    other = trimesh.Trimesh(np.array(mesh.vertices), np.array(mesh.faces), process=False)
    other.ray, other.nearest = RayMeshIntersector(other), ProximityQuery(other)
    return ask(other)


def check_same(obtained, expected):
    for array, other in zip(obtained, expected, strict=True):
        np.testing.assert_array_equal(array, other)


def test_nothing_is_opened_or_compiled_again(torus, work):
    ask(torus)
    assert work.count("Tracer") == work.count("build") == 1
    work.clear()
    for frame in range(FRAMES):
        wobble(torus, frame)
        ask(torus)
    assert work == []


def test_answers_are_those_of_a_new_engine(torus):
    ask(torus)
    for frame in range(FRAMES):
        wobble(torus, frame)
        check_same(ask(torus), ask_new(torus))
        if frame == FRAMES // 2:
            torus.ray.close()


@pytest.mark.parametrize("query", ["vertex", "on_surface"])
def test_the_proximity_query_alone(torus, query):
    for frame in range(3):
        wobble(torus, frame)
        expected = getattr(ProximityQuery(torus.copy()), query)(POINTS)
        check_same(getattr(torus.nearest, query)(POINTS), expected)


def test_a_mesh_that_goes_back(torus):
    """The content that was known last does not stand for the one that the tracer has."""
    before, vertices = ask(torus), np.array(torus.vertices)
    for frame in range(3):
        wobble(torus, frame)
        torus.ray.intersects_first(*RAYS)
        torus.vertices = vertices
        check_same(ask(torus), before)


@pytest.mark.parametrize("is_open", [True, False])
def test_a_worn_tree_is_built_again(torus, work, is_open):
    ask(torus)
    scatter(torus)
    if not is_open:
        assert torus.ray._tracer.give_way()
    work.clear()
    check_same(ask(torus), ask_new(torus))
    assert work[:2] == ["build", "Tracer"]
    work.clear()
    torus.apply_translation([0.1, 0, 0])
    ask(torus)
    assert work == []


def test_wear_counts_from_the_build(torus, work):
    """A tracer that is opened over a refitted tree begins with its growth, not with 1."""
    torus.ray.intersects_first(*RAYS)
    vertices = np.array(torus.vertices)
    for angle in np.arange(1.0, 12.0):
        torus.ray._tracer.give_way()
        torus.vertices = twist(vertices, angle)
        torus.ray.intersects_first(*RAYS)
        torus.vertices = twist(vertices, angle + 0.5)
        torus.ray.intersects_first(*RAYS)
    assert work.count("build") > 1


def twist(vertices, angle):
    """Turn vertices about the x-axis, the farther along it the more."""
    x, y, z = vertices.T
    cos, sin = np.cos(angle * x), np.sin(angle * x)
    return np.stack((x, cos * y - sin * z, sin * y + cos * z), axis=1)


def test_a_tracer_that_was_closed(torus):
    ask(torus)
    wobble(torus, 0)
    torus.ray._tracer.open_tracer.close()
    check_same(ask(torus), ask_new(torus))


def test_a_device_without_room_for_a_second_copy(torus, work, monkeypatch):
    ask(torus)

    def refuse(self, vertices):
        raise DeviceError("no room")

    monkeypatch.setattr(Tracer, "update", refuse)
    wobble(torus, 0)
    work.clear()
    answers = ask(torus)
    assert work == ["Tracer"]
    check_same(answers, ask_new(torus))


def test_vertices_that_no_tree_can_have(torus):
    before, vertices = ask(torus), np.array(torus.vertices)
    torus.vertices = np.where(np.arange(len(vertices))[:, None] == 7, np.nan, vertices)
    for _ in range(2):
        with pytest.raises(MeshError, match="vertex 7"):
            torus.ray.intersects_first(*RAYS)
    torus.vertices = vertices
    check_same(ask(torus), before)


@pytest.mark.parametrize("is_done", [True, False])
def test_ctrl_c_in_an_update(torus, monkeypatch, is_done):
    before, vertices = ask(torus), np.array(torus.vertices)
    update = Tracer.update

    def interrupt(self, moved):
        if is_done:
            update(self, moved)
        raise KeyboardInterrupt

    monkeypatch.setattr(Tracer, "update", interrupt)
    wobble(torus, 0)
    with pytest.raises(KeyboardInterrupt):
        torus.ray.intersects_first(*RAYS)
    monkeypatch.undo()
    torus.vertices = vertices
    check_same(ask(torus), before)


def test_threads_that_ask_about_a_mesh_that_has_moved(torus):
    ask(torus)
    for frame in range(3):
        wobble(torus, frame)
        expected, answers = ask_new(torus), []
        threads = [threading.Thread(target=lambda: answers.append(ask(torus))) for _ in range(4)]  # noqa: B023 joined
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(answers) == 4
        for obtained in answers:
            check_same(obtained, expected)


def test_a_second_copy_counts_as_memory(torus, monkeypatch):
    """The memory bound is checked at the first update, which takes memory, and at no later one."""
    looked, make_room = [], tracers.make_room
    monkeypatch.setattr(tracers, "make_room", lambda *newest: looked.append(newest) or make_room(*newest))
    counts = []
    for frame in range(4):
        torus.ray.intersects_first(*RAYS)
        counts.append(len(looked))
        wobble(torus, frame)
    assert counts == [1, 2, 2, 2]
