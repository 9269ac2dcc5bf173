"""A first run says that it compiles, and counts that apart; a second run says nothing."""

from __future__ import annotations

import json

import pytest

from clbvh.device.select import list_devices

from .command import FIRST_RUN, run_process

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
    times = [json.loads(answer.stdout)["timings_ms"] for answer in (first, second)]
    assert times[0]["compile"] > 20 * times[0]["build"]
    assert times[0]["compile"] > times[1]["total"]
    assert times[1]["compile"] == 0 < times[1]["load_code"]
    for one in times:
        parts = sum(one[name] for name in one if name not in ("total", "write"))
        assert parts == pytest.approx(one["total"])
    assert max(times[0]["build"], times[0]["layout"], times[0]["open"]) < times[0]["compile"] / 5


def test_the_line_is_said_at_once_and_on_stderr_alone(tmp_path, cold):
    (tmp_path / "mesh.off").write_text(OFF)
    answer = run_process("stats", tmp_path / "mesh.off", "--json", **cold)
    assert answer.compiled
    assert FIRST_RUN not in answer.stdout
    timings_ms = json.loads(answer.stdout)["build"]["timings_ms"]
    assert timings_ms["compile"] > 20 * timings_ms["build"]
    parts = sum(ms for name, ms in timings_ms.items() if name != "total")
    assert parts == pytest.approx(timings_ms["total"])


def test_where_nothing_can_be_kept_it_is_no_first_run(monkeypatch, capsys):
    from clbvh.cli import first_run

    first_run.say_first_run()
    assert "first run only" in capsys.readouterr().err
    monkeypatch.setattr("clbvh.support.cache_folder.is_writable", lambda folder: False)
    first_run.say_first_run()
    assert capsys.readouterr().err == f"{FIRST_RUN}\n"
