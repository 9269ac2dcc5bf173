"""Ctrl-C in the middle of queries and changes: no lock stays taken, no buffer is lost, the next answers are right."""

import json
import subprocess
import sys

import pytest

from ..profiles import is_long, seeds

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="interrupts by the timer of Unix")

# Interrupts of a short run, and the most buffers that are held: a query's; the mesh and what its next update and points
# need; the scene, and nodes and blocks for its next shape. A tree is refitted by six buffers.
KINDS = {"queries": (60, 4), "vertices": (200, 5 + 6), "scene": (200, 4 + 2 + 6)}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", seeds(1))
def test_interrupts_leave_the_state_before_or_after_them(kind, seed):
    count, most_buffers = KINDS[kind]
    count *= 10 if is_long() else 1
    script = [sys.executable, "-m", "tests.processes.interrupting", kind, str(seed), str(count)]
    ran = subprocess.run(script, capture_output=True, text=True, timeout=1800, check=False)
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout)
    assert found.pop("interrupted") > count // 10
    assert found.pop("buffers") <= most_buffers
    assert found.pop("idle", 0) <= 1
    assert found == {"wrong": 0, "right": True, "loans": 0}
