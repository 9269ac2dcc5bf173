"""What a process has begun and must not leave behind: how to clean it up when a signal ends the process.

An error unwinds the stack, and `with` and `finally` clean up on the way. A signal that ends the command line does not:
it runs what is listed here, from another thread, and ends the process. So a cleanup must be quick, need no lock of its
own and import nothing, and it must be listed before the thing that it removes comes into being.
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

_PATIENCE_S = 0.2

_lock = threading.Lock()
_cleanups: dict[int, Callable[[], object]] = {}
_tickets = itertools.count()


def add(cleanup: Callable[[], object]) -> int:
    """List a cleanup, and return the ticket that takes it off the list."""
    with _lock:
        ticket = next(_tickets)
        _cleanups[ticket] = cleanup
    return ticket


def discard(ticket: int) -> None:
    """Take a cleanup off the list; one that is not there is no error."""
    with _lock:
        _cleanups.pop(ticket, None)


@contextmanager
def listed(cleanup: Callable[[], object]) -> Iterator[None]:
    """List a cleanup for the length of a `with` block."""
    ticket = add(cleanup)
    try:
        yield
    finally:
        discard(ticket)


def clean_up() -> None:
    """Run all cleanups, the latest first. Nothing can be begun any more: the process must end now."""
    # A thread that was stopped may hold the lock.
    _lock.acquire(timeout=_PATIENCE_S)
    for ticket in sorted(_cleanups, reverse=True):
        with suppress(Exception):
            _cleanups[ticket]()
