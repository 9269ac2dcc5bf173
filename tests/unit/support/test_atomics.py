"""Additions that no other thread divides."""

from __future__ import annotations

import numba
import numpy as np

from clbvh.support.host_threads import HostThreads
from clbvh.support.loop_functions import add_atomically

TIMES = 200_000


@numba.njit(nogil=True)
def take_many(counter, amount, taken):
    for index in range(len(taken)):
        taken[index] = add_atomically(counter, amount)


def test_it_returns_what_was_there():
    counter, taken = np.array([5, 7]), np.empty(3, np.int64)
    take_many(counter, -2, taken)
    assert taken.tolist() == [5, 3, 1]
    assert counter.tolist() == [-1, 7]


def test_it_is_one_instruction():
    # Threads that happen to run one after the other would not notice the difference.
    take_many(np.zeros(1, np.int64), 1, np.empty(0, np.int64))
    (code,) = take_many.inspect_llvm().values()
    assert "atomicrmw add" in code


def test_no_two_threads_get_the_same_number():
    counter, taken = np.zeros(8, np.int64), np.empty((4, TIMES), np.int64)
    with HostThreads(4) as threads:
        threads.run(take_many, [(counter, 1, row) for row in taken])
    assert counter[0] == taken.size
    assert (np.bincount(taken.ravel()) == 1).all()
