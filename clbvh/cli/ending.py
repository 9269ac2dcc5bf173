"""The end of a command, without the end of the interpreter.

Owns the last function at exit. Before it, Python has waited for threads and called all other functions at exit, so
nothing is left to write or to remove. What would follow gives memory back, module by module, function by function of
compiled code, and driver by driver, which the system does at once: 0.05 s of `clbvh render bun_zipper.ply` on a 2-core
x86-64 server.
"""

from __future__ import annotations

import atexit
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def ending_at_once() -> Iterator[None]:
    """Let the process end at once if the block raises `SystemExit`, after all functions at exit.

    Enter it before other functions are registered with `atexit`, so that its own runs after them.
    """
    codes: list[object] = []
    atexit.register(_end, codes)
    try:
        yield
    except SystemExit as ended:
        codes.append(ended.code)
        raise


def _end(codes: list[object]) -> None:
    """End the process, or return if Python has something to say: about another exception, or a text as exit code."""
    code = codes[0] if codes else "an exception"
    if code is None or isinstance(code, int):
        with suppress(OSError, ValueError):  # Python says that a stream cannot be written to, or is closed
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code or 0)
