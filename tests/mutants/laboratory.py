"""Copies of the repository in which mutants are planted and tested, each in a folder that stays for the next run.

Kernels and loops of the host are compiled when a test asks for them, where one of their files has the fault.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from clbvh.device.host.library import ON_DEMAND_VARIABLE

from .table import ROOT, Mutant

# What the tests need of the repository.
_PARTS = ("clbvh", "cl", "scenes", "tests", "pyproject.toml")

# Seconds for the tests of a mutant, far more than any takes: one that hangs is not caught by an assertion.
_LIMIT_S = 600

# The exit code of pytest if tests ran and some failed. Errors in the collection have another one.
_TESTS_FAILED = 1

# A fault that does not compile shows nothing about the tests.
_NO_CODE = ("KernelBuildError", "SyntaxError")

PASSED, FAILED = "passed", "failed"


class Laboratory:
    """A copy of the repository in a folder, brought up to date."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for part in _PARTS:
            _update(ROOT / part, folder / part)

    def test(self, tests: tuple[str, ...], mutant: Mutant | None = None) -> tuple[str, str]:
        """Run tests, with a mutant planted meanwhile; return `PASSED`, `FAILED` or why neither, and pytest's output."""
        if mutant is None:
            return self._run(tests)
        mutant.apply(self.folder)
        try:
            return self._run(tests, of_kernels=mutant.file.startswith("cl/"))
        finally:
            _update(ROOT / mutant.file, self.folder / mutant.file)

    def _run(self, tests: tuple[str, ...], *, of_kernels: bool = False) -> tuple[str, str]:
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
        environment = os.environ | {"PYTHONPATH": str(self.folder)}
        if of_kernels:
            environment[ON_DEMAND_VARIABLE] = "1"
        try:
            done = subprocess.run(
                command, cwd=self.folder, env=environment, text=True, timeout=_LIMIT_S,
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return f"not finished after {_LIMIT_S} s", ""
        if done.returncode == 0:
            return PASSED, done.stdout
        if done.returncode != _TESTS_FAILED:
            return f"pytest ended with {done.returncode}", done.stdout
        for word in _NO_CODE:
            if word in done.stdout:
                return f"the code does not compile ({word})", done.stdout
        return FAILED, done.stdout


def _update(source: Path, target: Path) -> None:
    """Make a copy of a file or folder; files that are alike are left alone, others come with their times."""
    if source.is_file():
        target.parent.mkdir(parents=True, exist_ok=True)
        if not target.is_file() or source.read_bytes() != target.read_bytes():
            shutil.copy2(source, target)
        return
    names = {path.name for path in source.iterdir() if path.name != "__pycache__"}
    for old in target.iterdir() if target.is_dir() else ():
        if old.name not in names | {"__pycache__"}:
            shutil.rmtree(old) if old.is_dir() else old.unlink()
    for name in names:
        _update(source / name, target / name)
