"""Threads that share a tracer, a pool, or nothing but the device: the answers of one thread."""

import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from clbvh import PoolError, QueryError, SubtreePool, Tracer, build
from clbvh.builders.processes.pool import open_executor
from clbvh.trace import running_calls
from clbvh.trace.rays import pieces

from ..profiles import is_long
from .queries import ask, make_queries
from .threads import PATIENCE_S, run_in_threads

THREADS = 8
SIZES = (1, 2, 50, 700, 5000)
LARGE = 140_000  # more than two host threads share
RAYS = np.random.default_rng(4).normal(size=(2, 2000, 3))


@pytest.fixture
def own_tracer(mesh):
    """A tracer that a test may close."""
    with Tracer(mesh) as opened:
        yield opened


class TestQueries:
    def test_mixed_ones_have_the_bytes_of_one_thread(self, tracer, mesh):
        queries = make_queries(mesh, SIZES, seed=1) * (20 if is_long() else 1)
        expected = [ask(tracer, *query) for query in queries]

        def ask_all(seed):
            for index in np.random.default_rng(seed).permutation(len(queries)):
                assert ask(tracer, *queries[index]) == expected[index], queries[index][0]

        run_in_threads(*(lambda seed=seed: ask_all(seed) for seed in range(THREADS)))

    def test_large_and_small_ones_have_the_bytes_of_one_thread(self, tracer, mesh, monkeypatch):
        monkeypatch.setattr(pieces, "CHUNK_RAYS", LARGE // 2 + 1)
        kinds = ("closest_hit", "all_hits", "closest_point")
        large = [query for query in make_queries(mesh, [LARGE], seed=2) if is_long() or query[0] in kinds]
        queries = [*large, *make_queries(mesh, [3], seed=3)]
        expected = [ask(tracer, *query) for query in queries]

        def ask_some(thread):
            for index in range(thread, len(queries), THREADS // 2):
                assert ask(tracer, *queries[index]) == expected[index], queries[index][0]

        run_in_threads(*(lambda thread=thread: ask_some(thread % (THREADS // 2)) for thread in range(THREADS)))

    def test_many_at_once_keep_little_memory(self, own_tracer, monkeypatch):
        monkeypatch.setattr(running_calls, "_KEPT_BYTES", 300_000)
        monkeypatch.setattr(pieces, "LEAST_RAYS", 1)  # fewer need no memory of a call
        meeting = threading.Barrier(THREADS)

        def meet(done, of):
            meeting.wait(PATIENCE_S)

        run_in_threads(*[lambda: own_tracer.all_hits(*RAYS, progress=meet)] * THREADS)  # 256,000 bytes each
        assert 1 <= len(own_tracer._caster.calls._idle) <= 4
        assert own_tracer._caster.calls._loans == {}


class TestClosing:
    def test_it_waits_for_queries_of_other_threads(self, own_tracer, monkeypatch):
        monkeypatch.setattr(pieces, "LEAST_RAYS", 1)  # nobody waits for few rays on the host
        expected = own_tracer.closest_prim(*RAYS)
        is_inside, may_go_on, waited = threading.Event(), threading.Event(), []

        def pause(done, of):
            is_inside.set()
            assert may_go_on.wait(PATIENCE_S)

        def trace():
            np.testing.assert_array_equal(own_tracer.closest_prim(*RAYS, progress=pause), expected)

        def close():
            assert is_inside.wait(PATIENCE_S)
            threading.Timer(0.1, may_go_on.set).start()
            own_tracer.close()
            waited.append(may_go_on.is_set())

        run_in_threads(trace, close)
        assert waited == [True]
        with pytest.raises(QueryError, match="the tracer is closed"):
            own_tracer.closest_prim(*RAYS)

    def test_progress_functions_may_close_their_tracer(self, own_tracer):
        expected = own_tracer.closest_prim(*RAYS)
        all_are_running = threading.Barrier(2, timeout=PATIENCE_S)

        def close(done, of):
            all_are_running.wait()
            own_tracer.close()

        for found in run_in_threads(*[lambda: own_tracer.closest_prim(*RAYS, progress=close)] * 2):
            np.testing.assert_array_equal(found, expected)
        assert own_tracer.is_closed
        assert own_tracer._caster.session.is_closed


class TestPool:
    def test_closing_waits_for_a_build_of_another_thread_and_a_later_one_is_refused(self, mesh):
        pool = SubtreePool(2)
        is_held, order = threading.Event(), []

        def hold():
            with open_executor(pool) as executor:
                is_held.set()
                time.sleep(0.2)
                executor.run_on_each(list)  # the workers still answer
                order.append("built")

        def close():
            assert is_held.wait(PATIENCE_S)
            pool.close()
            order.append("closed")

        run_in_threads(hold, close, close)
        assert order == ["built", "closed", "closed"]
        with pytest.raises(PoolError, match="the pool is closed"):
            build(mesh, pool=pool, task_threshold=500)


_FIRST_USE = """
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
import clbvh

meeting = Barrier(8)

def use(_):
    meeting.wait()
    with clbvh.Tracer(clbvh.make_shape("icosphere", triangles=320)) as tracer:
        return tracer.all_hits([[0.1, 0.2, 5]], [[0, 0, -1]]).prim_id.tobytes()

with ThreadPoolExecutor(8) as pool:
    print(len(set(pool.map(use, range(8)))))
"""


def test_the_first_use_may_be_in_several_threads_at_once():
    ran = subprocess.run([sys.executable, "-c", _FIRST_USE], capture_output=True, text=True, timeout=PATIENCE_S)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "1\n", "")
