"""A message that stops half-way blocked the coordinator for ever.

One to a stopped worker that is longer than the pipe's buffer; and one from a worker that is stopped while it writes.
"""

from __future__ import annotations

import gc
import os
import signal
import struct
import threading
from multiprocessing.connection import Connection

import pytest

from clbvh import SubtreePool
from clbvh.errors import PoolError

TIMEOUT_S = 1.5
LONGER_THAN_ANY_BUFFER = 1 << 23


def count_bytes(arrays, data):
    return len(data)


def make_bytes(arrays, size):
    return bytes(size)


def stop_within_the_answer(arrays):
    """Send the length of an answer, and not the answer."""
    connection = next(thing for thing in gc.get_objects() if isinstance(thing, Connection) and not thing.closed)
    os.write(connection.fileno(), struct.pack("!i", 1000))
    os.kill(os.getpid(), signal.SIGSTOP)


def stop_workers_that_hang(pool):
    """Kill the workers after a while, so that this test fails where it would otherwise hang."""
    alarm = threading.Timer(20, lambda: [process.kill() for process in pool._processes])
    alarm.start()
    return alarm


def test_a_long_task_for_a_stopped_worker_is_an_error():
    with SubtreePool(workers=1, timeout_s=TIMEOUT_S) as pool:
        pool.wait_ready()
        alarm = stop_workers_that_hang(pool)
        os.kill(pool._processes[0].pid, signal.SIGSTOP)
        with pytest.raises(PoolError, match="has not answered"):
            pool.map(count_bytes, [(bytes(LONGER_THAN_ANY_BUFFER),)])
        alarm.cancel()
        alarm.join()


def test_half_an_answer_is_an_error():
    with SubtreePool(workers=1, timeout_s=TIMEOUT_S) as pool:
        pool.wait_ready()
        alarm = stop_workers_that_hang(pool)
        with pytest.raises(PoolError, match="has not answered"):
            pool.map(stop_within_the_answer, [()])
        alarm.cancel()
        alarm.join()


def test_long_tasks_and_long_results_pass_where_nothing_hangs():
    with SubtreePool(workers=1, timeout_s=20) as pool:
        assert pool.map(count_bytes, [(bytes(LONGER_THAN_ANY_BUFFER),)]) == [LONGER_THAN_ANY_BUFFER]
        assert len(pool.map(make_bytes, [(LONGER_THAN_ANY_BUFFER,)])[0]) == LONGER_THAN_ANY_BUFFER
