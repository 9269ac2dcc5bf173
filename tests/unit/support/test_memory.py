"""Free memory: the least of what the system, the control groups and the limits of the process leave."""

from __future__ import annotations

import os
import resource
import subprocess
import sys

import pytest

from clbvh.support import memory
from clbvh.support.memory import free_memory_bytes

GIB = 1 << 30
PAGES = 1000


@pytest.fixture
def system(monkeypatch, tmp_path):
    """A function that writes files of the kernel, by their paths below the root; the machine has 8 GiB left."""

    def write(files: dict[str, str]) -> None:
        for name, text in files.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)

    monkeypatch.setattr(memory, "_PROC", tmp_path / "proc")
    monkeypatch.setattr(memory, "_UNIFIED", (tmp_path / "cgroup", *memory._UNIFIED[1:]))
    monkeypatch.setattr(memory, "_LEGACY", (tmp_path / "cgroup" / "memory", *memory._LEGACY[1:]))
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY,) * 2)
    write({"proc/meminfo": f"MemTotal: 99999999 kB\nMemAvailable:  {8 * GIB // 1024} kB\nBuffers: 1 kB\n"})
    return write


def test_the_system_says_what_is_available(system):
    assert free_memory_bytes() == 8 * GIB


def test_a_system_that_does_not_say_it_has_all_of_its_memory(system):
    system({"proc/meminfo": "MemTotal: 99 kB\n"})
    assert free_memory_bytes() == os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.parametrize("group", ["", "/a", "/a/b"])
def test_the_limit_of_a_unified_group_or_of_one_around_it(system, group):
    system(
        {
            "proc/self/cgroup": "0::/a/b\n",
            "cgroup/a/b/memory.max": "max\n",
            "cgroup/a/b/memory.current": f"{GIB}\n",
            f"cgroup{group}/memory.max": f"{4 * GIB}\n",
            f"cgroup{group}/memory.current": f"{3 * GIB}\n",
            f"cgroup{group}/memory.stat": f"anon 5\ninactive_file {GIB // 2}\n",
        }
    )
    assert free_memory_bytes() == 3 * GIB // 2


def test_the_limit_of_a_legacy_group(system):
    system(
        {
            "proc/self/cgroup": "5:cpu:/x\n4:memory:/x\n0::/\n",
            "cgroup/memory/x/memory.limit_in_bytes": f"{2 * GIB}\n",
            "cgroup/memory/x/memory.usage_in_bytes": f"{GIB}\n",
            "cgroup/memory/x/memory.stat": "inactive_file 9\ntotal_inactive_file 7\n",
            "cgroup/memory/memory.limit_in_bytes": f"{2**63 - 4096}\n",
            "cgroup/memory/memory.usage_in_bytes": f"{GIB}\n",
        }
    )
    assert free_memory_bytes() == GIB + 7


def test_a_group_whose_path_is_the_host_s(system):
    system(
        {
            "proc/self/cgroup": "0::/../host/docker/1\n",
            "cgroup/memory.max": f"{GIB}\n",
            "cgroup/memory.current": "0\n",
        }
    )
    assert free_memory_bytes() == GIB


def test_an_exceeded_limit_leaves_nothing(system):
    system(
        {"proc/self/cgroup": "0::/\n", "cgroup/memory.max": "5\n", "cgroup/memory.current": "6\n"},
    )
    assert free_memory_bytes() == 0


def test_the_address_space_that_is_in_use_counts(system, monkeypatch):
    system({"proc/self/statm": f"{PAGES} 5 5\n"})
    monkeypatch.setattr(resource, "getrlimit", lambda _: (GIB, GIB))
    assert free_memory_bytes() == GIB - PAGES * resource.getpagesize()


def test_a_real_limit_of_the_address_space():
    code = (
        "import resource; from clbvh.support.memory import free_memory_bytes; print(free_memory_bytes());"
        f"resource.setrlimit(resource.RLIMIT_AS, ({GIB}, {GIB})); print(free_memory_bytes())"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    before, after = map(int, run.stdout.split())
    assert before > 1 << 20
    assert 0 < after < GIB
