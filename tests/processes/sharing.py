"""Threads that share a tracer that changes, or arrays on a device: a script, run as ``... NAME SECONDS``.

It ends with an error where an answer is that of no state. What went wrong here ended the process.
"""

import sys
import time
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
import pyopencl.array

import clbvh

THREADS = 8
BALL = clbvh.make_shape("icosphere", triangles=320)
ORIGINS = 3 * np.random.default_rng(1).normal(size=(100, 3))
DIRECTIONS = np.random.default_rng(2).normal(scale=0.3, size=(100, 3)) - ORIGINS


def ask(tracer, *rays):
    """Return the bytes of an answer."""
    hits = tracer.closest_hit(*rays)
    return hits.t.tobytes() + hits.prim_id.tobytes()


def updates(seconds):
    """The vertices change places, so that every other update builds the tree anew."""
    states = [np.random.default_rng(seed).permutation(BALL.vertices) for seed in range(3)]
    expected = set()
    for vertices in states:
        with clbvh.Tracer((vertices, BALL.faces)) as tracer:
            expected.add(ask(tracer, ORIGINS, DIRECTIONS))
    assert len(expected) == len(states)
    with clbvh.Tracer((states[0], BALL.faces), quality="fast") as tracer, ThreadPoolExecutor(THREADS) as pool:
        for vertices in states:  # what is compiled for the first time takes seconds
            tracer.update(vertices)
        end = time.monotonic() + seconds

        def query():
            while time.monotonic() < end:
                assert ask(tracer, ORIGINS, DIRECTIONS) in expected

        queries = [pool.submit(query) for _ in range(THREADS - 1)]
        while time.monotonic() < end:
            for vertices in states:
                tracer.update(vertices)
        for each in queries:
            each.result()


def arrays(seconds):
    """All threads ask with the same arrays on the device, which are still being written."""
    meeting = Barrier(THREADS)
    with clbvh.Tracer(BALL, device="pocl") as tracer, ThreadPoolExecutor(THREADS) as pool:
        expected = ask(tracer, ORIGINS, DIRECTIONS)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            rays = [pyopencl.array.to_device(tracer.queue, each, async_=True) for each in (ORIGINS, DIRECTIONS)]

            def query(rays=rays):
                meeting.wait()
                for _ in range(10):
                    assert ask(tracer, *rays) == expected

            for each in [pool.submit(query) for _ in range(THREADS)]:
                each.result()


if __name__ == "__main__":
    sys.setswitchinterval(1e-5)
    name, seconds = sys.argv[1:]
    globals()[name](float(seconds))
