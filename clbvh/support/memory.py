"""How much memory this process can still take: the least of what the system, its control group and its limits allow."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from ..errors import ClbvhError

_PROC = Path("/proc")
_CGROUPS = Path("/sys/fs/cgroup")
_KIB = 1024

# Less is not checked: to ask how much is free takes 0.1 ms.
_LEAST_CHECKED = 2**28

# Per version of control groups: the mount point, the files of the limit and of the memory in use, and the part of the
# latter that the kernel gives back on demand (pages of files), as named in `memory.stat`.
_UNIFIED = (_CGROUPS, "memory.max", "memory.current", "inactive_file")
_LEGACY = (_CGROUPS / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")


def free_memory_bytes() -> int:
    """Return how many bytes this process can still take without swapping; 0 when a limit is already exceeded."""
    return max(0, min([_system_bytes(), *_cgroup_bytes(), *_address_space_bytes()]))


def check_memory(subject: str, needed_bytes: int, error: type[ClbvhError], advice: str = "") -> None:
    """Raise an error if arrays would not fit the memory that is free; for checks before they are allocated.

    Systems promise more memory than they have, and end the process that believes them. Arrays of less than 256 MiB are
    not checked.

    Parameters
    ----------
    subject : str
        What needs the memory, in a word or two.
    needed_bytes : int
    error : type
        The class of the error.
    advice : str, optional
        What to do instead.
    """
    if needed_bytes < _LEAST_CHECKED:
        return
    free = free_memory_bytes()
    if needed_bytes > free:
        raise error(
            f"{subject} need{'s' * subject.startswith('a ')} about {needed_bytes / 1e6:,.0f} MB of memory, "
            f"but {free / 1e6:,.0f} MB are free{': ' if advice else ''}{advice}"
        )


def _system_bytes() -> int:
    """Return what the whole machine has left; all of its memory where it does not say that, no limit on Windows."""
    if found := re.search(r"^MemAvailable:\s*(\d+) kB", _read(_PROC / "meminfo"), re.MULTILINE):
        return int(found[1]) * _KIB
    if not hasattr(os, "sysconf"):
        return sys.maxsize
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _cgroup_bytes() -> Iterator[int]:
    """Yield what is left in the process's control group and in each group around it."""
    for line in _read(_PROC / "self" / "cgroup").splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers and "memory" not in controllers.split(","):
            continue
        root, limit_name, usage_name, reclaimable_name = _LEGACY if controllers else _UNIFIED
        # In a container the path may be the host's, of which only the end of the way up exists here.
        group = root / path.lstrip("/")
        for folder in (group, *group.parents):
            if folder == root.parent:
                break
            limit, usage = _read(folder / limit_name).strip(), _read(folder / usage_name).strip()
            if limit.isdecimal() and usage.isdecimal():  # "max" is no limit
                stat = _read(folder / "memory.stat")
                reclaimable = re.search(rf"^{reclaimable_name} (\d+)$", stat, re.MULTILINE)
                yield int(limit) - int(usage) + (int(reclaimable[1]) if reclaimable else 0)


def _address_space_bytes() -> Iterator[int]:
    """Yield what `RLIMIT_AS` leaves, if it is set."""
    try:
        import resource
    except ImportError:  # not a Unix system
        return
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    pages = _read(_PROC / "self" / "statm").split()
    if limit != resource.RLIM_INFINITY and pages:
        yield limit - int(pages[0]) * resource.getpagesize()


def _read(path: Path) -> str:
    """Return the text of one of the kernel's files, empty if there is none."""
    try:
        return path.read_text()
    except OSError:
        return ""
