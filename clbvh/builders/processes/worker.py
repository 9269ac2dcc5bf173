"""The life of a worker process: read a task, run it, write the answer, until the coordinator closes the pipe."""

from __future__ import annotations

import os
import pickle
import sys
import traceback
from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from .shared_memory import ArrayHandle


def serve() -> None:
    """Answer messages on the standard input with (True, result) or (False, traceback) on the standard output.

    A message is a pickle of the pickled (handles, step, task): unpacking the inner one imports the step, and belongs to
    the work. The process ends when the pipe does: the pool was closed, or the coordinator is gone, however it went.
    """
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # a step's own output must not mix with the answers
    attached: dict[str, tuple[ArrayHandle, NDArray[Any]]] = {}
    try:
        while True:
            message = pickle.load(sys.stdin.buffer)
            try:
                handles, step, task = pickle.loads(message)
                answer = pickle.dumps((True, step(_attach(attached, handles), *task)))
            except Exception:
                answer = pickle.dumps((False, traceback.format_exc()))
            pickle.dump(answer, answers)
            answers.flush()
    except (EOFError, OSError):
        os._exit(0)  # without another try to write the answer


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
