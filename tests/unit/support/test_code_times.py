"""Time for code counts once, whatever is nested and whichever threads it is in, and is no part of a phase."""

from __future__ import annotations

import os
import threading
import time

import pytest

from clbvh.support import code_times
from clbvh.support.code_times import CompilingCode, LoadingCode, announce_compilation, read_code_times
from clbvh.support.stopwatch import Stopwatch

MS = 1e-3


@pytest.fixture(autouse=True)
def clock(monkeypatch):
    """A clock that a test moves by hand, and sums that begin at zero."""

    class Clock:
        now_s = 0.0

        def wait(self, ms):
            self.now_s += ms * MS

    moved = Clock()
    monkeypatch.setattr(code_times, "time", moved)
    moved.perf_counter = lambda: moved.now_s
    monkeypatch.setattr(code_times, "_clock", code_times._Clock())
    monkeypatch.setattr(code_times, "_listeners", [])
    return moved


def sums():
    compile_ms, load_ms, compiled, loaded = read_code_times()
    return round(compile_ms, 6), round(load_ms, 6), compiled, loaded


def test_what_is_nested_counts_once(clock):
    with CompilingCode():
        clock.wait(10)
        with LoadingCode() as loading:
            clock.wait(5)
            loading.is_loaded = True
        with CompilingCode():
            clock.wait(20)
    clock.wait(100)
    assert sums() == (35, 0, 2, 1)


def test_what_is_compiled_inside_of_a_load_is_no_load(clock):
    with LoadingCode():
        clock.wait(3)
        with CompilingCode():
            clock.wait(7)
        clock.wait(1)
    assert sums() == (7, 4, 1, 0)


def test_threads_that_compile_at_once_count_once(clock):
    opened, go_on = threading.Barrier(3), threading.Barrier(3)

    def compile_something():
        with CompilingCode():
            opened.wait()
            go_on.wait()

    threads = [threading.Thread(target=compile_something) for _ in range(2)]
    for thread in threads:
        thread.start()
    opened.wait()
    clock.wait(8)
    assert sums() == (8, 0, 0, 0)  # also before it ends
    go_on.wait()
    for thread in threads:
        thread.join()
    assert sums() == (8, 0, 2, 0)


def test_a_load_that_was_a_compilation_counts_as_one_without_what_else_it_did(clock):
    with LoadingCode() as loading:
        clock.wait(50)
        loading.apart_ms = 20.0
        loading.is_compiled = True
    assert sums() == (30, 0, 1, 0)
    with LoadingCode() as loading:
        clock.wait(5)
        loading.apart_ms = 7.0  # by another clock
    assert sums() == (30, 0, 1, 0)


def test_a_failed_compilation_takes_time_and_compiles_nothing(clock):
    def fail():
        with CompilingCode():
            clock.wait(2)
            raise ValueError("bad")

    with pytest.raises(ValueError, match="bad"):
        fail()
    assert sums() == (2, 0, 0, 0)


def test_the_first_compilation_is_told_once():
    told = []
    code_times.on_first_compilation(lambda: told.append(1))
    with LoadingCode():
        assert told == []
    for _ in range(2):
        with CompilingCode():
            assert told == [1]
    announce_compilation()
    code_times.on_first_compilation(lambda: told.append(2))
    code_times.on_first_compilation(None)
    announce_compilation()
    assert told == [1]


def test_laps_are_without_the_time_for_code(clock, monkeypatch):
    monkeypatch.setattr("clbvh.support.stopwatch.time", clock)
    watch = Stopwatch()
    clock.wait(4)
    with CompilingCode():
        clock.wait(30)
    watch.lap("build")
    with LoadingCode():
        clock.wait(6)
    clock.wait(1)
    watch.lap("trace")
    assert {name: round(ms, 6) for name, ms in watch.laps_ms.items()} == {"build": 4, "trace": 1}
    assert {name: round(ms, 6) for name, ms in watch.code_ms.items()} == {"compile": 30, "load_code": 6}
    assert watch.total_ms == pytest.approx(41)
    assert watch.total_ms == pytest.approx(sum(watch.laps_ms.values()) + sum(watch.code_ms.values()))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_a_forked_child_goes_on(monkeypatch):
    """A thread of the parent holds the lock when the child is forked, and does not exist there."""
    monkeypatch.undo()
    with code_times._clock.lock:
        child = os.fork()
        if child == 0:
            ended = threading.Thread(target=lambda: os._exit(0 if read_code_times() else 1))
            ended.start()
            time.sleep(20)
            os._exit(2)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
