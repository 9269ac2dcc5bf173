"""The time of a driver for getting a kernel: it compiles the kernel, or takes it from a cache of its own.

A driver does not say which, but the times are far apart: PoCL 3.0 takes 0.4 to 1.3 s to compile a program and 0.4 to
0.7 s more when a kernel is launched for the first time with a size of work-groups, against 15 to 70 ms and 1 to 13 ms
with its cache, on a 2-core x86-64 server.
"""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from types import TracebackType

from ..support.code_times import LoadingCode, announce_compilation

# A step that takes longer is a compilation.
_LONGEST_LOAD_S = 0.25


class GettingKernel:
    """A `with` block in which a driver builds a program, or launches a kernel in a way in which it has not before.

    Parameters
    ----------
    announces : bool
        Whether to announce the compilation as soon as it is known for one; not where a kernel may run for long.

    Attributes
    ----------
    run_ms : float
        Time in which the kernel ran, to be set inside the block.
    """

    def __init__(self, *, announces: bool) -> None:
        self.run_ms = 0.0
        self._loading = LoadingCode()
        # A driver that holds Python's lock meanwhile lets it be said afterwards.
        self._timer = threading.Timer(_LONGEST_LOAD_S, announce_compilation)
        self._timer.daemon = True
        self._announces = announces

    def __enter__(self) -> GettingKernel:
        self._begin = time.perf_counter()
        self._loading.__enter__()
        if self._announces:
            with suppress(RuntimeError):  # the system has no more threads
                self._timer.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._timer.cancel()
        self._loading.apart_ms = self.run_ms
        self._loading.is_compiled = time.perf_counter() - self._begin - self.run_ms * 1e-3 > _LONGEST_LOAD_S
        self._loading.is_loaded = not self._loading.is_compiled
        self._loading.__exit__(kind, error, trace)
