"""Locks and threads that a forked child renews: it has one thread, and nobody releases a lock that another one held.

Half-finished work of other threads stays as it is. Under a lock of `make_lock`, therefore, a cache gets complete values
only, and one assignment replaces a state by the next, as Ctrl-C demands as well.
"""

from __future__ import annotations

import os
import sys
import threading
from functools import cached_property
from typing import Any, Protocol
from weakref import WeakSet


class Renewable(Protocol):
    """An object whose threads a forked child does not have."""

    def start_anew(self) -> None:
        """Forget the threads that the child does not have."""


_PACKAGE = __name__.partition(".")[0]

_locks: WeakSet[Any] = WeakSet()
_renewables: WeakSet[Renewable] = WeakSet()


def make_lock() -> threading.RLock:
    """Return a lock that is free in a forked child, unless the thread that forked holds it.

    It is reentrant, because such a lock knows its owner; it takes as long as any other.
    """
    lock = threading.RLock()
    _locks.add(lock)
    return lock


def renew_in_child(thing: Renewable) -> None:
    """Let a forked child start a thing anew before anything else."""
    _renewables.add(thing)


def _find_property_locks() -> list[Any]:
    """Return the locks of all cached properties, which Python 3.11 has: one for all instances of a class."""
    modules = [(name, module) for name, module in list(sys.modules.items()) if name.startswith(_PACKAGE)]
    things = [(name, thing) for name, module in modules for thing in vars(module).values()]
    classes = [thing for name, thing in things if isinstance(thing, type) and thing.__module__ == name]
    members = [member for owner in classes for member in vars(owner).values()]
    return [member.lock for member in members if isinstance(member, cached_property)]  # type: ignore[attr-defined]


def _start_anew() -> None:
    properties = _find_property_locks() if hasattr(cached_property(len), "lock") else []
    for lock in [*_locks, *properties]:
        if not lock._is_owned():
            lock._at_fork_reinit()
    for thing in list(_renewables):
        thing.start_anew()


if hasattr(os, "register_at_fork"):  # Windows does not fork
    os.register_at_fork(after_in_child=_start_anew)
