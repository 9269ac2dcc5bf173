"""The processes that this one has started, and those that they have: found and ended (Linux).

Elsewhere nothing is found; workers and the fork server end by themselves when their pipes close.
"""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress

# A killed process takes this long to end, unless the operating system holds it.
_PATIENCE_S = 2.0
_PAUSE_S = 0.005


def end_descendants() -> None:
    """Kill all descendants of this process, and wait until none is left."""
    deadline = time.monotonic() + _PATIENCE_S
    # Again and again: one may start another while they are listed.
    while (living := find_descendants()) and time.monotonic() < deadline:
        for process in living:
            with suppress(OSError):
                os.kill(process, signal.SIGKILL)
        time.sleep(_PAUSE_S)


def find_descendants() -> list[int]:
    """Return the ids of the living descendants of this process, children before theirs."""
    children: dict[int, list[int]] = {}
    with suppress(OSError):
        for name in os.listdir("/proc"):  # noqa: PTH208 - names, and quickly
            if name.isdigit():
                with suppress(OSError, ValueError):
                    parent = _find_living_parent(name)
                    children.setdefault(parent, []).append(int(name))
    found = [os.getpid()]
    for process in found:
        found += children.get(process, [])
    return found[1:]


def _find_living_parent(name: str) -> int:
    """Return the parent of a process; raise `ValueError` for a zombie, which is no longer alive."""
    with open(f"/proc/{name}/stat", "rb") as file:  # noqa: PTH123 - as above
        # The name of the program, which may hold anything, ends with the last bracket.
        state, parent = file.read().rpartition(b")")[2].split()[:2]
    if state == b"Z":
        raise ValueError(name)
    return int(parent)
