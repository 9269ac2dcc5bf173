"""How worker processes start: by a fork server, or by spawning where there is none.

Owns what `multiprocessing` needs around it: signals, the socket of the fork server, the main script's name, and
children that are forked later and must leave the workers alone.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
import struct
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.util import get_temp_dir
from typing import Any

from ...support.run_folder import get_run_folder
from .arena import ArrayHandle
from .worker import serve

_WORKER_NAME = "clbvh-worker-"

# The process that imported this module, which a forked child did not.
_IMPORTED_IN = os.getpid()

# Held while a process starts: several pools may start at once.
_hiding = threading.Lock()


def prepare_context(preload: str | None) -> tuple[Any, str | None]:
    """Return the context of `multiprocessing` that starts workers, and the folder of its socket.

    Call it in a thread of its own, because it changes the thread's signals.

    Parameters
    ----------
    preload : str or None
        A module that the fork server imports before it forks the first worker.
    """
    # Windows has no fork server, and a forked child only one that is not its own.
    if sys.platform == "win32" or os.getpid() != _IMPORTED_IN:
        return multiprocessing.get_context("spawn"), None
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([preload] if preload else [])
    # Ctrl-C reaches the whole process group, and would interrupt the fork server while it imports. Processes inherit
    # the signals that the thread which starts them blocks; other threads are not affected. The tracker of resources
    # comes first: starting it lifts the block.
    resource_tracker.ensure_running()
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    return context, _choose_socket_folder()


def start_worker(
    context: Any, number: int, folder: str | None, preload: str | None, counter: ArrayHandle, timeout_s: float
) -> tuple[Any, Connection]:
    """Start one worker process; return it and our end of its pipe, on which a stuck message fails after `timeout_s`."""
    ours, theirs = context.Pipe()
    _limit_transfer(ours, timeout_s)
    arguments = (theirs, folder, preload, counter)
    process = context.Process(target=serve, args=arguments, name=f"{_WORKER_NAME}{number}", daemon=True)
    with _hidden_name_of_no_script():
        process.start()
    theirs.close()
    return process, ours


def _disown_workers() -> None:
    """Keep a forked child from stopping its parent's workers when it ends, as multiprocessing would."""
    global _hiding
    _hiding = threading.Lock()  # a thread that the child does not have may hold the parent's
    # What multiprocessing does itself in the children that it forks.
    children: set[Any] = getattr(multiprocessing.process, "_children", set())
    children.difference_update([process for process in children if process.name.startswith(_WORKER_NAME)])


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_disown_workers)


def _choose_socket_folder() -> str:
    """Return the folder for the fork server's socket: this process's own, unless `multiprocessing` has one already.

    A child process inherits its parent's, which is not its own: the workers of a killed child would remove it.
    """
    settings = multiprocessing.current_process()._config  # type: ignore[attr-defined] # as `get_temp_dir` itself does
    if settings.get("tempdir") is None or multiprocessing.parent_process() is not None:
        settings["tempdir"] = str(get_run_folder())
    return get_temp_dir()


@contextmanager
def _hidden_name_of_no_script() -> Iterator[None]:
    """Hide the main module's file if it is named <stdin>: a worker would look for that file, and die."""
    main = sys.modules["__main__"]
    with _hiding:
        name = getattr(main, "__file__", None)
        if name is None or not name.startswith("<"):
            yield
            return
        del main.__file__
        try:
            yield
        finally:
            main.__file__ = name


def _limit_transfer(connection: Connection, timeout_s: float) -> None:
    """Make a message that is stuck half-way fail with `BlockingIOError`: its pipe is full, or it ends too early."""
    if sys.platform == "win32":
        return  # a pipe there has no such limit
    seconds, fraction = divmod(timeout_s, 1)
    limit = struct.pack("ll", int(seconds), max(1, int(fraction * 1e6)))
    with socket.socket(fileno=os.dup(connection.fileno())) as end:
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)
        end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, limit)
