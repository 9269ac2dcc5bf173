"""Damaged machine code is compiled again and replaced; a full disk, and two processes at once, do no harm."""

import errno
import hashlib
import os
import subprocess
import sys

import pytest

from clbvh.support import compiled

TWICE = """
import os, sys
import numpy as np
from clbvh.support import compiled as home
if "full" in sys.argv:
    def refuse(path):
        raise OSError(28, os.strerror(28))
    home.replacing = refuse

@home.compiled
def twice(x):
    return 2 * x

print(twice(3), twice(0.25), twice(np.float32(1.5)))
"""
ANSWER = "6 0.5 3.0\n"

# Its machine code contains functions of numba's own, from a module that numba imports to compile.
SUMMING = """
import sys
import numpy as np
from clbvh.support.compiled import compiled

@compiled
def sum_to(count):
    if count > 9:
        raise ValueError("too many", count)
    numbers = np.empty(count)
    for index in range(count):
        numbers[index] = index
    return numbers, numbers.sum()

for number in [4, np.uint8(4)] if "bytes" in sys.argv else [4]:
    assert sum_to(number)[1] == 6
    try:
        sum_to(10)
    except ValueError as error:
        assert error.args == ("too many", 10)
print(len(sum_to.stats.cache_misses), len(sum_to.stats.cache_hits), "numba.np.arrayobj" in sys.modules)
"""

# What `say_once` remembers of the line about compiling.
COMPILING = hashlib.sha256(b"compiling").hexdigest()[:8]


@pytest.fixture
def start(tmp_path):
    """A function that starts a program with a cache of its own, in which the line about compiling has been said."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "_CLBVH_SAID": COMPILING}

    def start(program, *words):
        script = tmp_path / f"{hashlib.sha256(program.encode()).hexdigest()}.py"
        if not script.exists():
            script.write_text(program)
        command = [sys.executable, script, *words]
        return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    return start


@pytest.fixture
def run(start):
    """A function that runs a program to its end, and returns its output, errors and exit code."""

    def run(program, *words):
        with start(program, *words) as process:
            return (*process.communicate(), process.returncode)

    return run


def list_files(tmp_path):
    return sorted((tmp_path / "cache").rglob("*twice*.nbc"))


def test_loading_does_not_prepare_to_compile_and_compiling_after_it_does(run):
    for words, expected in (((), "1 0 True"), ((), "0 1 False"), (("bytes",), "1 1 True"), (("bytes",), "0 2 False")):
        assert run(SUMMING, *words) == (f"{expected}\n", "", 0)


@pytest.mark.parametrize("damage", [b"", b"not a pickle", None], ids=["empty", "text", "one bit"])
def test_a_damaged_file_is_said_once_and_replaced(run, tmp_path, damage):
    assert run(TWICE) == (ANSWER, "", 0)
    for path in list_files(tmp_path):
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 16
        path.write_bytes(content if damage is None else damage)
    output, errors, code = run(TWICE)
    assert (output, code) == (ANSWER, 0)
    assert errors.startswith("clbvh: machine code in the cache ")
    assert errors.count("cannot be used and is compiled again") == len(errors.splitlines())
    assert run(TWICE) == (ANSWER, "", 0)


def test_a_full_disk_and_a_cache_that_is_no_folder_are_said_once(run, tmp_path):
    output, full, code = run(TWICE, "full")
    assert (output, code) == (ANSWER, 0)
    assert full.endswith(f"{os.strerror(errno.ENOSPC)}\n")
    (tmp_path / "cache").rename(tmp_path / "old")
    (tmp_path / "cache").touch()
    output, errors, code = run(TWICE)
    assert (output, code) == (ANSWER, 0)
    assert errors.startswith("clbvh: nothing can be kept in the cache ")
    assert len(full.splitlines()) == len(errors.splitlines()) == 1


def test_two_processes_that_compile_at_once_agree_and_leave_whole_files(start, tmp_path):
    for _ in range(2):
        processes = [start(TWICE) for _ in range(2)]
        assert [(*process.communicate(), process.returncode) for process in processes] == [(ANSWER, "", 0)] * 2
    assert len(list_files(tmp_path)) == 3
    assert [path for path in (tmp_path / "cache").rglob("*") if ".tmp" in path.name] == []


def test_signatures_and_versions_of_numba_have_files_of_their_own(tmp_path, monkeypatch):
    files = compiled._CodeFiles(tmp_path, "twice")
    files.save("float", "code for floats")
    files.save("int", "code for ints")
    monkeypatch.setattr(compiled.numba, "__version__", "9.9")
    with pytest.raises(FileNotFoundError):
        files.load("int")
    monkeypatch.undo()
    assert files.load("int") == "code for ints"
