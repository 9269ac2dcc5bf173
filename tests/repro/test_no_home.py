"""A user without an entry or a home, as in containers with `-u 12345`: clbvh ended in a traceback of platformdirs."""

import os
import subprocess
import sys

import pytest

# In the child, since a user of no entry may not run this Python.
HOMELESS = """
import pwd, sys

def find_no_entry(*_):
    raise KeyError("uid not found")

pwd.getpwuid = pwd.getpwnam = find_no_entry
"""
CAST = """
import clbvh
with clbvh.Tracer(([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])) as tracer:
    print(tracer.any_hit([[0.2, 0.2, 1]], [[0, 0, -1]]))
"""
COMMAND = "from clbvh.cli import main; main()"


@pytest.mark.parametrize("has_cache", [True, False])
def test_a_user_without_a_home_had_no_cache_and_no_hits(tmp_path, has_cache):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    dropped = ("HOME", "CLBVH_CACHE", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "_CLBVH_SAID", "POCL_CACHE_DIR")
    environment = {name: value for name, value in os.environ.items() if name not in dropped}
    environment |= {"TMPDIR": str(temporary)} | ({"CLBVH_CACHE": str(tmp_path / "cache")} if has_cache else {})
    # Rays on the host need no cache; what asks for drivers does.
    for code, words, output, is_told in (
        (CAST, (), "[ True]", False), (COMMAND, ("devices",), "device", True), (COMMAND, ("doctor",), "", True),
    ):  # fmt: skip
        run = subprocess.run(
            [sys.executable, "-c", HOMELESS + code, *words],
            env=environment, capture_output=True, text=True, timeout=300, cwd=tmp_path,
        )  # fmt: skip
        assert run.returncode == 0, run.stderr
        assert output in run.stdout
        told = [line for line in run.stderr.splitlines() if "this user has no home folder" in line]
        assert len(told) == int(is_told and not has_cache), run.stderr
        assert "Traceback" not in run.stderr
        assert [path.name for path in tmp_path.iterdir() if path.name not in ("temporary", "cache")] == []
        assert [path.name for path in temporary.iterdir() if path.name.startswith("clbvh-")] == []
    assert (tmp_path / "cache" / "pocl").is_dir() == has_cache
