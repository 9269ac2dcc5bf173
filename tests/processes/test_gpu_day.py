"""The day of a GPU, `.ci/gpu_day.py`, on PoCL in a GPU's place: its page, and a driver that refuses every kernel."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from clbvh.builders.ladder.variants import VARIANTS
from clbvh.tree_layouts import TREE_LAYOUTS

from ..cli.command import TIMEOUT_S, make_environment

SCRIPT = Path(__file__).parents[2] / ".ci" / "gpu_day.py"

pytestmark = pytest.mark.usefixtures("session")


def run_day(folder, *steps, **variables):
    """Run steps, and return the process and what it has found."""
    command = [sys.executable, SCRIPT, *steps, "--device", "pocl", "--small", "--folder", folder]
    done = subprocess.run(
        command, env=make_environment(**variables), capture_output=True, text=True, timeout=TIMEOUT_S, check=False
    )
    return done, json.loads((folder / "gpu-day.json").read_text())


def test_a_day_has_rays_builds_kernels_and_the_study(tmp_path):
    folder = tmp_path / "day"
    done, day = run_day(folder, "rays", "builds", "ladder")
    assert done.returncode == 0, done.stderr
    rays, builds = (day["steps"][name]["rows"] for name in ("rays", "builds"))
    assert len(rays) == len(TREE_LAYOUTS) * 3
    assert all(value > 0 for row in rays + builds for value in row.values() if isinstance(value, float))
    page = (folder / "gpu-day.md").read_text()
    assert day["device"]["kind"] == "cpu"  # what the driver says, whatever the steps take it for
    assert [name for name in (day["device"]["name"], *TREE_LAYOUTS, *VARIANTS) if name not in page] == []
    again = subprocess.run([sys.executable, SCRIPT, "--folder", folder], capture_output=True, text=True, check=False)
    assert (again.returncode, "has another day" in again.stderr) == (1, True)


def test_a_day_goes_on_where_a_driver_refuses_and_says_what(tmp_path):
    refused = {"PYOPENCL_BUILD_OPTIONS": "-no-such-option", "PYOPENCL_NO_CACHE": "1"}
    done, day = run_day(tmp_path / "day", "conformance", "builds", "trees", **refused)
    assert done.returncode == 1
    problems = [step["problem"] for step in day["steps"].values()]
    assert len(problems) == 3
    assert all("does not compile" in problem for problem in problems), problems
    assert "Not measured" in (tmp_path / "day" / "gpu-day.md").read_text()
