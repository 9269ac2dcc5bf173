"""Threads that share a tracer that changes, or arrays on a device: each answer is right, and the process lives."""

import subprocess
import sys

import pytest

from ..profiles import is_long


@pytest.mark.parametrize("what", ["updates", "arrays"])
def test_threads_share(what):
    script = [sys.executable, "-m", "tests.processes.sharing", what, "60" if is_long() else "4"]
    ran = subprocess.run(script, capture_output=True, text=True, timeout=600)
    assert ran.returncode == 0, ran.stderr[-2000:]
