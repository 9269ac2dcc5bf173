"""Ctrl-C, and the requests to end (SIGTERM, SIGHUP), at any moment of a command.

Python's own way raises `KeyboardInterrupt` wherever the main thread happens to be: in an import, in a callback of a
driver or of a compiler, in a function that runs at exit. Some of these places print a traceback, others swallow it, and
a long native call delays it. So here a signal raises nothing. A thread waits for it, ends all processes that this one
has started, removes what is unfinished, says one line, and ends the process.

LLVM, inside PoCL, has handlers of its own while it compiles: they remove its files and pass the signal on to these, so
that the compilation then fails. By then the main thread stands still.
"""

from __future__ import annotations

import atexit
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from ..support.descendants import end_descendants
from ..support.unfinished import clean_up

# What is said about each signal.
_WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
if hasattr(signal, "SIGHUP"):
    _WORDS[signal.SIGHUP] = "hung up"

# A process that a signal ends has this exit code and the signal's number, as shells have it.
_EXIT_BASE = 128

_LONG_S = 60.0

# Clears the line of a progress display, and shows the cursor again.
_END_OF_STATUS = b"\r\x1b[K\x1b[?25h"

# Called instead of ending the process, see `calling_on_interrupt`.
_on_interrupt: list[Callable[[], None]] = []


def end_on_signals() -> None:
    """Let the process end at once, and leave nothing behind, when one of the signals arrives.

    A signal that is ignored, as Ctrl-C is for a job in the background and SIGHUP under `nohup`, stays ignored.
    """
    read_end, write_end = os.pipe()
    if hasattr(os, "set_blocking"):  # on Windows from Python 3.12 on
        os.set_blocking(write_end, False)
    # The number of every signal that has a handler is written there, also while native code runs.
    signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
    for number in _WORDS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _stand_still)
    threading.Thread(target=_wait, args=(read_end,), name="clbvh-signals", daemon=True).start()
    # The first function registered runs last: from then on nothing is left to clean up, and Python only tidies.
    atexit.register(_ignore)


@contextmanager
def calling_on_interrupt(function: Callable[[], None]) -> Iterator[None]:
    """Call a function on the first Ctrl-C in the block, from another thread; a second one ends the process."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.SIG_IGN:
        yield
        return
    is_called = False

    def go_on(number: int, frame: object) -> None:
        """Leave the first signal to the other thread, which ends the process on the second one."""
        nonlocal is_called
        if is_called:
            _stand_still(number, frame)
        is_called = True

    _on_interrupt.append(function)
    signal.signal(signal.SIGINT, go_on)
    try:
        yield
    finally:
        _on_interrupt.clear()
        signal.signal(signal.SIGINT, before)


def _stand_still(number: int, frame: object) -> None:
    """Keep the main thread from going on, and from failing for want of what the other thread removes."""
    while True:
        time.sleep(_LONG_S)


def _wait(read_end: int) -> None:
    while True:
        for number in os.read(read_end, 1):
            if number == signal.SIGINT and _on_interrupt:
                _on_interrupt.pop()()
            elif number in _WORDS:
                _end(number)


def _end(number: int) -> None:
    try:
        errors = _mute_errors()
        end_descendants()
        clean_up()
        with suppress(OSError):
            status = _END_OF_STATUS if os.isatty(errors) else b""
            os.write(errors, status + f"clbvh: {_WORDS[signal.Signals(number)]}\n".encode())
    finally:
        os._exit(_EXIT_BASE + number)


def _mute_errors() -> int:
    """Return a descriptor of stderr that only this thread has; others, native ones too, can print no more."""
    try:
        errors = os.dup(2)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    except OSError:  # no handle is left
        return 2
    return errors


def _ignore() -> None:
    for number in _WORDS:
        signal.signal(number, signal.SIG_IGN)
