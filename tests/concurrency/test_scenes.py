"""Threads that query a scene while others move it: every answer is that of one state of the scene, in full."""

from __future__ import annotations

import itertools
import threading
import time

import numpy as np
import pytest

import clbvh
from clbvh.errors import MeshError, QueryError, SceneError
from clbvh.trace.rays import pieces

from ..profiles import is_long
from .moving_scenes import STATES, MovingScene
from .queries import ask
from .threads import run_in_threads

THREADS = 8
CHANGES = 400 if is_long() else 40


@pytest.fixture(scope="module")
def moving():
    return MovingScene()


@pytest.fixture(scope="module")
def queries(moving):
    return moving.make_queries()


@pytest.fixture(scope="module")
def expected(moving, queries):
    """The answers to each query by (transforms, vertices); from tracers that change nothing else."""
    answers = {}
    with clbvh.Tracer(moving.scene) as tracer:
        for vertices, places in itertools.product(range(STATES), repeat=2):
            moving.deform(tracer, vertices)
            moving.move(tracer, places)
            answers[places, vertices] = [ask(tracer, *query) for query in queries]
    return answers


@pytest.fixture
def tracer(moving):
    with clbvh.Tracer(moving.scene) as opened:
        moving.deform(opened, 0)
        yield opened


def buffer_count(tracer):
    return tracer._caster.session.buffer_count


def test_states_differ(expected):
    queries = list(zip(*expected.values(), strict=True))
    assert all(answers.count(answers[0]) < len(answers) for answers in queries)
    assert any(answers.count(answer) == 1 for answers in queries for answer in answers)


@pytest.mark.parametrize("movers", [1, 2])
def test_every_answer_is_that_of_one_state(moving, tracer, queries, expected, movers):
    """A change is of the transforms or of the vertices, so all pairs of both are states."""
    is_over, asked = threading.Event(), [0] * THREADS

    def move(seed):
        generator, count = np.random.default_rng(seed), 0
        try:
            # On a busy machine the others may not have had their turns.
            while count < CHANGES or min(asked) < 2:
                change = moving.move if generator.random() < 0.7 else moving.deform
                change(tracer, generator.integers(STATES))
                count += 1
        finally:
            is_over.set()

    def trace(seed):
        order = np.random.default_rng(seed).permutation(len(queries))
        try:
            while not is_over.is_set():
                index = order[asked[seed] % len(order)]
                answer = ask(tracer, *queries[index])
                assert any(answer == answers[index] for answers in expected.values()), queries[index][0]
                asked[seed] += 1
        finally:
            asked[seed] += 2  # also after a failure, so that the changes end

    run_in_threads(
        *(lambda seed=seed: move(seed) for seed in range(movers)),
        *(lambda seed=seed: trace(seed) for seed in range(THREADS)),
    )
    moving.move(tracer, 2)
    moving.deform(tracer, 3)
    assert [ask(tracer, *query) for query in queries] == expected[2, 3]
    assert tracer._caster.calls._loans == {}


def test_every_answer_of_moving_spheres_is_that_of_one_state():
    """They are alone in their scene, or beside others; they are refitted, and sometimes built anew."""
    generator = np.random.default_rng(7)
    centres = generator.uniform(-2, 2, (STATES, 500, 3))
    centres[1:-1] = centres[0] + generator.uniform(-0.05, 0.05, (STATES - 2, 500, 3))
    scene = clbvh.Scene()
    dots = scene.add(clbvh.Spheres(centres[0], 0.1))
    scene.place(dots)
    rays = generator.uniform(-3, 3, (2000, 3)), generator.normal(size=(2000, 3))
    is_over = threading.Event()
    for is_alone in (True, False):
        if not is_alone:
            scene.place(scene.add(clbvh.Spheres(centres[0], 0.01)))
        with clbvh.Tracer(scene) as tracer:
            expected = []
            for state in range(STATES):
                tracer.set_spheres(dots, centres[state], 0.1 + 0.01 * state)
                expected.append(ask(tracer, "closest_hit", rays))

            def move(tracer=tracer):
                try:
                    for _ in range(CHANGES):
                        state = generator.integers(STATES)
                        tracer.set_spheres(dots, centres[state], 0.1 + 0.01 * state)
                finally:
                    is_over.set()

            def trace(seed, tracer=tracer, expected=expected):
                while not is_over.is_set():
                    assert ask(tracer, "closest_hit", rays) in expected

            assert len({b"".join(answer) for answer in expected}) == STATES
            is_over.clear()
            run_in_threads(move, *(lambda seed=seed: trace(seed) for seed in range(3)))
            count = buffer_count(tracer)
            tracer.set_spheres(dots, centres[0])
            assert buffer_count(tracer) <= count


