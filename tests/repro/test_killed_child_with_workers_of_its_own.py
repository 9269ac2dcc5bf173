"""A child process inherits multiprocessing's settings: its workers removed the parent's folder when it was killed."""

from __future__ import annotations

import multiprocessing
import sys
import time
from pathlib import Path

import pytest

from clbvh import SubtreePool

PATIENCE_S = 60


def open_pool_and_wait(connection):
    with SubtreePool(1) as pool:
        pool.wait_ready()
        connection.send([process.pid for process in pool._processes])
        time.sleep(PATIENCE_S)


@pytest.mark.skipif(sys.platform == "win32", reason="no sockets there")
def test_the_parents_folder_stays():
    with SubtreePool(1) as pool:
        pool.wait_ready()
        folder = Path(multiprocessing.current_process()._config["tempdir"])
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        child = context.Process(target=open_pool_and_wait, args=(theirs,))
        child.start()
        assert ours.poll(PATIENCE_S)
        (worker,) = ours.recv()
        child.kill()
        child.join()
        # Its worker notices within a second or two, and leaves.
        deadline = time.monotonic() + PATIENCE_S
        while Path(f"/proc/{worker}").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        assert folder.is_dir()
        with SubtreePool(1) as another:
            another.wait_ready()
