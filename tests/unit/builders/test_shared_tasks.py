"""Tasks that workers take by themselves, from a counter in shared memory."""

from __future__ import annotations

import os
import signal
import time

import numpy as np
import pytest

from clbvh import SubtreePool
from clbvh.builders.workers.arena import Arena
from clbvh.errors import PoolError


def echo(arrays, value):
    return value


def mark(arrays, index):
    arrays["marks"][index] += 1
    return os.getpid()


def sleep_and_tell(arrays, seconds):
    time.sleep(seconds)
    return os.getpid()


def stop_or_echo(arrays, stops):
    if stops:
        os.kill(os.getpid(), signal.SIGSTOP)


def fail_at(arrays, number):
    if number == 3:
        raise ValueError("the word is swordfish")


@pytest.fixture(scope="module")
def pool():
    """Two workers, which have imported this module."""
    with SubtreePool(workers=2) as pool:
        pool.map(echo, [(0,)] * 2)
        yield pool


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5000])
def test_each_task_is_done_once_and_results_come_in_their_order(pool, count):
    assert pool.share_out(echo, [(number,) for number in range(count)]) == list(range(count))
    with Arena() as arena:
        handle, marks = arena.create((max(count, 1),), np.int64)
        pool.attach({"marks": handle})
        workers = pool.share_out(mark, [(number,) for number in range(count)])
        pool.attach({})
        assert marks[:count].tolist() == [1] * count
    assert os.getpid() not in workers


def test_a_free_worker_takes_the_next_task(pool):
    workers = pool.share_out(sleep_and_tell, [(1,), (0.05,), (0.05,), (0.05,), (0.05,)])
    assert workers.count(workers[0]) == 1
    assert len(set(workers)) == 2


def test_an_error_in_one_of_many_tasks_arrives_with_its_traceback():
    with (
        SubtreePool(workers=2) as pool,
        pytest.raises(PoolError, match=r"(?s)worker \d failed:.*in fail_at\n.*ValueError: the word is swordfish"),
    ):
        pool.share_out(fail_at, [(number,) for number in range(10)])


def test_a_worker_with_many_tasks_is_not_silent_while_it_takes_the_next():
    with SubtreePool(workers=1) as pool:
        pool.map(echo, [(0,)])
        pool._timeout_s = 1.5
        assert len(pool.share_out(sleep_and_tell, [(0.5,)] * 6)) == 6


def test_a_worker_that_stops_within_its_tasks_is_an_error_after_the_timeout():
    with SubtreePool(workers=2) as pool:
        pool.map(echo, [(0,)] * 2)
        pool._timeout_s = 0.5
        with pytest.raises(PoolError, match=r"worker [01] has not answered for 0.5 s and was stopped"):
            pool.share_out(stop_or_echo, [(False,)] * 10 + [(True,)] + [(False,)] * 10)


def test_the_same_arrays_are_attached_once(pool, monkeypatch):
    sent = []
    send = pool._send
    with Arena() as arena:
        handle, other = (arena.create((3,), np.int64)[0] for _ in range(2))
        pool.attach({"a": handle})
        monkeypatch.setattr(pool, "_send", lambda worker, message: (sent.append(worker), send(worker, message)))
        pool.attach({"a": handle})
        assert sent == []
        pool.attach({"a": other})
        assert sent == [0, 1]
        pool.attach({})
        assert sent == [0, 1, 0, 1]
