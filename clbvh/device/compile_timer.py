"""Times how long a driver takes to compile a kernel, or to load it from a cache of its own.

A driver does not say which of the two it does, but the times are far apart: PoCL 3.0 takes 0.4 to 1.3 s to compile a
program and 0.4 to 0.7 s more when a kernel is launched for the first time with a size of work-groups, against 15 to 70
ms and 1 to 13 ms with its cache, on a 2-core x86-64 server.
"""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from types import TracebackType

from ..support.code_times import LoadingCode, announce_compilation

# A step that takes longer than this is a compilation: by the clock, and in the processor's time, because a busy machine
# makes everything slow by the clock. A compiler in a process of its own, as on macOS, therefore counts as loading.
_LONGEST_LOAD_S = 0.25

# A compilation keeps a processor busy for more than this share of the time.
_MOST_OF_A_STEP = 0.5


class CompileTimer:
    """A `with` block in which a driver builds a program, or launches a kernel for the first time with a size.

    Parameters
    ----------
    announces : bool
        Whether a compilation is announced while it lasts. False where a kernel runs inside the block: a long run would
        be announced as a compilation, so it is announced afterwards.

    Attributes
    ----------
    run_ms : float
        Time in which the kernel ran, to be set inside the block. It does not count.
    """

    def __init__(self, *, announces: bool) -> None:
        self.run_ms = 0.0
        self._loading = LoadingCode()
        # Announces late if the driver holds Python's lock while it compiles.
        self._timer = threading.Timer(_LONGEST_LOAD_S, self._announce_if_known)
        self._timer.daemon = True
        self._announces = announces

    def __enter__(self) -> CompileTimer:
        self._begin = time.perf_counter()
        self._cpu_begin = time.process_time()
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
        took_s = min(time.perf_counter() - self._begin, time.process_time() - self._cpu_begin)
        self._loading.is_compiled = took_s - self.run_ms * 1e-3 > _LONGEST_LOAD_S
        self._loading.is_loaded = not self._loading.is_compiled
        self._loading.__exit__(kind, error, trace)
        if self._loading.is_compiled:
            announce_compilation()

    def _announce_if_known(self) -> None:
        """Announce a compilation while it lasts, unless the processor has been busy with something else."""
        if time.process_time() - self._cpu_begin > _MOST_OF_A_STEP * _LONGEST_LOAD_S:
            announce_compilation()
