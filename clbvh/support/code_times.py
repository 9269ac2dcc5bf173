"""The time that this process spends on getting machine code: compiling it, or loading it from a cache.

Host functions and device kernels count alike, in all threads. Overlapping intervals, nested or of several threads,
count once, so a `Stopwatch` can subtract the time from the phase in which it was spent. Must not know who compiles, nor
who shows the times.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import NamedTuple

_MS_PER_S = 1e3


class CodeTimes(NamedTuple):
    """Sums since the process began.

    Attributes
    ----------
    compile_ms : float
        Wall time in which something was compiled.
    load_ms : float
        Wall time in which compiled code was loaded, and nothing compiled.
    compiled_count, loaded_count : int
        Functions and kernels.
    """

    compile_ms: float = 0.0
    load_ms: float = 0.0
    compiled_count: int = 0
    loaded_count: int = 0

    def since(self, earlier: CodeTimes) -> CodeTimes:
        """Return the sums since an earlier moment."""
        return CodeTimes(
            self.compile_ms - earlier.compile_ms,
            self.load_ms - earlier.load_ms,
            self.compiled_count - earlier.compiled_count,
            self.loaded_count - earlier.loaded_count,
        )


class _Clock:
    """The open intervals of all threads, and the sums; all under one lock."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.compiling = self.loading = 0  # intervals that are open
        self.last_s = 0.0
        self.compile_s = self.load_s = 0.0
        self.compiled_count = self.loaded_count = 0

    def advance(self) -> None:
        """Add the time since the last change to the sum of the open intervals."""
        now_s = time.perf_counter()
        if self.compiling:
            self.compile_s += now_s - self.last_s
        elif self.loading:
            self.load_s += now_s - self.last_s
        self.last_s = now_s


_clock = _Clock()
_listeners: list[Callable[[], None]] = []  # one at most


def read_code_times() -> CodeTimes:
    """Return the sums up to now."""
    with _clock.lock:
        _clock.advance()
        return CodeTimes(
            _clock.compile_s * _MS_PER_S, _clock.load_s * _MS_PER_S, _clock.compiled_count, _clock.loaded_count
        )


def on_first_compilation(listener: Callable[[], None] | None) -> None:
    """Register a function that is called once, from any thread, when the next compilation begins.

    It replaces the previous one; None removes it.
    """
    _listeners[:] = [] if listener is None else [listener]


def announce_compilation() -> None:
    """Call the registered function, if there is one."""
    try:
        listener = _listeners.pop()
    except IndexError:
        return
    listener()


class CompilingCode:
    """A `with` block in which one thing is compiled.

    Parameters
    ----------
    counts : bool
        False for the rest of a compilation that has been counted.
    """

    def __init__(self, *, counts: bool = True) -> None:
        self._counts = counts

    def __enter__(self) -> None:
        with _clock.lock:
            _clock.advance()
            _clock.compiling += 1
        announce_compilation()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with _clock.lock:
            _clock.advance()
            _clock.compiling -= 1
            _clock.compiled_count += self._counts and error is None


class LoadingCode:
    """A `with` block in which one thing is loaded or found missing; or compiled, if that is known only afterwards.

    Attributes
    ----------
    is_loaded, is_compiled : bool
        The outcome, to be set inside the block. A `CompilingCode` inside the block counts for itself.
    apart_ms : float
        Time inside the block that does not count, to be set inside the block.
    """

    def __init__(self) -> None:
        self.is_loaded = self.is_compiled = False
        self.apart_ms = 0.0

    def __enter__(self) -> LoadingCode:
        with _clock.lock:
            _clock.advance()
            _clock.loading += 1
            self._load_s = _clock.load_s
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with _clock.lock:
            _clock.advance()
            _clock.loading -= 1
            # At most the time that was added inside the block: none while another thread compiled.
            _clock.load_s -= min(self.apart_ms / _MS_PER_S, _clock.load_s - self._load_s)
            if self.is_compiled:
                _clock.compile_s += _clock.load_s - self._load_s
                _clock.load_s = self._load_s
            _clock.compiled_count += self.is_compiled
            _clock.loaded_count += self.is_loaded


def _forget() -> None:
    """Reset the lock and the open intervals in a forked child, which has none of the other threads."""
    _clock.lock = threading.Lock()
    _clock.compiling = _clock.loading = 0


if hasattr(os, "register_at_fork"):  # Windows does not fork
    os.register_at_fork(after_in_child=_forget)
