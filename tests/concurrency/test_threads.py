"""Threads that share a tracer, an engine of trimesh, a pool, or nothing but the device: the answers of one thread."""

from __future__ import annotations

import itertools
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import trimesh

from clbvh import RenderOptions, Scene, SubtreePool, Tracer, View, build, make_shape, render
from clbvh.builders.processes.pool import open_executor
from clbvh.device.session import DeviceSession
from clbvh.errors import PoolError, QueryError
from clbvh.integrations.trimesh import RayMeshIntersector
from clbvh.trace import running_calls
from clbvh.trace.rays import pieces

from ..profiles import is_long
from .queries import ask, make_queries
from .threads import PATIENCE_S, run_in_threads

THREADS = 8
SIZES = (1, 2, 50, 700, 5000)
LARGE = 140_000  # more than two host threads share


@pytest.fixture(scope="module")
def mesh():
    return make_shape("knot", triangles=6000)


@pytest.fixture(scope="module")
def bvh(mesh):
    return build(mesh)


@pytest.fixture
def tracer(bvh, session):
    with Tracer(bvh, device=session.info) as opened:
        yield opened


def ask_in_threads(tracer, queries, expected):
    """Ask all queries in each of several threads, in different orders, and compare the bytes."""

    def ask_all(seed):
        for index in np.random.default_rng(seed).permutation(len(queries)):
            assert ask(tracer, *queries[index]) == expected[index], queries[index][0]

    run_in_threads(*(lambda seed=seed: ask_all(seed) for seed in range(THREADS)))


