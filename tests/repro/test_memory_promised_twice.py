"""Each array alone was compared with the free memory, so together they could be larger: memory is taken on writing."""

from __future__ import annotations

import os

import pytest

from clbvh.builders.workers import arena as arena_module
from clbvh.builders.workers.arena import Arena

MIB = 1 << 20
FREE = 10 * MIB


def is_in_memory(handle):
    return "memfd" in os.readlink(handle.path)  # noqa: PTH115 - the link's text, which names no file


@pytest.fixture
def little_memory(monkeypatch):
    monkeypatch.setattr(arena_module, "free_memory_bytes", lambda: FREE)


def test_arrays_that_fit_only_one_by_one_do_not_all_go_to_memory(little_memory):
    with Arena() as arena:
        first, _ = arena.create((6 * MIB,), "u1")
        second, _ = arena.create((6 * MIB,), "u1")
        third, _ = arena.create((4 * MIB,), "u1")
        assert [is_in_memory(handle) for handle in (first, second, third)] == [True, False, True]


def test_a_freed_array_gives_its_memory_back(little_memory):
    with Arena() as arena:
        for _ in range(3):
            handle, _ = arena.create((6 * MIB,), "u1")
            assert is_in_memory(handle)
            arena.free(handle)
