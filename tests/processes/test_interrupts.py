"""Ctrl-C in the middle of queries: no lock stays taken, no buffer is lost, and the next answers are right."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from ..profiles import is_long, seeds

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="interrupts by the timer of Unix")

COUNT = 60


@pytest.mark.parametrize("seed", seeds(1))
def test_nothing_is_left_of_interrupted_queries(seed):
    count = 20 * COUNT if is_long() else COUNT
    script = [sys.executable, "-m", "tests.processes.interrupting", str(seed), str(count)]
    ran = subprocess.run(script, capture_output=True, text=True, timeout=1800)
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout)
    assert found.pop("interrupted") > count // 4
    assert found.pop("idle") <= 1
    assert found.pop("most buffers") <= 4
    assert found == {"wrong": 0, "right afterwards": True, "loans": 0}


@pytest.mark.parametrize("seed", seeds(1))
def test_interrupted_updates_leave_the_mesh_before_or_after_them(seed):
    count = 2000 if is_long() else 200
    script = [sys.executable, "-m", "tests.processes.interrupting_updates", str(seed), str(count)]
    ran = subprocess.run(script, capture_output=True, text=True, timeout=1800)
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout)
    assert found.pop("interrupted") > count // 10
    # Nodes and blocks, those of the next update, and what points need.
    assert found == {"wrong": 0, "right afterwards": True, "loans": 0, "buffers": 5}


@pytest.mark.parametrize("seed", seeds(1))
def test_interrupted_changes_leave_the_scene_before_or_after_them(seed):
    count = 2000 if is_long() else 200
    script = [sys.executable, "-m", "tests.processes.interrupting_scenes", str(seed), str(count)]
    ran = subprocess.run(script, capture_output=True, text=True, timeout=1800)
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout)
    assert found.pop("interrupted") > count // 10
    # Those of one scene, and nodes and blocks for its next shape: what an interrupted change has taken goes with it.
    assert found.pop("most buffers") <= 4 + 2
    assert found == {"wrong": 0, "right afterwards": True, "loans": 0}
