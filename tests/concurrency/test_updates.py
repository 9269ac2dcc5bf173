"""Threads that query a tracer while others move its mesh: every answer is that of one of the meshes, in full."""

from __future__ import annotations

import itertools
import threading
import time

import numpy as np
import pytest

from clbvh import Tracer, build, make_shape
from clbvh.errors import QueryError

from ..deform import deform
from ..profiles import is_long
from .queries import ask, make_queries
from .threads import run_in_threads

THREADS = 4
FRAMES = 6
UPDATES = 400 if is_long() else 60


@pytest.fixture(scope="module")
def mesh():
    return make_shape("knot", triangles=6000)


@pytest.fixture(scope="module")
def bvh(mesh):
    return build(mesh)


@pytest.fixture(scope="module")
def frames(mesh):
    return [deform(mesh, frame) for frame in range(FRAMES)]


@pytest.fixture(scope="module")
def queries(mesh):
    return make_queries(mesh, (1, 700), seed=1)


@pytest.fixture(scope="module")
def expected(bvh, frames, queries):
    """The answers to each query, of each frame."""
    answers = []
    for vertices in frames:
        with Tracer(bvh.refit(vertices)) as tracer:
            answers.append([ask(tracer, *query) for query in queries])
    return list(zip(*answers, strict=True))


@pytest.mark.parametrize("movers", [1, 2])
@pytest.mark.parametrize("layout", ["bvh2", "bvh8"])
def test_every_answer_is_that_of_one_mesh(bvh, frames, queries, expected, layout, movers):
    is_over, asked = threading.Event(), [0] * THREADS
    with Tracer(bvh, layout=layout) as tracer:
        tracer.update(frames[0])

        def move(first):
            try:
                frame = first
                # On a busy machine the others may not have had their turns.
                while frame < first + UPDATES or min(asked) < 2:
                    tracer.update(frames[frame % FRAMES])
                    frame += 1
            finally:
                is_over.set()

        def trace(seed):
            order = np.random.default_rng(seed).permutation(len(queries))
            try:
                while not is_over.is_set():
                    index = order[asked[seed] % len(order)]
                    assert ask(tracer, *queries[index]) in expected[index], queries[index][0]
                    asked[seed] += 1
            finally:
                asked[seed] += 2  # also after a failure, so that the updates end

        run_in_threads(
            *(lambda first=first: move(first) for first in range(movers)),
            *(lambda seed=seed: trace(seed) for seed in range(THREADS)),
        )
        tracer.update(frames[3])
        assert [ask(tracer, *query) for query in queries] == [answers[3] for answers in expected]
        assert tracer.memory_bytes == 2 * tracer._caster.world.memory_bytes
        assert tracer._caster.calls._loans == {}


def test_later_queries_of_the_thread_that_moves_see_the_new_mesh(bvh, frames, queries, expected):
    with Tracer(bvh) as tracer:

        def move_and_trace(seed):
            generator = np.random.default_rng(seed)
            for _ in range(UPDATES // 4):
                frame, index = generator.integers(FRAMES), generator.integers(len(queries))
                with turns:
                    tracer.update(frames[frame])
                    assert ask(tracer, *queries[index]) == expected[index][frame]

        turns = threading.Lock()
        run_in_threads(*(lambda seed=seed: move_and_trace(seed) for seed in range(THREADS)))


def test_closing_waits_for_an_update_and_refuses_later_ones(bvh, frames):
    for seed in range(20 if is_long() else 5):
        tracer = Tracer(bvh)

        def move(tracer=tracer):
            for vertices in itertools.cycle(frames):
                tracer.update(vertices)

        def move_until_closed(move=move):
            with pytest.raises(QueryError, match="the tracer is closed"):
                move()

        def close(seed=seed, tracer=tracer):
            time.sleep(0.01 * seed)
            tracer.close()

        run_in_threads(move_until_closed, move_until_closed, close)
        assert tracer._caster.session.buffer_count == 0
        assert tracer._caster.calls._loans == {}
