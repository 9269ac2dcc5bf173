"""Arrays that processes share: where they lie, what is refused, and that nothing stays behind."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import numpy as np
import pytest

from clbvh.builders.processes import shared_memory
from clbvh.builders.processes.shared_memory import SharedArray
from clbvh.errors import PoolError

SHARED_FOLDER = Path("/dev/shm")


def count_open_files():
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.fixture(params=["anonymous", "file"])
def empty(request, monkeypatch, tmp_path):
    """No file may be left open, and none behind."""
    monkeypatch.setattr(shared_memory.tempfile, "tempdir", str(tmp_path))
    if request.param == "file":  # as on systems without anonymous files
        monkeypatch.setattr(shared_memory, "_HAS_ANONYMOUS_FILES", False)
    gc.collect()  # what earlier tests left to the collector is not to be closed in between
    open_before, shared_before = count_open_files(), set(SHARED_FOLDER.iterdir())
    yield tmp_path
    assert count_open_files() <= open_before
    assert list(tmp_path.iterdir()) == []
    assert set(SHARED_FOLDER.iterdir()) <= shared_before


def test_who_attaches_sees_and_writes_the_same_memory(empty):
    shared = SharedArray((1000, 8), np.float32)
    assert (shared.array.shape, shared.array.dtype, shared.array.flags.writeable) == ((1000, 8), np.float32, True)
    other = shared.handle.attach()
    shared.array[17] = 5
    other[18] = 6
    assert (other[17] == 5).all()
    assert (shared.array[18] == 6).all()
    shared.close()


def test_an_array_outlives_its_file(empty):
    shared = SharedArray((1000,), np.int64)
    shared.array[:] = 7
    shared.close()
    assert (shared.array == 7).all()
    with pytest.raises(OSError, match="No such file"):
        shared.handle.attach()


def test_handles_of_two_arrays_differ_even_at_the_same_path(empty):
    first = SharedArray((10,), np.int32)
    first.close()
    second = SharedArray((10,), np.int32)
    second.close()
    assert first.handle != second.handle


def test_a_small_dev_shm_does_not_matter():
    shared = SharedArray((1000,), "u1")
    assert "memfd" in os.readlink(shared.handle.path)  # noqa: PTH115 - the link's text
    shared.close()


def test_too_little_memory_is_refused_and_said_in_numbers(empty):
    with pytest.raises(PoolError, match=r"needs 1,000,000,000 MB .* or build without a pool"):
        SharedArray((10**15,), "u1")


def test_memory_that_cannot_be_mapped_leaves_no_file(empty, monkeypatch):
    def refuse(handle):
        raise MemoryError

    monkeypatch.setattr(shared_memory.ArrayHandle, "attach", refuse)
    with pytest.raises(MemoryError):
        SharedArray((1000,), "u1")
