"""Children of a process in which the engine for trimesh is installed."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows does not fork")

OURS = ["RayMeshIntersector", "clbvh", True]


@pytest.mark.parametrize("start", ["spawn", "forkserver", "fork before", "fork after"])
def test_a_new_process_installs_for_itself_and_a_forked_one_has_the_engine(start):
    script = [sys.executable, "-W", "ignore::DeprecationWarning", "-m", "tests.processes.trimesh_children", start]
    finished = subprocess.run(script, capture_output=True, text=True, timeout=300, check=False)
    assert finished.returncode == 0, finished.stderr
    answers = json.loads(finished.stdout)
    if start == "fork after":  # the first query
        assert answers[0] == "DeviceError"
        assert "forked" in answers[1]
    elif start == "fork before":
        assert answers == OURS
    else:
        assert answers.pop("as loaded")[1] == "trimesh"
        # An engine that was assigned by hand comes along.
        assert answers == {"by hand": OURS, "installed": OURS}
