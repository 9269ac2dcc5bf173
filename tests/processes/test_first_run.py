"""A first run says that it compiles; a second run says nothing."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from clbvh.device.select import list_devices

from ..cli.command import FIRST_RUN, make_environment, run_process

OFF = "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"


@pytest.fixture
def cold(tmp_path):
    """The environment of a machine on which nothing has been compiled."""
    (tmp_path / "pocl").mkdir()
    return {
        "CLBVH_CACHE": str(tmp_path / "cache"),
        "NUMBA_CACHE_DIR": str(tmp_path / "numba"),
        "POCL_CACHE_DIR": str(tmp_path / "pocl"),
        "XDG_CACHE_HOME": str(tmp_path),
    }


def test_a_first_run_compiles_and_a_second_one_loads(tmp_path, cold):
    if not list_devices():
        pytest.skip("no OpenCL device")
    (tmp_path / "mesh.off").write_text(OFF)
    size = ("--width", 64, "--height", 48)
    arguments = ("render", tmp_path / "mesh.off", "-o", tmp_path / "out.ppm", *size, "--up", "0,1,0", "--json")
    first, second = (run_process(*arguments, **cold) for _ in range(2))
    assert (first.returncode, first.stderr, first.compiled) == (0, "", True)
    assert (second.returncode, second.stderr, second.compiled) == (0, "", False)
    for answer in (first, second):
        times = json.loads(answer.stdout)["timings_ms"]
        parts = sum(times[name] for name in times if name not in ("total", "write"))
        assert parts == pytest.approx(times["total"])


def test_the_line_is_said_at_once_and_on_stderr_alone(tmp_path, cold):
    (tmp_path / "mesh.off").write_text(OFF)
    answer = run_process("stats", tmp_path / "mesh.off", "--json", **cold)
    assert answer.compiled
    assert FIRST_RUN not in answer.stdout
    timings_ms = json.loads(answer.stdout)["build"]["timings_ms"]
    parts = sum(ms for name, ms in timings_ms.items() if name != "total")
    assert parts == pytest.approx(timings_ms["total"])


def test_python_says_it_too(tmp_path, cold):
    process = subprocess.run(
        [sys.executable, "-c", "import clbvh; clbvh.build(clbvh.make_shape('icosphere', triangles=20))"],
        capture_output=True,
        text=True,
        env=make_environment(**cold),
        check=True,
    )
    assert process.stderr.count(FIRST_RUN) == 1
