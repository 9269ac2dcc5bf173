"""Compiled loops in several threads."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from clbvh.support import host_threads
from clbvh.support.host_threads import HostThreads


@pytest.fixture(params=[1, 2, 5])
def threads(request):
    with HostThreads(request.param) as opened:
        yield opened


def test_results_are_in_the_order_of_the_tasks(threads):
    assert threads.run(lambda a, b: a - b, [(10 * number, number) for number in range(20)]) == list(range(0, 180, 9))
    assert threads.run(len, []) == []


def test_one_task_runs_here(threads):
    assert threads.run(threading.current_thread, [()]) == [threading.current_thread()]


def test_as_many_tasks_as_threads_run_at_the_same_time():
    meeting = threading.Barrier(3)
    with HostThreads(3) as threads:
        assert sorted(threads.run(lambda: meeting.wait(timeout=30), [(), (), ()])) == [0, 1, 2]


@pytest.mark.parametrize("bad", [0, 1, 3])
def test_an_error_arrives_after_all_have_ended(threads, bad):
    ended = []

    def divide(number):
        result = 1 / (number - bad)
        ended.append(number)
        return result

    with pytest.raises(ZeroDivisionError):
        threads.run(divide, [(number,) for number in range(4)])
    before = len(ended)
    assert threads.run(divide, [(bad + 1,)]) == [1]
    assert len(ended) == before + 1


@pytest.mark.parametrize("row_count", [0, 1, 99, 100, 1001])
def test_ranges_cover_all_rows_once(threads, monkeypatch, row_count):
    monkeypatch.setattr(host_threads, "_LEAST_ITEMS", 10)
    seen = np.zeros(row_count, int)

    def count(begin, end):
        seen[begin:end] += 1

    threads.for_ranges(row_count, count)
    assert (seen == 1).all()


def test_it_works_again_after_it_was_closed(threads):
    threads.run(abs, [(1,), (2,), (3,)])
    threads.close()
    threads.close()
    assert threads.run(abs, [(-1,), (-2,), (-3,)]) == [1, 2, 3]
