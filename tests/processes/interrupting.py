"""Ctrl-C at random moments, and what is left afterwards: a script, run as ``... queries|vertices|scene SEED COUNT``.

Prints one JSON object.
"""

import faulthandler
import itertools
import json
import random
import signal
import sys
import time
from contextlib import suppress

import numpy as np

import clbvh
from clbvh.support.host_threads import HostThreads
from clbvh.trace.rays import pieces

from ..concurrency.moving_scenes import STATES, MovingScene
from ..concurrency.queries import ask, make_queries
from ..concurrency.threads import run_in_threads
from ..deform import deform

# What does not come back within this time hangs.
PATIENCE_S = 60.0


def interrupt(work, duration_s, generator):
    """Call a function and interrupt it at some moment; return whether it came to its end, and its result."""
    is_done, result = False, None
    try:
        signal.setitimer(signal.ITIMER_REAL, max(1e-5, generator.uniform(0, 1.2) * duration_s))
        result = work()
        is_done = True
    except KeyboardInterrupt:
        pass
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    # Native code may keep the exception to itself; the next array that numpy makes of a number then raises it.
    with suppress(KeyboardInterrupt):
        np.array([0.5])
    return is_done, result


def time_of(work):
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def interrupt_queries(tracer, queries, count, generator):
    """Interrupt queries, and count what came of it."""
    works = [lambda query=query: ask(tracer, *query) for query in queries]
    expected = [work() for work in works]  # compiles
    durations_s = [time_of(work) for work in works]
    interrupted = wrong = 0
    for _ in range(count):
        faulthandler.dump_traceback_later(PATIENCE_S, exit=True)
        index = generator.randrange(len(works))
        answer = None
        with suppress(KeyboardInterrupt):  # between the query and the end of the timer
            _, answer = interrupt(works[index], durations_s[index], generator)
        interrupted += answer is None
        wrong += answer is not None and answer != expected[index]
    idle = tracer._caster.calls._idle
    left = {"idle": len(idle), "buffers": max((memory.session.buffer_count for memory in idle), default=0)}
    # Neither this thread nor another one finds a lock taken.
    right = run_in_threads(*works) == expected
    return {"interrupted": interrupted, "wrong": wrong, "right": right, **left}


def interrupt_changes(tracer, changes, queries, count, generator):
    """Interrupt changes, each a function of the number of a state, and count what came of it."""

    def answer():
        return [ask(tracer, *query) for query in queries]

    expected = {}
    for states in itertools.product(range(STATES), repeat=len(changes)):
        for change, state in zip(changes, states, strict=True):
            change(state)
        expected[states] = answer()
    durations_s = [time_of(lambda change=change: change(STATES - 1)) for change in changes]
    now = (STATES - 1,) * len(changes)
    interrupted = wrong = most_buffers = 0
    for _ in range(count):
        faulthandler.dump_traceback_later(PATIENCE_S, exit=True)
        state, kind = generator.randrange(STATES), generator.randrange(len(changes))
        is_done = True
        with suppress(KeyboardInterrupt):  # between the change and the end of the timer
            is_done, _ = interrupt(lambda kind=kind, state=state: changes[kind](state), durations_s[kind], generator)
        interrupted += not is_done
        after = (*now[:kind], state, *now[kind + 1 :])
        answers = answer()
        wrong += answers != expected[after] and (is_done or answers != expected[now])
        now = after if answers == expected[after] else now
        most_buffers = max(most_buffers, tracer._caster.session.buffer_count)
    # Neither this thread nor another one finds a lock taken.
    run_in_threads(*(lambda change=change: change(0) for change in changes))
    right = answer() == expected[(0,) * len(changes)]
    return {"interrupted": interrupted, "wrong": wrong, "right": right, "buffers": most_buffers}


def main(what, seed, count):
    """Interrupt queries of a mesh, moves of its vertices, or changes of a scene."""
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    generator = random.Random(seed)
    moving = MovingScene() if what == "scene" else None
    mesh = clbvh.make_shape("knot", triangles=1800 if what == "queries" else 40_000)
    with clbvh.Tracer(moving.scene if moving else mesh) as tracer:
        # Some threads even on a machine with one processor.
        tracer._caster.threads = HostThreads(3)
        if what == "queries":
            pieces.CHUNK_RAYS = 80_000
            queries = make_queries(mesh, (1, 300, 140_000), seed=seed)
            found = interrupt_queries(tracer, queries, count, generator)
        elif what == "vertices":
            frames = [deform(mesh, frame) for frame in range(STATES)]
            queries = make_queries(mesh, (300,), seed=seed)
            found = interrupt_changes(tracer, [lambda state: tracer.update(frames[state])], queries, count, generator)
        else:
            changes = [lambda state: moving.move(tracer, state), lambda state: moving.deform(tracer, state)]
            found = interrupt_changes(tracer, changes, moving.make_queries((300,), seed), count, generator)
        found["loans"] = len(tracer._caster.calls._loans)
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
