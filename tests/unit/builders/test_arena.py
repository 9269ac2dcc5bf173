"""Shared memory with one owner: where it lies, what it refuses, and that nothing stays behind."""

from __future__ import annotations

import gc
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from clbvh.builders.workers import arena as arena_module
from clbvh.builders.workers.arena import Arena
from clbvh.errors import PoolError

SHARED_FOLDER = Path("/dev/shm")


def count_open_files():
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.fixture
def no_memory(monkeypatch, tmp_path):
    """No free memory, and an empty temporary folder."""
    monkeypatch.setattr(arena_module, "free_memory_bytes", lambda: 0)
    monkeypatch.setattr(arena_module.tempfile, "tempdir", str(tmp_path))
    return tmp_path


@pytest.fixture(params=["memory", "file without a name", "file with a name"])
def arena(request, monkeypatch, tmp_path):
    """An arena of each kind, whose test must leave no file open and none behind."""
    monkeypatch.setattr(arena_module.tempfile, "tempdir", str(tmp_path))
    if request.param != "memory":
        monkeypatch.setattr(arena_module, "free_memory_bytes", lambda: 0)
    if request.param == "file with a name":
        # As on systems without /proc.
        monkeypatch.setattr(arena_module, "_OWN_FILES", tmp_path / "missing")
    gc.collect()  # what earlier tests left to the collector is not to be closed in between
    open_before = count_open_files()
    shared_before = set(SHARED_FOLDER.iterdir())
    with Arena() as arena:
        yield arena
    assert count_open_files() <= open_before
    assert list(tmp_path.iterdir()) == []
    assert set(SHARED_FOLDER.iterdir()) <= shared_before


def test_an_array_is_zero_and_has_its_shape(arena):
    handle, array = arena.create((3, 5), np.int32)
    assert (array.shape, array.dtype, handle.shape, handle.dtype) == ((3, 5), np.int32, (3, 5), np.int32)
    assert (array == 0).all()
    assert array.flags.writeable


def test_who_attaches_sees_and_writes_the_same_memory(arena):
    handle, array = arena.create((1000, 8), np.float32)
    other = handle.attach()
    array[17] = 5
    other[18] = 6
    assert (other[17] == 5).all()
    assert (array[18] == 6).all()
    assert (array[19] == 0).all()


def test_sharing_copies(arena):
    array = np.arange(12, dtype=np.int16).reshape(3, 4)
    copy = arena.share(array).attach()
    array += 1
    assert copy.tolist() == np.arange(12).reshape(3, 4).tolist()


def test_arrays_stay_valid_after_the_arena_is_closed(arena):
    handle, array = arena.create((1000,), np.int64)
    array[:] = 7
    arena.close()
    arena.close()
    assert (array == 7).all()
    array[:] = 8
    assert (array == 8).all()
    with pytest.raises(OSError, match="No such file"):
        handle.attach()


def test_a_freed_array_cannot_be_attached_and_the_others_can(arena):
    freed, array = arena.create((10,), np.int32)
    kept, _ = arena.create((10,), np.int32)
    array[:] = 3
    arena.free(freed)
    assert (array == 3).all()
    assert (kept.attach() == 0).all()


def test_handles_of_two_arrays_differ_even_at_the_same_path(arena):
    first, _ = arena.create((10,), np.int32)
    arena.free(first)
    second, _ = arena.create((10,), np.int32)
    assert first != second


def test_an_error_inside_frees_everything(arena):
    open_before = count_open_files()
    with pytest.raises(ZeroDivisionError), Arena() as inner:  # noqa: PT012 - the block is what is tested
        inner.create((1000,), np.int32)
        raise ZeroDivisionError
    assert count_open_files() == open_before


def test_memory_is_anonymous_where_it_suffices():
    with Arena() as arena:
        handle, _ = arena.create((1000,), "u1")
        assert "memfd" in os.readlink(handle.path)  # noqa: PTH115 - the link's text


def test_a_file_without_a_name_takes_its_place(no_memory):
    with Arena() as arena:
        handle, _ = arena.create((1000,), "u1")
        assert os.readlink(handle.path).startswith(str(no_memory))  # noqa: PTH115 - the link's text
        assert list(no_memory.iterdir()) == []
        # Its blocks are reserved: a store cannot fail later.
        assert Path(handle.path).stat().st_blocks > 0


def test_a_named_file_goes_with_the_arena(no_memory, monkeypatch):
    monkeypatch.setattr(arena_module, "_OWN_FILES", no_memory / "missing")
    with Arena() as arena:
        handle, _ = arena.create((1000,), "u1")
        assert [str(path) for path in no_memory.iterdir()] == [handle.path]
    assert list(no_memory.iterdir()) == []


def test_too_little_of_both_is_refused_and_said_in_numbers(no_memory):
    open_before = count_open_files()
    with Arena() as arena, pytest.raises(PoolError, match=r"needs 1,000,000,000 MB .* there are 0 MB of memory and .*"):
        arena.create((10**15,), "u1")
    assert count_open_files() == open_before
    assert list(no_memory.iterdir()) == []


def test_a_disk_with_too_little_space_is_not_filled_first(no_memory, monkeypatch):
    usage = shutil.disk_usage(no_memory)
    monkeypatch.setattr(arena_module.shutil, "disk_usage", lambda folder: usage._replace(free=999))
    with Arena() as arena:
        arena.create((999,), "u1")
        with pytest.raises(PoolError, match=f"0 MB in {no_memory}"):
            arena.create((1000,), "u1")


def test_memory_that_others_took_meanwhile_counts(monkeypatch):
    free = iter([1000, 1000, 500])
    monkeypatch.setattr(arena_module, "free_memory_bytes", lambda: next(free))
    with Arena() as arena:
        handles = [arena.create((600,), "u1")[0], arena.create((1,), "u1")[0]]
        assert ["memfd" in os.readlink(handle.path) for handle in handles] == [True, True]  # noqa: PTH115
    free = iter([2000, 2000, 500])
    with Arena() as arena:
        handles = [arena.create((600,), "u1")[0], arena.create((600,), "u1")[0]]
        assert ["memfd" in os.readlink(handle.path) for handle in handles] == [True, False]  # noqa: PTH115
