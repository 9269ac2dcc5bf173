"""`perf stat`: its answers are read, and its absence is said."""

from __future__ import annotations

import os
import stat
import subprocess
import sys

import pytest

from clbvh.study import machine
from clbvh.study.machine import EVENTS, count_build, find_counter_problem
from clbvh.study.samples import NotMeasuredError

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="perf is Linux's")

# A perf that counts as many instructions as the last word of the command says, for each build and once for the start.
COUNTING = """#!/bin/sh
for last; do :; done
case "$last" in [0-9]*) builds=$last;; *) builds=0;; esac
echo "# started on some day" >&2
echo "$((1000 + 500 * builds)),,instructions:u,1,100.00,," >&2
echo "$((10 + 7 * builds)),,cache-misses,1,100.00,," >&2
"""
BLIND = """#!/bin/sh
echo "<not supported>,,instructions,0,100.00,," >&2
echo "12,,cache-misses,1,100.00,," >&2
"""
FAILING = "#!/bin/sh\necho 'no permission' >&2\nexit 1\n"


@pytest.fixture(autouse=True)
def forgotten():
    find_counter_problem.cache_clear()
    yield
    find_counter_problem.cache_clear()


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Return a function that makes a script the machine's perf."""

    def install(script):
        path = tmp_path / "perf"
        path.write_text(script)
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}/usr/bin{os.pathsep}/bin")

    return install


def test_the_start_of_python_does_not_count(install):
    install(COUNTING)
    assert find_counter_problem() == ""
    assert count_build("knot-1000", "flat") == {"instructions": 500, "cache_misses": 7}
    assert set(EVENTS.values()) == {"instructions", "cache_misses"}


def test_a_machine_without_counters(install):
    install(BLIND)
    assert find_counter_problem() == "perf does not count instructions on this machine"


def test_a_perf_that_fails(install):
    install(FAILING)
    assert find_counter_problem().startswith("perf stat fails")
    with pytest.raises(NotMeasuredError, match="perf stat fails"):
        count_build("knot-1000", "flat")


def test_no_perf(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert find_counter_problem() == "perf is not installed"


def test_the_counted_process_builds():
    command = [sys.executable, "-c", machine._BUILD, "knot-1000", "flat", "1"]
    subprocess.run(command, check=True, timeout=120)
