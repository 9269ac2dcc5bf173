"""The end of a command: all functions at exit, all output, the exit code, and no end of the interpreter."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import atexit, sys
from clbvh.cli.ending import ending_at_once

class Held:
    def __del__(self):
        sys.__stderr__.write("torn down")

held = Held()
with ending_at_once():
    atexit.register(print, "at exit")
    {last}
"""


def run(last):
    return subprocess.run(
        [sys.executable, "-c", SCRIPT.format(last=last)], capture_output=True, text=True, timeout=60, check=False
    )


@pytest.mark.parametrize(("words", "code"), [("", 0), ("None", 0), ("0", 0), ("3", 3), ("True", 1)])
def test_a_command_ends_with_its_code_and_nothing_is_torn_down(words, code):
    process = run(f"sys.exit({words})")
    assert (process.returncode, process.stdout, process.stderr) == (code, "at exit\n", "")


@pytest.mark.parametrize(
    ("last", "said"), [("raise RuntimeError('a fault')", "RuntimeError: a fault"), ("sys.exit('a text')", "a text")]
)
def test_what_python_has_to_say_is_said(last, said):
    process = run(last)
    assert process.returncode == 1
    assert said in process.stderr
    assert process.stderr.endswith("torn down")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_output_that_cannot_be_written_is_an_error():
    command = [sys.executable, "-c", SCRIPT.format(last="print('text'); sys.exit(0)")]
    buffered = {**os.environ, "PYTHONUNBUFFERED": ""}
    with Path("/dev/full").open("w") as full:
        process = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, check=False, env=buffered
        )
    assert process.returncode == 120
    assert "No space left" in process.stderr