class TestTracer:
    @pytest.mark.parametrize("layout", ["bvh2", "bvh8"])
    def test_mixed_queries_have_the_bytes_of_one_thread(self, session, mesh, bvh, layout):
        queries = make_queries(mesh, SIZES, seed=1) * (20 if is_long() else 1)
        with Tracer(bvh, device=session.info, layout=layout) as tracer:
            ask_in_threads(tracer, queries, [ask(tracer, *query) for query in queries])

    def test_large_and_small_queries_have_the_bytes_of_one_thread(self, tracer, mesh, monkeypatch):
        monkeypatch.setattr(pieces, "CHUNK_RAYS", LARGE // 2 + 1)
        large = [
            query
            for query in make_queries(mesh, [LARGE], seed=2)
            if is_long() or query[0] in ("closest_hit", "all_hits", "closest_point")
        ]
        queries = [*large, *make_queries(mesh, [3], seed=3)]
        expected = [ask(tracer, *query) for query in queries]

        def ask_some(thread):
            for index in range(thread, len(queries), THREADS // 2):
                assert ask(tracer, *queries[index]) == expected[index], queries[index][0]

        run_in_threads(*(lambda thread=thread: ask_some(thread % (THREADS // 2)) for thread in range(THREADS)))

    def test_little_memory_is_kept_of_many_calls_at_once(self, tracer, mesh, monkeypatch):
        monkeypatch.setattr(running_calls, "_KEPT_BYTES", 300_000)
        meeting = threading.Barrier(THREADS)
        rays = np.random.default_rng(4).normal(size=(2, 2000, 3))  # 96,000 bytes

        def meet(done, of):
            meeting.wait(PATIENCE_S)

        run_in_threads(*[lambda: tracer.any_hit(*rays, progress=meet)] * THREADS)
        assert 1 <= len(tracer._caster.calls._idle) <= 4
        assert tracer._caster.calls._loans == {}

    def test_times_are_those_of_all_threads(self, tracer):
        before = tracer.timings_ms.get("kernel", 0.0)
        run_in_threads(*[lambda: tracer.any_hit([[0, 0, 9]], [[0, 0, -1]])] * THREADS)
        assert tracer.timings_ms["kernel"] > before


class TestClosing:
    def test_it_waits_for_queries_of_other_threads(self, bvh, session):
        rays = np.random.default_rng(5).normal(size=(2, 100, 3))
        tracer = Tracer(bvh, device=session.info)
        expected = tracer.closest_prim(*rays)
        is_inside, may_go_on, order = threading.Event(), threading.Event(), []

        def pause(done, of):
            is_inside.set()
            assert may_go_on.wait(PATIENCE_S)

        def trace():
            np.testing.assert_array_equal(tracer.closest_prim(*rays, progress=pause), expected)
            order.append("traced")

        def close():
            assert is_inside.wait(PATIENCE_S)
            threading.Timer(0.1, may_go_on.set).start()
            tracer.close()
            order.append("closed")

        run_in_threads(trace, close)
        assert order == ["traced", "closed"]
        with pytest.raises(QueryError, match="the tracer is closed"):
            tracer.closest_prim(*rays)

    def test_queries_get_an_answer_or_a_clear_error(self, mesh, bvh, session):
        queries = make_queries(mesh, SIZES, seed=6)
        with Tracer(bvh, device=session.info) as tracer:
            expected = [ask(tracer, *query) for query in queries]
        for seed in range(20 if is_long() else 5):
            tracer = Tracer(bvh, device=session.info)

            def trace(tracer=tracer):
                for index in itertools.cycle(range(len(queries))):
                    assert ask(tracer, *queries[index]) == expected[index]

            def trace_until_closed(trace=trace):
                with pytest.raises(QueryError, match="the tracer is closed"):
                    trace()

            def close(seed=seed, tracer=tracer):
                time.sleep(0.02 * seed)
                tracer.close()

            run_in_threads(close, close, *[trace_until_closed] * THREADS)
            assert tracer.is_closed
            assert tracer._caster.session.buffer_count == 0

    def test_a_progress_function_may_close_its_tracer(self, bvh, session):
        tracer = Tracer(bvh, device=session.info)
        rays = np.random.default_rng(7).normal(size=(2, 100, 3))
        expected = tracer.closest_prim(*rays)
        found = tracer.closest_prim(*rays, progress=lambda done, of: tracer.close())
        np.testing.assert_array_equal(found, expected)
        assert tracer.is_closed
        assert tracer._caster.session.is_closed

    def test_two_progress_functions_may_close_one_tracer(self, bvh, session):
        tracer = Tracer(bvh, device=session.info)
        rays = np.random.default_rng(7).normal(size=(2, 100, 3))
        expected = tracer.closest_prim(*rays)
        both_are_running = threading.Barrier(2, timeout=PATIENCE_S)

        def close(done, of):
            both_are_running.wait()
            tracer.close()

        for found in run_in_threads(*[lambda: tracer.closest_prim(*rays, progress=close)] * 2):
            np.testing.assert_array_equal(found, expected)
        assert tracer._caster.session.is_closed


class TestTrimesh:
    def test_threads_share_an_engine_that_is_closed_again_and_again(self):
        mesh = trimesh.creation.icosphere(subdivisions=3)
        engine = RayMeshIntersector(mesh)
        rays = np.random.default_rng(8).normal(size=(2, 300, 3))
        expected = [engine.intersects_first(*rays), *engine.intersects_id(*rays), engine.contains_points(rays[0])]
        is_over = threading.Event()

        def trace():
            for _ in range(10):
                found = [engine.intersects_first(*rays), *engine.intersects_id(*rays), engine.contains_points(rays[0])]
                for obtained, wanted in zip(found, expected, strict=True):
                    np.testing.assert_array_equal(obtained, wanted)

        def close():
            while not is_over.wait(0.02):
                engine.close()

        closer = threading.Thread(target=close)
        closer.start()
        try:
            run_in_threads(*[trace] * THREADS)
        finally:
            is_over.set()
            closer.join()


def list_arrays(arrays):
    return list(arrays)


class TestPool:
    def test_builds_of_several_threads_take_turns(self, mesh, bvh):
        with SubtreePool(2) as pool:
            built = run_in_threads(*[lambda: build(mesh, pool=pool, task_threshold=500)] * 4)
        for tree in built:
            assert tree.nodes.tobytes() == bvh.nodes.tobytes()
            assert tree.prim_ids.tobytes() == bvh.prim_ids.tobytes()

    def test_closing_waits_for_a_build_of_another_thread(self, mesh):
        pool = SubtreePool(2)
        is_held, order = threading.Event(), []

        def hold():
            with open_executor(pool) as executor:
                is_held.set()
                time.sleep(0.2)
                executor.run_on_each(list_arrays)  # the workers still answer
                order.append("built")

        def close():
            assert is_held.wait(PATIENCE_S)
            pool.close()
            order.append("closed")

        run_in_threads(hold, close, close)
        assert order == ["built", "closed", "closed"]
        with pytest.raises(PoolError, match="the pool is closed"):
            build(mesh, pool=pool, task_threshold=500)

    def test_a_build_that_waited_while_the_pool_was_closed_is_refused(self, mesh):
        pool = SubtreePool(2)
        is_held = threading.Event()

        def hold():
            with open_executor(pool):
                is_held.set()
                time.sleep(0.2)
                pool.close()

        def late():
            assert is_held.wait(PATIENCE_S)
            with pytest.raises(PoolError, match="the pool is closed"):
                build(mesh, pool=pool, task_threshold=500)

        run_in_threads(hold, late)


def test_pictures_of_several_threads_have_the_bytes_of_one():
    scene, view = Scene(make_shape("knot", triangles=2000)), View(width=120, height=90)
    options = [RenderOptions(layout=layout) for layout in ("bvh2", "bvh8")]
    expected = [render(scene, view, option) for option in options]
    pictures = run_in_threads(*(lambda option=option: render(scene, view, option) for option in options * 3))
    for picture, wanted in zip(pictures, expected * 3, strict=True):
        assert picture.rgb.tobytes() == wanted.rgb.tobytes()
        assert picture.hits.prim_id.tobytes() == wanted.hits.prim_id.tobytes()


def test_sessions_of_a_device_share_its_context_and_its_kernels(session, bvh):
    with Tracer(bvh, device=session.info) as one, Tracer(bvh, device=session.info) as other:
        assert one._caster.session.context is other._caster.session.context
        assert run_in_threads(*[lambda: one._caster.kernel("closest_hit")] * THREADS + [
            lambda: other._caster.kernel("closest_hit")
        ]) == [one._caster.kernel("closest_hit")] * (THREADS + 1)  # fmt: skip
        assert isinstance(one._caster.session, DeviceSession)


_FIRST_USE = """
import threading
import numpy as np
import clbvh

meeting, answers = threading.Barrier(8), []

def use():
    meeting.wait()
    mesh = clbvh.make_shape("icosphere", triangles=320)
    with clbvh.Tracer(clbvh.build(mesh)) as tracer:
        answers.append(tracer.all_hits([[0.1, 0.2, 5]], [[0, 0, -1]]).prim_id.tobytes())

threads = [threading.Thread(target=use) for _ in range(8)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print(len(answers), len(set(answers)))
"""


def test_the_first_use_may_be_in_several_threads_at_once():
    ran = subprocess.run([sys.executable, "-c", _FIRST_USE], capture_output=True, text=True, timeout=PATIENCE_S)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "8 1\n", "")
