"""Arrays by name and steps on them, in the calling process and in the workers of a pool."""

from __future__ import annotations

import os

import numpy as np
import pytest

from clbvh import SubtreePool
from clbvh.builders.workers.executor import CallingProcess, open_executor


@pytest.fixture(scope="module")
def pool():
    with SubtreePool(workers=2) as pool:
        yield pool


@pytest.fixture(params=["calling process", "pool"])
def executor(request, pool):
    with open_executor(pool if request.param == "pool" else None) as executor:
        yield executor


def add(arrays, name, number):
    arrays[name] += number
    return number


def list_names(arrays):
    return sorted(arrays)


def total(arrays, name):
    return float(arrays[name].sum())


def process(arrays):
    return os.getpid()


def test_a_step_sees_and_changes_the_arrays(executor):
    created = executor.create("created", (3,), np.int64)
    assert created.tolist() == [0, 0, 0]
    borrowed = executor.borrow("borrowed", (2, 2), np.float32)
    borrowed[:] = 1
    executor.share("shared", np.full(5, 2.0))
    assert executor.map(add, [("created", 1), ("created", 2)]) == [1, 2]
    assert executor.map(total, [("borrowed",), ("shared",)]) == [4, 10]
    assert created.tolist() == [3, 3, 3]
    assert set(map(tuple, executor.run_on_each(list_names))) == {("borrowed", "created", "shared")}
    executor.discard("created", "shared")
    assert executor.map(list_names, [()]) == [["borrowed"]]


def test_results_of_many_tasks_come_in_their_order(executor):
    executor.create("sum", (1,), np.int64)
    assert executor.map(add, [("sum", number) for number in range(300)]) == list(range(300))
    assert executor.map(add, []) == []


def test_a_step_runs_once_on_every_worker(executor):
    workers = executor.run_on_each(process)
    assert len(workers) == executor.workers
    assert (os.getpid() in workers) == isinstance(executor, CallingProcess)


def test_arrays_that_were_kept_or_created_outlive_the_build(pool):
    for number in range(2):
        with open_executor(pool) as executor:
            executor.borrow("borrowed", (3,), np.int64)[:] = number
            executor.share("created", np.full(3, number))
            kept, created = executor.keep("borrowed"), executor.arrays["created"]
        with open_executor(pool) as executor:
            executor.borrow("borrowed", (3,), np.int64)[:] = 9
        assert kept.tolist() == created.tolist() == [number] * 3


def test_a_shared_array_may_be_read_only():
    array = np.arange(3)
    array.flags.writeable = False
    with open_executor(None) as executor:
        executor.share("array", array)
        assert executor.arrays["array"].flags.writeable
        assert executor.map(total, [("array",)]) == [3]


def test_workers_keep_only_what_the_next_build_may_use(pool):
    with open_executor(pool) as executor:
        executor.borrow("borrowed", (3,), np.int64)
        executor.create("created", (3,), np.int64)
        executor.map(list_names, [()])
    assert pool.map(list_names, [()] * 2) == [["borrowed"]] * 2
