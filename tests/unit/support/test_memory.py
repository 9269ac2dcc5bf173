"""Free memory: the least of what the system and a container leave; large arrays are refused before they are made."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from clbvh.errors import MeshError
from clbvh.support import memory
from clbvh.support.memory import check_memory, free_memory_bytes

GIB = 1 << 30


@pytest.fixture
def container(monkeypatch, tmp_path):
    """The folder of a container's limits; the machine has 8 GiB left."""
    monkeypatch.setattr(memory, "_CONTAINER", tmp_path)
    monkeypatch.setattr(memory.psutil, "virtual_memory", lambda: SimpleNamespace(available=8 * GIB))
    return tmp_path


def limit(container, most, taken, stat="anon 5\n"):
    for name, text in {"memory.max": most, "memory.current": taken, "memory.stat": stat}.items():
        (container / name).write_text(f"{text}\n")


def test_without_a_container_the_system_says_what_is_available(container):
    assert free_memory_bytes() == 8 * GIB
    limit(container, "max", 5)
    assert free_memory_bytes() == 8 * GIB


def test_the_limit_of_a_container_counts_but_not_its_pages_of_files(container):
    limit(container, 4 * GIB, 3 * GIB, f"anon 5\ninactive_file {GIB // 2}\n")
    assert free_memory_bytes() == 3 * GIB // 2


def test_an_exceeded_limit_leaves_nothing(container):
    limit(container, 5, 6)
    assert free_memory_bytes() == 0


def test_what_does_not_fit_is_refused_by_name(container):
    check_memory("a mesh", 8 * GIB, MeshError)
    with pytest.raises(MeshError, match="a mesh needs about 8,590 MB of memory, but 8,590 MB are free: take less"):
        check_memory("a mesh", 8 * GIB + 1, MeshError, "take less")
