"""Ctrl-C at random moments of queries, and what is left afterwards: a script, run as ``... SEED COUNT``.

Prints one JSON object.
"""

from __future__ import annotations

import faulthandler
import json
import random
import signal
import sys
import time

import clbvh
from clbvh.support.host_threads import HostThreads
from clbvh.trace.rays import pieces

from ..concurrency.queries import ask, make_queries
from ..concurrency.threads import run_in_threads
from .interrupt import interrupt

# A query that does not come back within this time hangs.
PATIENCE_S = 60.0

_SIZES = (1, 300, 140_000)


def main(seed, count):
    """Interrupt queries, and count what came of it."""
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    generator = random.Random(seed)
    mesh = clbvh.make_shape("knot", triangles=1800)
    pieces.CHUNK_RAYS = 80_000
    with clbvh.Tracer(clbvh.build(mesh)) as tracer:
        # Some threads even on a machine with one processor.
        tracer._caster.threads = HostThreads(3)
        queries = make_queries(mesh, _SIZES, seed=seed)
        expected, durations_s = [], []
        for query in queries:
            ask(tracer, *query)  # compiles
            begin = time.perf_counter()
            expected.append(ask(tracer, *query))
            durations_s.append(time.perf_counter() - begin)

        interrupted, wrong = 0, 0
        for _ in range(count):
            faulthandler.dump_traceback_later(PATIENCE_S, exit=True)
            index = generator.randrange(len(queries))
            try:
                _, answer = interrupt(
                    lambda index=index: ask(tracer, *queries[index]),
                    max(1e-5, generator.uniform(0, 1.2) * durations_s[index]),
                )
            except KeyboardInterrupt:  # between the query and the end of the timer
                answer = None
            interrupted += answer is None
            wrong += answer is not None and answer != expected[index]
        calls = tracer._caster.calls
        idle_buffers = [memory.session.buffer_count for memory in calls._idle]
        left = {"loans": len(calls._loans), "idle": len(calls._idle), "most buffers": max(idle_buffers, default=0)}
        # Neither this thread nor another one finds a lock taken.
        again = run_in_threads(*(lambda index=index: ask(tracer, *queries[index]) for index in range(len(queries))))
        right = again == expected
    print(json.dumps({"interrupted": interrupted, "wrong": wrong, "right afterwards": right, **left}))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
