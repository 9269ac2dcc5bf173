"""Runs the command: in this process, or in one of its own where the process itself is tested."""

import io
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

import pytest

from clbvh.cli.app import run

TIMEOUT_S = 120

_DEVICE_VARIABLES = ("CLBVH_DEVICE", "OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH")

# How the line about a first run begins.
FIRST_RUN = "clbvh: compiling for this machine"

# The same as the installed script.
_SCRIPT = "from clbvh.cli import main; main()"


class Answer(NamedTuple):
    """Exit code and output; the line about what is compiled, which depends on the tests before, is apart."""

    returncode: int
    stdout: str
    stderr: str
    compiled: bool = False


def run_clbvh(*arguments: object, **environment: str) -> Answer:
    """Run `clbvh` with these words in this process, with these variables on top of the test's own.

    An exception that would be a traceback for the user is one for the test. Drivers read their variables when they are
    loaded, which has happened in this process; the doctor alone hands its environment to new ones.
    """
    output, errors = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(output), redirect_stderr(errors):
        for name in _DEVICE_VARIABLES:
            patch.delenv(name, raising=False)
        for name, value in environment.items():
            patch.setenv(name, value)
        with pytest.raises(SystemExit) as ended:
            run([str(argument) for argument in arguments])
    return make_answer(ended.value.code or 0, output.getvalue(), errors.getvalue())


def make_answer(returncode: int, stdout: str, stderr: str) -> Answer:
    """Return the answer of a command, with the line about a first run taken out of stderr."""
    lines = stderr.splitlines(keepends=True)
    others = [line for line in lines if not line.startswith(FIRST_RUN)]
    assert len(lines) - len(others) <= 1
    return Answer(returncode, stdout, "".join(others), compiled=len(others) < len(lines))


def make_environment(**environment: str) -> dict[str, str]:
    """Return the environment of a process: the test's own without the choice of a device or driver, and these."""
    left_out = (*_DEVICE_VARIABLES, "_CLBVH_SAID")  # what the tests' process has said, its children do not repeat
    return {name: value for name, value in os.environ.items() if name not in left_out} | environment


def run_process(*arguments: object, **environment: str) -> Answer:
    """Run `clbvh` with these arguments in a process of its own; see `run_clbvh`."""
    process = subprocess.run(
        [sys.executable, "-c", _SCRIPT, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        env=make_environment(**environment),
        check=False,
    )
    return make_answer(process.returncode, process.stdout, process.stderr)


def refuses(answer: Answer, code: int, *words: str) -> None:
    """Check for one line on stderr that has these words, and nothing on stdout."""
    assert (answer.returncode, answer.stdout) == (code, ""), answer.stderr
    (line,) = answer.stderr.splitlines()
    assert line.startswith("clbvh: ")
    for word in words:
        assert word in line


def hidden_drivers(folder: Path) -> dict[str, str]:
    """Return the environment of a machine whose only OpenCL driver is gone; `folder` is for its driver file."""
    icd = folder / "gone.icd"
    icd.write_text("libgone.so.7\n")
    return {"OCL_ICD_VENDORS": str(icd)}


def shadowed_modules(folder: Path) -> dict[str, str]:
    """Return the environment of a process that finds the modules in `folder` before all others."""
    return {"PYTHONPATH": os.pathsep.join([str(folder), *sys.path])}
