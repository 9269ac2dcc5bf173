"""Damaged machine code is compiled again and replaced; a full disk, and two processes at once, do no harm."""

from __future__ import annotations

import errno
import hashlib
import os
import subprocess
import sys

import pytest

from clbvh.support import compiled

SCRIPT = """
import os, sys
import numpy as np
from clbvh.support.loop_functions import prefetch
from clbvh.support import compiled as home
from clbvh.support.compiled import compiled
if "full" in sys.argv:
    def refuse(path):
        raise OSError(28, os.strerror(28))
    home.replacing = refuse

@compiled
def twice(x):
    return 2 * x

print(twice(3), twice(0.25), twice(np.float32(1.5)))
"""
ANSWER = "6 0.5 3.0\n"

# What `say_once` remembers of the line about compiling.
COMPILING = hashlib.sha256(b"compiling").hexdigest()[:8]

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
    numbers, answer = sum_to(number)
    assert numbers.tolist() == [0, 1, 2, 3]
    assert answer == 6
    try:
        sum_to(10)
    except ValueError as error:
        assert error.args == ("too many", 10)
print(len(sum_to.stats.cache_misses), len(sum_to.stats.cache_hits), "numba.np.arrayobj" in sys.modules)
"""


@pytest.fixture
def run(tmp_path):
    """A function that runs the script in a process of its own, with a cache of its own."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    # The line about compiling has been said.
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "_CLBVH_SAID": COMPILING}

    def start(*words):
        return subprocess.Popen(
            [sys.executable, script, *words], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def run(*words):
        with start(*words) as process:
            return (*process.communicate(), process.returncode)

    run.start = start
    run.files = lambda suffix: sorted((tmp_path / "cache").rglob(f"*twice*{suffix}"))
    return run


def test_loading_does_not_prepare_to_compile_and_compiling_after_it_does(tmp_path):
    script = tmp_path / "summing.py"
    script.write_text(SUMMING)

    def run(*words):
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
        return subprocess.check_output([sys.executable, script, *words], env=environment, text=True).split()

    assert run() == ["1", "0", "True"]
    assert run() == ["0", "1", "False"]
    assert run("bytes") == ["1", "1", "True"]
    assert run("bytes") == ["0", "2", "False"]


@pytest.mark.parametrize("damage", [b"", b"not a pickle", None], ids=["empty", "text", "one bit"])
def test_a_damaged_file_is_said_once_and_replaced(run, damage):
    assert run() == (ANSWER, "", 0)
    whole = {path: path.read_bytes() for path in run.files(".nbc")}
    assert whole
    for path, content in whole.items():
        middle = len(content) // 2
        flipped = content[:middle] + bytes([content[middle] ^ 16]) + content[middle + 1 :]
        path.write_bytes(flipped if damage is None else damage)
    output, errors, code = run()
    assert (output, code) == (ANSWER, 0)
    assert errors.startswith("clbvh: machine code in the cache ")
    assert errors.count("cannot be used and is compiled again") == len(errors.splitlines())
    assert run() == (ANSWER, "", 0)


def test_a_full_disk_is_said_once(run):
    output, errors, code = run("full")
    assert (output, code) == (ANSWER, 0)
    (line,) = errors.splitlines()
    assert line.endswith(os.strerror(errno.ENOSPC))


def test_two_processes_that_compile_at_once_agree_and_leave_whole_files(run, tmp_path):
    for _ in range(2):
        processes = [run.start() for _ in range(2)]
        assert [(*process.communicate(), process.returncode) for process in processes] == [(ANSWER, "", 0)] * 2
    assert len(run.files(".nbc")) == 3
    assert [path for path in (tmp_path / "cache").rglob("*") if ".tmp" in path.name] == []


def test_a_cache_that_cannot_be_written_to_is_no_cache_at_all(run, tmp_path):
    (tmp_path / "cache").touch()
    output, errors, code = run()
    assert (output, code) == (ANSWER, 0)
    assert errors.startswith("clbvh: nothing can be kept in the cache ")
    assert len(errors.splitlines()) == 1


def test_every_bit_of_machine_code_counts(tmp_path):
    # The middle of these bytes can change without an error from pickle.
    files = compiled._CodeFiles(tmp_path, "twice")
    files.save("signature", bytes(1000))
    assert files.load("signature") == bytes(1000)
    (path,) = tmp_path.glob("*.nbc")
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(ValueError, match="is damaged"):
        files.load("signature")


def test_signatures_and_versions_of_numba_have_files_of_their_own(tmp_path, monkeypatch):
    files = compiled._CodeFiles(tmp_path, "twice")
    files.save("float", "code for floats")
    files.save("int", "code for ints")
    monkeypatch.setattr(compiled.numba, "__version__", "9.9")
    with pytest.raises(FileNotFoundError):
        files.load("int")
    monkeypatch.undo()
    assert files.load("int") == "code for ints"
