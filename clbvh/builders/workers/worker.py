"""The life of a worker process: import what its steps need, then answer until the pipe closes."""

from __future__ import annotations

import importlib
import multiprocessing
import shutil
import signal
import traceback
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from typing import Any, NamedTuple

from numpy.typing import NDArray

# Kinds of messages, each with its content.
ATTACH = "attach"  # name -> ArrayHandle
RUN = "run"  # step function, arguments
STOP = "stop"

# A coordinator that was killed closes its pipes one after the other, within this time.
_DEATH_TAKES_S = 1.0


def serve(connection: Connection, folder: str | None, preload: str | None) -> None:
    """Answer the messages of a `WorkerPool` with (True, result) or (False, traceback).

    The loop ends with STOP, or when the pipe closes because the coordinator is gone, however it went.

    Parameters
    ----------
    connection : Connection
    folder : str or None
        The coordinator's folder for the sockets of `multiprocessing`. It removes that itself unless it is killed.
    preload : str or None
        The name of a module to import first.
    """
    # Ctrl-C reaches the whole process group. The coordinator decides what it means; workers follow its pipe.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if preload is not None:
        importlib.import_module(preload)  # a fork server has done so already

    attached: dict[str, _Attached] = {}
    try:
        connection.send((True, None))  # ready
        while True:
            packed = connection.recv_bytes()
            # Unpacking and packing belong to the work: a step that cannot be imported here is reported too.
            try:
                message = ForkingPickler.loads(packed)
                if message[0] == STOP:
                    return
                answer = ForkingPickler.dumps((True, _answer(message, attached)))
            except Exception:
                answer = ForkingPickler.dumps((False, traceback.format_exc()))
            connection.send_bytes(answer)
    except (EOFError, OSError):
        coordinator = multiprocessing.parent_process()
        if folder is None or coordinator is None:
            return
        coordinator.join(_DEATH_TAKES_S)
        if not coordinator.is_alive():
            shutil.rmtree(folder, ignore_errors=True)  # other workers do the same


class _Attached(NamedTuple):
    """An array, and the memory that it lies in."""

    serial: int
    memory: Any
    array: NDArray[Any]


def _answer(message: tuple[Any, ...], attached: dict[str, _Attached]) -> Any:
    if message[0] == RUN:
        _, step, arguments = message
        return step({name: item.array for name, item in attached.items()}, *arguments)

    # Keep the memory that stays, drop the rest before mapping anything new.
    _, handles = message
    memories = {item.serial: item.memory for item in attached.values()}
    attached.clear()
    wanted = {handle.serial for handle in handles.values()}
    memories = {serial: memory for serial, memory in memories.items() if serial in wanted}
    for name, handle in handles.items():
        memory = memories.get(handle.serial) or handle.map()
        attached[name] = _Attached(handle.serial, memory, handle.view(memory))
    return None
