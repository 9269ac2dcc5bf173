"""The life of a worker process: load the compiled code, then answer until the pipe closes."""

from __future__ import annotations

import signal
import traceback
from multiprocessing.connection import Connection
from typing import Any

# What a message asks for, and what follows it.
ATTACH = "attach"  # name -> ArrayHandle
RUN = "run"  # step function, arguments
STOP = "stop"


def serve(connection: Connection) -> None:
    """Answer the messages of a `SubtreePool` with (True, result) or (False, traceback).

    The loop ends with STOP, or when the pipe closes because the coordinator is gone, however it went.
    """
    # Ctrl-C reaches the whole process group. The coordinator decides what it means; workers follow its pipe.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Done already where a fork server started this process.
    from . import preload  # noqa: F401

    attached: dict[str, tuple[Any, Any]] = {}  # name -> (handle, array)
    try:
        connection.send((True, None))  # ready
        while True:
            message = connection.recv()
            if message[0] == STOP:
                return
            try:
                answer: tuple[bool, Any] = (True, _answer(message, attached))
            except Exception:
                answer = (False, traceback.format_exc())
            connection.send(answer)
    except (EOFError, OSError):
        return


def _answer(message: tuple[Any, ...], attached: dict[str, tuple[Any, Any]]) -> Any:
    if message[0] == RUN:
        _, step, arguments = message
        return step({name: array for name, (_, array) in attached.items()}, *arguments)

    # Keep what stays, drop the rest before mapping anything new.
    _, handles = message
    kept = {name: pair for name, pair in attached.items() if pair[0] == handles.get(name)}
    attached.clear()
    attached.update(kept)
    for name, handle in handles.items():
        if name not in attached:
            attached[name] = (handle, handle.attach())
    return None
