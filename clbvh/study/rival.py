"""An engine in a process of its own: in one process, engines disturb each other by the threads they leave running."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from multiprocessing.connection import Connection
from typing import Any

from ..errors import ClbvhError
from ..support.context_manager import ContextManager

_STOP_PATIENCE_S = 5.0
# An engine that does not answer for so long is given up; opening one compiles code for a minute on a slow machine.
_ANSWER_PATIENCE_S = 900.0


class EngineError(ClbvhError, RuntimeError):
    """An engine's process failed or fell silent."""


class Rival(ContextManager):
    """A process that answers questions, started by spawning, and idle while others are measured.

    Parameters
    ----------
    name : str
        For messages.
    set_up : function
        Of a module; called there with the arguments, it returns an object with `answer(question)` and `close()`.
    *arguments
        Are pickled.

    Raises
    ------
    EngineError
        `set_up` fails; the message is its own.
    """

    def __init__(self, name: str, set_up: Callable[..., Any], *arguments: Any) -> None:
        self._name = name
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        # No daemon: the engine of this library has worker processes.
        self._process = context.Process(target=_serve, args=(theirs, set_up, arguments), name=f"clbvh-{name}")
        self._process.start()
        theirs.close()
        try:
            self._receive()
        except BaseException:
            self.close()
            raise

    def ask(self, question: str) -> Any:
        """Return the server's answer.

        Raises
        ------
        EngineError
            The server raised, or its process died.
        """
        with suppress(OSError):  # a dead process is noticed below
            self._connection.send(question)
        return self._receive()

    def close(self) -> None:
        """End the process. Closing twice is allowed."""
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
            failure, answer = self._connection.recv()
        except (EOFError, OSError):
            self._process.join(_STOP_PATIENCE_S)
            message = f"the process of {self._name} died (exit code {self._process.exitcode})"
            raise EngineError(message) from None
        if failure:
            raise EngineError(f"{self._name} fails: {failure}")
        return answer


def _serve(connection: Connection, set_up: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    """Answer until the other end is closed, also by the death of its process; the life of the process."""
    with suppress(EOFError, OSError, KeyboardInterrupt), ExitStack() as stack:
        server, question = None, ""
        while True:
            failure, answer = "", None
            try:
                if server is None:
                    server = stack.enter_context(closing(set_up(*arguments)))
                else:
                    answer = server.answer(question)
            except Exception as error:
                failure = f"{type(error).__name__}: {error}"
            connection.send((failure, answer))
            question = connection.recv()
