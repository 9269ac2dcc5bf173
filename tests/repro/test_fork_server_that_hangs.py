"""A fork server that was stopped before it could start a worker let the coordinator wait for ever."""

from __future__ import annotations

import subprocess
import sys

SCRIPT = """
import os, signal, sys
from multiprocessing import forkserver
import clbvh
from clbvh.errors import PoolError

if __name__ == "__main__":
    with clbvh.SubtreePool(workers=1) as pool:
        pool.wait_ready()
    server = forkserver._forkserver._forkserver_pid
    os.kill(server, signal.SIGSTOP)
    try:
        with clbvh.SubtreePool(workers=1, timeout_s=1) as pool:
            pool.wait_ready()
    except PoolError as error:
        print(error, flush=True)
    finally:
        os.kill(server, signal.SIGKILL)
"""
TIMEOUT_S = 60


def test_it_is_an_error_after_the_limit(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    answer = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    assert answer.stdout == "the worker processes have not started for 1 s\n"
    assert answer.returncode == 0, answer.stderr