def test_a_query_of_several_pieces_sees_one_state(moving, tracer, queries, expected, monkeypatch):
    """Its buffers stay, however many changes come and go meanwhile, of transforms and of vertices."""
    index, rays = next(
        (index, rays) for index, (kind, rays) in enumerate(queries) if kind == "closest_hit" and len(rays[0]) == 500
    )
    monkeypatch.setattr(pieces, "CHUNK_RAYS", 50)
    changed = []

    def change(done, of):
        moving.move(tracer, done % STATES)
        moving.deform(tracer, done // 50 % STATES)
        moving.move(tracer, (done + 1) % STATES)
        changed.append(done)

    moving.move(tracer, 1)  # the query's nodes are those of an older scene, its instances are not
    answer = tracer.closest_hit(*rays, progress=change)
    assert len(changed) >= 10
    found = [getattr(answer, name).tobytes() for name in ("t", "u", "v", "prim_id", "instance_id")]
    assert found == expected[1, 0][index]


def test_later_queries_of_the_thread_that_moves_see_the_new_state(moving, tracer, queries, expected):
    now, turns = [0, 0], threading.Lock()

    def move_and_trace(seed):
        generator = np.random.default_rng(seed)
        for _ in range(CHANGES // 4):
            state, index, what = generator.integers(STATES), generator.integers(len(queries)), generator.integers(2)
            with turns:
                (moving.deform if what else moving.move)(tracer, state)
                now[what] = state
                assert ask(tracer, *queries[index]) == expected[tuple(now)][index]

    run_in_threads(*(lambda seed=seed: move_and_trace(seed) for seed in range(4)))


def test_closing_waits_for_a_change_and_refuses_later_ones(moving):
    for seed in range(20 if is_long() else 5):
        tracer = clbvh.Tracer(moving.scene)

        def change(tracer=tracer):
            for state in itertools.cycle(range(STATES)):
                moving.move(tracer, state)
                moving.deform(tracer, state)

        def query(tracer=tracer):
            while True:
                tracer.closest_hit([[0, 0, 9]], [[0, 0, -1]])

        def until_closed(work):
            with pytest.raises(QueryError, match="the tracer is closed"):
                work()

        def close(seed=seed, tracer=tracer):
            time.sleep(0.02 * seed)
            tracer.close()

        run_in_threads(
            *[lambda change=change: until_closed(change)] * 2, *[lambda query=query: until_closed(query)] * 4, close
        )
        assert tracer._caster.session.buffer_count == 0
        assert tracer._caster.calls._loans == {}


class TestMemory:
    def test_changes_leave_nothing_on_the_device(self, moving, tracer):
        moving.move(tracer, 1)
        moving.deform(tracer, 1)
        moving.move(tracer, 2)
        before = buffer_count(tracer), tracer.memory_bytes
        for change in range(50):
            moving.move(tracer, change % STATES)
        assert (buffer_count(tracer), tracer.memory_bytes) <= before
        for change in range(8):
            moving.deform(tracer, change % STATES)
        moving.move(tracer, 0)
        assert (buffer_count(tracer), tracer.memory_bytes) <= before

    def test_a_mesh_that_begins_to_move_is_on_the_device_once(self):
        scene = clbvh.Scene()
        ball = scene.place(scene.add(clbvh.make_shape("icosphere", triangles=320)))
        with clbvh.Tracer(scene) as tracer:
            for step in range(3):
                tracer.set_transforms(ball, clbvh.Transform(translate=(step, 0, 0)).matrix[None])
            # Nodes and blocks, and the tree over the instances.
            assert buffer_count(tracer) == 2 + 2

    @pytest.mark.parametrize("kind", ["transforms", "vertices", "built anew"])
    def test_a_change_that_fails_changes_nothing(self, kind):
        scene = clbvh.Scene()
        mesh = clbvh.make_shape("icosphere", triangles=320)
        ball, other = scene.add(mesh), scene.add(clbvh.make_shape("knot", triangles=500))
        first, _ = scene.place(ball), scene.place(other, clbvh.Transform(translate=(5, 0, 0)))
        tiny, order = 1e-25, np.random.default_rng(1).permutation(len(mesh.vertices))
        with clbvh.Tracer(scene) as tracer:
            tracer.set_vertices(other, other.shape.vertices)
            tracer.set_vertices(ball, mesh.vertices)
            before, hit = buffer_count(tracer), tracer.closest_hit([[0, 0, 5]], [[0, 0, -1]]).t.tolist()
            vertices = tiny * (mesh.vertices if kind == "vertices" else mesh.vertices[order])
            for _ in range(5):
                with pytest.raises(SceneError, match="is smaller than"):  # noqa: PT012 one of two calls
                    if kind == "transforms":
                        tracer.set_transforms(first, np.diag([tiny, tiny, tiny, 1])[None])
                    else:
                        tracer.set_vertices(ball, vertices)
                assert buffer_count(tracer) <= before
                assert tracer.closest_hit([[0, 0, 5]], [[0, 0, -1]]).t.tolist() == hit
            with pytest.raises(MeshError):
                tracer.set_vertices(ball, np.full_like(mesh.vertices, np.nan))
            assert buffer_count(tracer) <= before
