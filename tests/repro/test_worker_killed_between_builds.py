"""A worker that died while it had nothing to do surfaced as a bare BrokenPipeError."""

from __future__ import annotations

import os
import signal

import pytest

from clbvh import SubtreePool
from clbvh.errors import PoolError


def test_the_next_use_of_the_pool_says_which_worker_died():
    with SubtreePool(workers=2) as pool:
        pool.wait_ready()
        process = pool._workers[1].process
        os.kill(process.pid, signal.SIGKILL)
        process.join()
        with pytest.raises(PoolError, match=r"worker 1 died \(exit code -9\)"):
            pool.wait_ready()
