"""Threads that query what others move: every answer is that of one state, in full."""

from __future__ import annotations

import itertools
import pickle
import threading
import time

import numpy as np
import pytest

import clbvh
from clbvh import MeshError, QueryError, SceneError
from clbvh.support import opened
from clbvh.trace.rays import pieces

from ..profiles import is_long
from .moving_scenes import STATES, MovingMasks, MovingMesh, MovingScene, MovingSpheres
from .queries import ask
from .threads import run_in_threads

THREADS = 6
CHANGES = 400 if is_long() else 40

MOVING = {
    "mesh": MovingMesh,
    "scene": MovingScene,
    "masks": MovingMasks,
    "spheres": lambda: MovingSpheres(is_alone=True),
    "spheres among others": lambda: MovingSpheres(is_alone=False),
}


class Moving:
    """Something that moves, its tracer, and the answers to all queries in each of its states."""

    def __init__(self, subject):
        self.subject, self.queries = subject, subject.make_queries()
        with self.open() as tracer:
            self.expected = {}
            for states in itertools.product(range(STATES), repeat=len(subject.changes)):
                self.set(tracer, states)
                self.expected[states] = [ask(tracer, *query) for query in self.queries]

    def open(self):
        """Open a tracer of the first state."""
        tracer = clbvh.Tracer(self.subject.source)
        self.set(tracer, [0] * len(self.subject.changes))
        return tracer

    def set(self, tracer, states):
        for change, state in zip(self.subject.changes, states, strict=True):
            change(tracer, state)

    def change(self, tracer, generator):
        """Change something at random."""
        number, state = generator.integers(len(self.subject.changes)), generator.integers(STATES)
        self.subject.changes[number](tracer, state)


@pytest.fixture(scope="module", params=MOVING)
def moving(request):
    return Moving(MOVING[request.param]())


def buffer_count(tracer):
    return tracer._caster.session.buffer_count


@pytest.mark.parametrize("movers", [1, 2])
def test_every_answer_is_that_of_one_state(moving, movers):
    expected, queries = moving.expected, moving.queries
    assert len({b"".join(itertools.chain(*answers)) for answers in expected.values()}) == len(expected)
    is_over, asked = threading.Event(), [0] * THREADS
    with moving.open() as tracer:

        def move(seed):
            generator, count = np.random.default_rng(seed), 0
            try:
                # On a busy machine the others may not have had their turns.
                while count < CHANGES or min(asked) < 2:
                    moving.change(tracer, generator)
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
        last = list(expected)[-2]
        moving.set(tracer, last)
        assert [ask(tracer, *query) for query in queries] == expected[last]
        assert tracer._caster.calls._loans == {}


@pytest.mark.parametrize("delay_s", np.linspace(0, 0.06, 20 if is_long() else 4))
def test_closing_waits_for_a_change_and_refuses_later_ones(moving, delay_s):
    tracer, generator = moving.open(), np.random.default_rng(1)

    def change():
        with pytest.raises(QueryError, match="the tracer is closed"):  # noqa: PT012 again and again
            while True:
                moving.change(tracer, generator)

    def query():
        with pytest.raises(QueryError, match="the tracer is closed"):  # noqa: PT012 again and again
            while True:
                ask(tracer, *moving.queries[0])

    def close():
        time.sleep(delay_s)
        tracer.close()

    run_in_threads(change, query, query, close)
    assert buffer_count(tracer) == 0
    assert tracer._caster.calls._loans == {}


def test_a_query_of_several_pieces_sees_one_state(monkeypatch):
    """Its buffers stay, however many changes come and go meanwhile, of transforms and of vertices."""
    scene = Moving(MovingScene())
    index, rays = next(
        (index, rays) for index, (kind, rays) in enumerate(scene.queries) if kind == "closest_hit" and len(rays[0]) > 99
    )
    monkeypatch.setattr(pieces, "CHUNK_RAYS", 50)
    monkeypatch.setattr(pieces, "LEAST_RAYS", 1)
    changed = []
    with scene.open() as tracer:

        def change(done, of):
            scene.set(tracer, (done % STATES, done // 50 % STATES))
            scene.subject.move(tracer, (done + 1) % STATES)
            changed.append(done)

        scene.set(tracer, (1, 0))
        scene.subject.move(tracer, 1)  # the query's nodes are those of an older scene, its instances are not
        answer = tracer.closest_hit(*rays, progress=change)
    assert len(changed) >= 10
    found = [getattr(answer, name).tobytes() for name in ("t", "u", "v", "prim_id", "instance_id")]
    assert found == scene.expected[1, 0][index]


def test_tracers_of_one_world_change_each_on_its_own():
    """Two that arrived with the same world leave its buffers alone, also once nobody sees it any more."""
    subject = MovingMesh()
    arriving = pickle.dumps(clbvh.Tracer(subject.source))
    tracers = [pickle.loads(arriving) for _ in range(2)]
    opened._kept.clear()
    expected = Moving(subject).expected
    for state in range(1, STATES):
        for tracer, moved in zip(tracers, (state, 0), strict=True):
            tracer.update(subject.vertices[moved])
        for tracer, moved in zip(tracers, (state, 0), strict=True):
            assert [ask(tracer, *query) for query in subject.make_queries()] == expected[moved,]


def test_a_change_that_fails_changes_nothing():
    scene, mesh = clbvh.Scene(), clbvh.make_shape("icosphere", triangles=320)
    ball = scene.add(mesh)
    first, tiny = scene.place(ball), 1e-25
    scene.place(scene.add(clbvh.make_shape("knot", triangles=500)), clbvh.Transform(translate=(5, 0, 0)))
    order = np.random.default_rng(1).permutation(len(mesh.vertices))
    with clbvh.Tracer(scene) as tracer:
        tracer.set_vertices(ball, mesh.vertices)
        before, hit = buffer_count(tracer), tracer.closest_hit([[0, 0, 5]], [[0, 0, -1]]).t.tolist()
        for change, error in (
            (lambda: tracer.set_transforms(first, np.diag([tiny, tiny, tiny, 1])[None]), SceneError),
            (lambda: tracer.set_vertices(ball, tiny * mesh.vertices), SceneError),
            (lambda: tracer.set_vertices(ball, tiny * mesh.vertices[order]), SceneError),  # built anew
            (lambda: tracer.set_vertices(ball, np.full_like(mesh.vertices, np.nan)), MeshError),
        ):
            for _ in range(2):
                with pytest.raises(error):
                    change()
            assert buffer_count(tracer) <= before
            assert tracer.closest_hit([[0, 0, 5]], [[0, 0, -1]]).t.tolist() == hit
