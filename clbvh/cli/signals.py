"""Ctrl-C, and the requests to end (SIGTERM, SIGHUP), at any moment of a command.

`KeyboardInterrupt` is raised wherever the main thread happens to be: in an import or in a callback of a driver, which
print a traceback or swallow it, and a long native call delays it. So a thread waits for the signals. It ends the
processes that this one has started, removes what is unfinished, says one line, and ends the process.
"""

from __future__ import annotations

import atexit
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

_WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
if hasattr(signal, "SIGHUP"):
    _WORDS[signal.SIGHUP] = "hung up"

# A process that a signal ends has this exit code and the signal's number, as shells have it.
_EXIT_BASE = 128

# Clears the line of a progress display, and shows the cursor again.
_END_OF_STATUS = "\r\x1b[K\x1b[?25h"

# What the thread does before it ends the process.
_cleanups: list[Callable[[], None]] = []

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
    # The first function registered runs last: from then on nothing is left to clean up, and the thread is gone.
    atexit.register(lambda: [signal.signal(number, signal.SIG_IGN) for number in _WORDS])


def clean_up_on_signals() -> None:
    """Let the end by a signal also kill the processes that this one has started, and remove unfinished files.

    The imports are not left to the thread: the main thread may stand still inside one of its own.
    """
    import psutil

    from ..support.files import remove_unfinished

    def kill_children() -> None:
        for process in psutil.Process().children(recursive=True):
            with suppress(psutil.Error):
                process.kill()

    _cleanups.extend((kill_children, remove_unfinished))


@contextmanager
def calling_on_interrupt(function: Callable[[], None]) -> Iterator[None]:
    """Call a function on the first Ctrl-C in the block, from another thread; a second one ends the process."""
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.SIG_IGN:
        _on_interrupt.append(function)
        signal.signal(signal.SIGINT, lambda *_: signal.signal(signal.SIGINT, _stand_still))
    try:
        yield
    finally:
        _on_interrupt.clear()
        signal.signal(signal.SIGINT, before)


def _stand_still(number: int, frame: object) -> None:
    """Keep the main thread from failing for want of what the other thread removes."""
    while True:
        time.sleep(1)


def _wait(read_end: int) -> None:
    while True:
        number = os.read(read_end, 1)[0]
        if number == signal.SIGINT and _on_interrupt:
            _on_interrupt.pop()()
        elif number in _WORDS:
            _end(number)


def _end(number: int) -> None:
    try:
        for clean_up in _cleanups:
            with suppress(Exception):  # no handle is left, for example
                clean_up()
        status = _END_OF_STATUS if os.isatty(2) else ""
        os.write(2, f"{status}clbvh: {_WORDS[signal.Signals(number)]}\n".encode())
    finally:
        os._exit(_EXIT_BASE + number)
