"""Arrays by name and steps on them, in threads and in the workers of a pool."""

from __future__ import annotations

import os
import threading
import time

import numpy as np
import pytest

from clbvh import SubtreePool
from clbvh.builders.executor import ThreadExecutor
from clbvh.builders.processes.pool import open_executor


@pytest.fixture(scope="module")
def pool():
    with SubtreePool(workers=2) as pool:
        yield pool


@pytest.fixture(params=["one thread", "threads", "processes"])
def executor(request, pool):
    kinds = {
        "one thread": lambda: ThreadExecutor(1),
        "threads": lambda: ThreadExecutor(2),
        "processes": lambda: open_executor(pool),
    }
    with kinds[request.param]() as executor:
        yield executor


def add(arrays, name, number):
    arrays[name] += number
    return number


def list_names(arrays):
    return sorted(arrays)


def total(arrays, name):
    return float(arrays[name].sum())


def sleep_and_tell(arrays, seconds):
    time.sleep(seconds)
    return os.getpid(), threading.get_ident()


def test_a_step_sees_and_changes_the_arrays(executor):
    created = executor.create("created", (3,), np.int64)
    created[:] = 0
    executor.share("shared", np.full(5, 2.0))
    executor.map(add, [("created", 1)])
    assert executor.map(add, [("created", 2)]) == [2]
    assert executor.map(total, [("created",), ("shared",)]) == [9, 10]
    assert created.tolist() == [3, 3, 3]
    assert set(map(tuple, executor.run_on_each(list_names))) == {("created", "shared")}
    executor.discard("shared")
    assert executor.map(list_names, [()]) == [["created"]]


def test_results_of_many_tasks_come_in_their_order(executor):
    executor.create("sum", (1,), np.int64)
    assert executor.map(add, [("sum", number) for number in range(300)]) == list(range(300))
    assert executor.map(add, []) == []


def test_all_workers_take_part_and_a_free_one_takes_the_next_task(executor):
    executor.map(sleep_and_tell, [(0.1,)] * 2)  # every process has imported this module
    who = executor.map(sleep_and_tell, [(1,), (0,), (0,), (0,), (0,)])
    assert len(set(who)) == executor.workers
    if executor.workers > 1:
        assert who.count(who[0]) == 1


def test_a_step_runs_once_in_every_process(executor):
    workers = executor.run_on_each(sleep_and_tell, 0)
    if isinstance(executor, ThreadExecutor):
        assert workers == [(os.getpid(), threading.get_ident())]
    else:
        assert len(workers) == executor.workers
        assert os.getpid() not in [process for process, _ in workers]


def test_arrays_outlive_the_build_and_workers_let_go_of_them(pool):
    kept = []
    for number in range(2):
        with open_executor(pool) as executor:
            kept.append(executor.create("array", (3,), np.int64))
            kept[-1][:] = number
            assert executor.map(total, [("array",)]) == [3 * number]
    assert [array.tolist() for array in kept] == [[0, 0, 0], [1, 1, 1]]
    with open_executor(pool) as executor:
        assert executor.run_on_each(list_names) == [[], []]


def test_a_shared_array_may_be_read_only(executor):
    array = np.arange(3)
    array.flags.writeable = False
    executor.share("array", array)
    assert executor.arrays["array"].flags.writeable
    assert executor.map(total, [("array",)]) == [3]
