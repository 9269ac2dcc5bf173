"""The life of a worker process: read a task, run it, write the answer, until the coordinator closes the pipe."""

from __future__ import annotations

import signal
import traceback
from collections.abc import Mapping
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from typing import Any

from numpy.typing import NDArray

from .shared_memory import ArrayHandle


def serve(pipe: Connection) -> None:
    """Answer messages (handles, step, task) with (True, result) or (False, traceback).

    The process ends when the pipe does: the pool was closed, or the coordinator is gone, however it went.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the coordinator alone decides what Ctrl-C means
    attached: dict[str, tuple[ArrayHandle, NDArray[Any]]] = {}
    while True:
        try:
            message = pipe.recv_bytes()
        except (EOFError, OSError):
            return
        try:
            # Unpacking the message imports the step, and belongs to the work.
            handles, step, task = ForkingPickler.loads(message)
            answer = ForkingPickler.dumps((True, step(_attach(attached, handles), *task)))
        except Exception:
            answer = ForkingPickler.dumps((False, traceback.format_exc()))
        try:
            pipe.send_bytes(answer)
        except OSError:
            return


def _attach(
    attached: dict[str, tuple[ArrayHandle, NDArray[Any]]], handles: Mapping[str, ArrayHandle]
) -> dict[str, NDArray[Any]]:
    """Return the arrays of these handles, and let go of all others."""
    for name in [name for name, (handle, _) in attached.items() if handles.get(name) != handle]:
        del attached[name]
    for name, handle in handles.items():
        if name not in attached:
            attached[name] = (handle, handle.attach())
    return {name: array for name, (_, array) in attached.items()}
