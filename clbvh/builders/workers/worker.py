"""The life of a worker process: import what its steps need, then answer until the pipe closes."""

from __future__ import annotations

import importlib
import multiprocessing
import shutil
import signal
import traceback
from collections.abc import Callable, Mapping, Sequence
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .arena import ArrayHandle

# Kinds of messages, each with its content.
ATTACH = "attach"  # name -> ArrayHandle
RUN = "run"  # step function, arguments
TAKE = "take"  # step function, arguments of all tasks
STOP = "stop"

# A coordinator that was killed closes its pipes one after the other, within this time.
_DEATH_TAKES_S = 1.0


def serve(connection: Connection, folder: str | None, preload: str | None, counter: ArrayHandle) -> None:
    """Answer the messages of a `WorkerPool` with (True, result) or (False, traceback).

    The loop ends with STOP, or when the pipe closes because the coordinator is gone, however it went.

    Parameters
    ----------
    connection : Connection
    folder : str or None
        The coordinator's folder for the sockets of `multiprocessing`. It removes that itself unless it is killed.
    preload : str or None
        The name of a module to import first.
    counter : ArrayHandle
        The number of the next task, which all workers share.
    """
    # Ctrl-C reaches the whole process group. The coordinator decides what it means; workers follow its pipe.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if preload is not None:
        importlib.import_module(preload)  # a fork server has done so already

    attached: dict[str, _Attached] = {}
    try:
        next_task = counter.attach()  # an error of the system if the coordinator is gone already
        connection.send((True, None))  # ready
        while True:
            packed = connection.recv_bytes()
            # Unpacking and packing belong to the work: a step that cannot be imported here is reported too.
            try:
                message = ForkingPickler.loads(packed)
                if message[0] == STOP:
                    return
                answer = ForkingPickler.dumps((True, _answer(message, attached, next_task)))
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


def _answer(message: tuple[Any, ...], attached: dict[str, _Attached], next_task: NDArray[np.int64]) -> Any:
    arrays = {name: item.array for name, item in attached.items()}
    if message[0] == RUN:
        _, step, arguments = message
        return step(arrays, *arguments)
    if message[0] == TAKE:
        _, step, tasks = message
        return _take_tasks(next_task, step, arrays, tasks)

    # Keep the memory that stays, drop the rest before mapping anything new.
    _, handles = message
    del arrays
    memories = {item.serial: item.memory for item in attached.values()}
    attached.clear()
    wanted = {handle.serial for handle in handles.values()}
    memories = {serial: memory for serial, memory in memories.items() if serial in wanted}
    for name, handle in handles.items():
        memory = memories.get(handle.serial) or handle.map()
        attached[name] = _Attached(handle.serial, memory, handle.view(memory))
    return None


def _take_tasks(
    next_task: NDArray[np.int64],
    step: Callable[..., Any],
    arrays: Mapping[str, NDArray[Any]],
    tasks: Sequence[tuple[Any, ...]],
) -> list[tuple[int, Any]]:
    """Run a step for one task after the other that no other worker has taken; return their numbers and results."""
    # The coordinator imports this module too, and needs no compiled function for it.
    from .task_counter import take_number

    results = []
    while (number := take_number(next_task)) < len(tasks):
        results.append((number, step(arrays, *tasks[number])))
    return results
