"""Ctrl-C in a script, at random moments of queries and changes: `KeyboardInterrupt`, and no wrong answer after it."""

import faulthandler
import itertools
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress

import numpy as np
import pytest

import clbvh

from ..concurrency.moving_scenes import STATES, MovingScene
from ..concurrency.queries import ask
from ..profiles import is_long

# What does not come back within this time hangs.
PATIENCE_S = 60.0


@pytest.mark.skipif(sys.platform == "win32", reason="interrupts by the timer of Unix")
def test_answers_after_ctrl_c_are_those_before_or_after_what_it_broke_off():
    count = 2000 if is_long() else 200
    script = [sys.executable, "-m", "tests.processes.test_interrupts", str(count)]
    ran = subprocess.run(script, capture_output=True, text=True, timeout=1800, check=False)
    assert ran.returncode == 0, ran.stderr
    assert int(ran.stdout) > count // 10


def interrupt(work, after_s):
    """Call a function, interrupt it after a time, and return its result, or None."""
    result = None
    with suppress(KeyboardInterrupt):
        try:
            signal.setitimer(signal.ITIMER_REAL, max(1e-5, after_s))
            result = work()
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
    # Native code may keep the exception to itself; the next array that numpy makes of a number then raises it.
    with suppress(KeyboardInterrupt):
        np.array([0.5])
    return result


def main(count):
    """Print how many of the queries and changes of a scene were interrupted; raise after a wrong answer."""
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    generator, moving, expected, longest_s = random.Random("Ctrl-C in a script"), MovingScene(), {}, {}
    queries, changed = moving.make_queries((10_000,)), len(moving.changes)
    with clbvh.Tracer(moving.scene) as tracer:

        def work(number, state):
            if number < changed:
                moving.changes[number](tracer, state)
                return True
            return ask(tracer, *queries[number - changed])

        for states in itertools.product(range(STATES), repeat=changed):
            for number in range(changed):
                work(number, states[number])
            expected[states] = [ask(tracer, *query) for query in queries]
        for number in range(changed + len(queries)):
            begin = time.perf_counter()
            work(number, states[-1])
            longest_s[number] = time.perf_counter() - begin
        interrupted = 0
        for _ in range(count):
            faulthandler.dump_traceback_later(PATIENCE_S, exit=True)
            number, state = generator.choice((0, 1, generator.randrange(len(longest_s)))), generator.randrange(STATES)
            after_s = generator.uniform(0, 1.2) * longest_s[number]
            result = interrupt(lambda number=number, state=state: work(number, state), after_s)
            interrupted += result is None
            answers = [ask(tracer, *query) for query in queries]
            if number >= changed:
                assert result in (None, answers[number - changed])
                assert answers == expected[states]
            else:
                after = (*states[:number], state, *states[number + 1 :])
                assert answers == expected[after] or (answers == expected[states] and result is None)
                states = after if answers == expected[after] else states
    print(interrupted)


if __name__ == "__main__":
    main(int(sys.argv[1]))
