"""Steps in several threads."""

from __future__ import annotations

import threading

import pytest

from clbvh.build.threads import run_in_threads


def test_results_are_in_the_order_of_the_tasks():
    assert run_in_threads(lambda a, b: a - b, [(5, 1), (3, 2), (1, 1)]) == [4, 1, 0]


def test_one_task_runs_here():
    assert run_in_threads(threading.current_thread, [()]) == [threading.current_thread()]


def test_all_tasks_run_at_the_same_time():
    meeting = threading.Barrier(3)
    assert sorted(run_in_threads(lambda: meeting.wait(timeout=30), [(), (), ()])) == [0, 1, 2]


def test_an_error_arrives():
    with pytest.raises(ZeroDivisionError):
        run_in_threads(lambda number: 1 / number, [(1,), (0,)])
