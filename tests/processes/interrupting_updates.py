"""Ctrl-C at random moments of updates, and what is left afterwards: a script, run as ``... SEED COUNT``.

Prints one JSON object.
"""

from __future__ import annotations

import faulthandler
import gc
import json
import random
import signal
import sys
import time

import clbvh
from clbvh.support.host_threads import HostThreads

from ..concurrency.queries import ask, make_queries
from ..concurrency.threads import run_in_threads
from ..deform import deform
from .interrupt import interrupt
from .interrupting import PATIENCE_S

_FRAMES = 4


def main(seed, count):
    """Interrupt updates, and count what came of it."""
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    generator = random.Random(seed)
    mesh = clbvh.make_shape("knot", triangles=40_000)
    frames = [deform(mesh, frame) for frame in range(_FRAMES)]
    queries = make_queries(mesh, (300,), seed=seed)
    with clbvh.Tracer(clbvh.build(mesh)) as tracer:
        # Some threads even on a machine with one processor.
        tracer._caster.threads = HostThreads(3)
        expected = []
        for vertices in frames:
            tracer.update(vertices)
            expected.append([ask(tracer, *query) for query in queries])
        begin = time.perf_counter()
        tracer.update(frames[-1])
        duration_s = time.perf_counter() - begin

        interrupted, wrong, now = 0, 0, _FRAMES - 1
        for _ in range(count):
            faulthandler.dump_traceback_later(PATIENCE_S, exit=True)
            frame, index = generator.randrange(_FRAMES), generator.randrange(len(queries))
            try:
                is_done, _ = interrupt(
                    lambda frame=frame: tracer.update(frames[frame]),
                    max(1e-5, generator.uniform(0, 1.2) * duration_s),
                )
            except KeyboardInterrupt:  # between the update and the end of the timer
                is_done = True
            interrupted += not is_done
            is_new = tracer.mesh.vertices.tobytes() == frames[frame].tobytes()
            now = frame if is_new else now
            wrong += (is_done and not is_new) or ask(tracer, *queries[index]) != expected[now][index]
            wrong += tracer.mesh.vertices.tobytes() != frames[now].tobytes()
        gc.collect()  # exceptions hold what they were raised in
        # Neither this thread nor another one finds a lock taken.
        run_in_threads(lambda: tracer.update(frames[0]))
        right = [ask(tracer, *query) for query in queries] == expected[0]
        loans = len(tracer._caster.calls._loans)
        buffers = tracer._caster.session.buffer_count
    print(json.dumps({"interrupted": interrupted, "wrong": wrong, "right afterwards": right, "loans": loans,
                      "buffers": buffers}))  # fmt: skip


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
