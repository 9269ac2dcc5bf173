"""Ctrl-C at random moments of changes of a scene, and what is left afterwards: a script, run as ``... SEED COUNT``.

Prints one JSON object.
"""

from __future__ import annotations

import faulthandler
import itertools
import json
import random
import signal
import sys
import time

import clbvh
from clbvh.support.host_threads import HostThreads

from ..concurrency.moving_scenes import STATES, MovingScene
from ..concurrency.queries import ask
from ..concurrency.threads import run_in_threads
from .interrupt import interrupt
from .interrupting import PATIENCE_S


def main(seed, count):
    """Interrupt changes, and count what came of it."""
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    generator = random.Random(seed)
    moving = MovingScene()
    queries = moving.make_queries((300,), seed)
    with clbvh.Tracer(moving.scene) as tracer:
        # Some threads even on a machine with one processor.
        tracer._caster.threads = HostThreads(3)
        changes = (moving.move, moving.deform)
        expected = {}
        for vertices, places in itertools.product(range(STATES), repeat=2):
            moving.deform(tracer, vertices)
            moving.move(tracer, places)
            expected[places, vertices] = [ask(tracer, *query) for query in queries]
        durations_s = []
        for change in changes:
            begin = time.perf_counter()
            change(tracer, STATES - 1)
            durations_s.append(time.perf_counter() - begin)

        interrupted, wrong, now, most_buffers = 0, 0, [STATES - 1, STATES - 1], 0
        for _ in range(count):
            faulthandler.dump_traceback_later(PATIENCE_S, exit=True)
            state, kind, index = generator.randrange(STATES), generator.randrange(2), generator.randrange(len(queries))
            try:
                is_done, _ = interrupt(
                    lambda state=state, kind=kind: changes[kind](tracer, state),
                    max(1e-5, generator.uniform(0, 1.2) * durations_s[kind]),
                )
            except KeyboardInterrupt:  # between the change and the end of the timer
                is_done = True
            interrupted += not is_done
            after = [state if number == kind else other for number, other in enumerate(now)]
            answer = ask(tracer, *queries[index])
            is_before, is_after = (answer == expected[tuple(each)][index] for each in (now, after))
            wrong += not (is_after or (is_before and not is_done))
            if is_done:
                now = after
            else:
                # Either: ask all queries, which tell them apart.
                answers = [ask(tracer, *query) for query in queries]
                wrong += answers not in (expected[tuple(now)], expected[tuple(after)])
                now = after if answers == expected[tuple(after)] else now
            most_buffers = max(most_buffers, tracer._caster.session.buffer_count)
        # Neither this thread nor another one finds a lock taken.
        run_in_threads(lambda: moving.move(tracer, 0), lambda: moving.deform(tracer, 0))
        right = [ask(tracer, *query) for query in queries] == expected[0, 0]
        loans = len(tracer._caster.calls._loans)
    print(json.dumps({"interrupted": interrupted, "wrong": wrong, "right afterwards": right, "loans": loans,
                      "most buffers": most_buffers}))  # fmt: skip


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
