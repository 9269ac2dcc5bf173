"""An engine in a process of its own: started by spawning, asked over a pipe, and idle while others are measured."""

from __future__ import annotations

import multiprocessing
import sys
import traceback
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from ...errors import ClbvhError
from ...support.context_manager import ContextManager

_STOP_PATIENCE_S = 5.0
# An engine that does not answer for so long is given up; opening one compiles code for a minute on a slow machine.
_ANSWER_PATIENCE_S = 900.0
_FAILED = "failed"


class EngineError(ClbvhError, RuntimeError):
    """An engine's process failed or fell silent."""


class EngineProcess(ContextManager):
    """One engine with one mesh, in a process of its own.

    Parameters
    ----------
    name : str
        A key of `ENGINES`.
    folder : str
        Holds the shared arrays.

    Raises
    ------
    EngineError
        The engine cannot be opened; the message is the engine's own.
    """

    def __init__(self, name: str, folder: str) -> None:
        self._name = name
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        # No daemon: the engine of this library has worker processes.
        self._process = context.Process(target=_serve, args=(theirs, name, folder), name=f"clbvh-{name}")
        self._process.start()
        theirs.close()
        try:
            self._receive()
        except BaseException:
            self.close()
            raise

    def measure(self, query: str) -> dict[str, float]:
        """Return one sample; see `Contestant.measure`.

        Raises
        ------
        EngineError
            The engine raised, or its process died.
        """
        try:
            self._connection.send(query)
        except OSError:
            raise self._explain_death() from None
        answer: dict[str, float] = self._receive()
        return answer

    def close(self) -> None:
        """End the process. Closing twice is allowed."""
        with suppress(OSError):
            self._connection.send(None)
        self._connection.close()
        self._process.join(_STOP_PATIENCE_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def _receive(self) -> Any:
        try:
            if not self._connection.poll(_ANSWER_PATIENCE_S):
                self._process.kill()
                raise EngineError(f"{self._name} has not answered for {_ANSWER_PATIENCE_S:g} s and was stopped")
            state, value = self._connection.recv()
        except (EOFError, OSError):
            raise self._explain_death() from None
        if state == _FAILED:
            raise EngineError(f"{self._name} fails: {value}")
        return value

    def _explain_death(self) -> EngineError:
        self._process.join(_STOP_PATIENCE_S)
        return EngineError(f"the process of {self._name} died (exit code {self._process.exitcode})")


def _serve(connection: Connection, name: str, folder: str) -> None:
    """Open an engine and measure until told to stop; the life of the process."""
    from .engines import Contestant

    # Ends, too, when the study's process is gone: then the pipe is closed.
    with suppress(EOFError, OSError, KeyboardInterrupt):
        try:
            contestant = Contestant(name, folder)
        except Exception as error:
            connection.send((_FAILED, _describe(error)))
            return
        try:
            connection.send(("ready", None))
            while (query := connection.recv()) is not None:
                try:
                    answer = contestant.measure(query)
                except Exception as error:
                    connection.send((_FAILED, _describe(error)))
                else:
                    connection.send(("measured", answer))
        finally:
            contestant.close()


def _describe(error: Exception) -> str:
    """Return the last line of an error's traceback, and where it was raised."""
    frame = traceback.extract_tb(sys.exc_info()[2])[-1]
    return f"{type(error).__name__}: {error} ({frame.name})"
