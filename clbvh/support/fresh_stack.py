"""Imports by a thread of their own, which begins with an empty stack.

CPython (seen in 3.11) keeps the frames of Python functions in pieces of 16 KiB. A loop that calls a function across the
end of a piece asks the system for memory at every call, and gives it back: 7 us instead of 0.1. Where the pieces end
depends on all callers. The rules of numba's casts are 15,000 calls in one loop, and below the command line they met an
end: 15,071 mappings, 0.11 of 0.95 s of processor time of `clbvh render bun_zipper.ply` on a 2-core x86-64 server. From
an empty stack the same import needs 350, wherever it is asked for.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from importlib import import_module
from threading import Thread


def import_on_fresh_stack(name: str) -> None:
    """Import a module that may call a lot, unless it has been imported.

    An error is left to the `import` statement that follows.
    """
    if name in sys.modules:
        return
    thread = Thread(target=_try_import, args=(name,), name="clbvh-import")
    with suppress(RuntimeError):  # the system has no more threads: the statement imports it
        thread.start()
        thread.join()


def _try_import(name: str) -> None:
    with suppress(Exception):
        import_module(name)
