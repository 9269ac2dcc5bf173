"""The memory that this process can still take, and the check before large arrays are allocated."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

import psutil

from ..errors import ClbvhError

# The limit of a container, and the memory of its processes (control groups of Linux, version 2), unknown to psutil.
_CONTAINER = Path("/sys/fs/cgroup")

# Smaller arrays are not checked: asking for the free memory takes 0.1 ms.
_LEAST_CHECKED = 2**28


def free_memory_bytes() -> int:
    """Return how many bytes this process can still take without swapping; 0 when a limit is already exceeded."""
    free = int(psutil.virtual_memory().available)
    with suppress(OSError, ValueError):  # not in a container, or one without a limit
        limit, taken = (int((_CONTAINER / name).read_text()) for name in ("memory.max", "memory.current"))
        # Pages of files are given back on demand.
        files = re.search(r"^inactive_file (\d+)$", (_CONTAINER / "memory.stat").read_text(), re.MULTILINE)
        free = min(free, limit - taken + int(files[1] if files else 0))
    return max(0, free)


def check_memory(subject: str, needed_bytes: int, error: type[ClbvhError], advice: str = "") -> None:
    """Raise an error if arrays would not fit the memory that is free; for checks before they are allocated.

    Systems promise more memory than they have, and end the process that believes them. Arrays of less than 256 MiB are
    not checked.

    Parameters
    ----------
    subject : str
        The user of the memory, in a word or two.
    needed_bytes : int
    error : type
        The class of the error.
    advice : str, optional
        The way out, for the message.
    """
    if needed_bytes < _LEAST_CHECKED:
        return
    free = free_memory_bytes()
    if needed_bytes > free:
        raise error(
            f"{subject} need{'s' * subject.startswith('a ')} about {needed_bytes / 1e6:,.0f} MB of memory, "
            f"but {free / 1e6:,.0f} MB are free{': ' if advice else ''}{advice}"
        )
