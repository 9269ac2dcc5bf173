"""What is done again and again leaves nothing behind: memory, handles, threads and files stay flat."""

import json
import os
import subprocess
import sys

import pytest

from ..profiles import is_long

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")

# Repetitions in a short run, after a warm-up, and in a long one.
COUNTS = {
    "tracers": (20, 60, 1000),
    "unclosed_tracers": (20, 60, 1000),
    "builds": (20, 100, 1000),
    "queries": (100, 1000, 100_000),
    "moves": (100, 1000, 100_000),
    "deformations": (20, 100, 10_000),
    "pictures": (20, 60, 1000),
    "frames": (100, 1000, 100_000),
    "unclosed_renderers": (20, 60, 1000),
    "pools": (5, 6, 300),
}

# The parts of memory that an allocator keeps. A tracer used to leave 1.2 MiB behind, 72 MiB in a short run.
MOST_MIB = 12.0


@pytest.mark.parametrize("work", COUNTS)
def test_repetition_leaves_nothing_behind(work, tmp_path):
    warm_up, short, long = COUNTS[work]
    script = [sys.executable, "-m", "tests.processes.growing", work, str(warm_up), str(long if is_long() else short)]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    ran = subprocess.run(script, capture_output=True, text=True, timeout=3600, env=environment, check=True)
    growth = json.loads(ran.stdout)
    assert growth.pop("MiB") < MOST_MIB
    assert growth == {"handles": 0, "threads": 0, "files": 0}
