"""A disk that was full when its blocks were reserved gave a bare OSError and left an open file."""

from __future__ import annotations

import errno
import os

import pytest

from clbvh.builders.workers import arena as arena_module
from clbvh.builders.workers.arena import Arena
from clbvh.errors import PoolError


def test_a_full_disk_is_a_pool_error_and_leaves_nothing(monkeypatch, short_path):
    def refuse(descriptor, offset, size):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(arena_module, "free_memory_bytes", lambda: 0)
    monkeypatch.setattr(arena_module.tempfile, "tempdir", str(short_path))
    monkeypatch.setattr(os, "posix_fallocate", refuse)
    open_before = len(os.listdir("/proc/self/fd"))  # noqa: PTH208 - counted, not used
    with Arena() as arena, pytest.raises(PoolError, match="set TMPDIR to a larger disk"):
        arena.create((1000,), "u1")
    assert len(os.listdir("/proc/self/fd")) == open_before  # noqa: PTH208
    assert list(short_path.iterdir()) == []
