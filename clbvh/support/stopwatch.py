"""Wall time of the phases of one job, without the time for getting machine code, which is a phase of its own."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping

from .code_times import CodeTimes, read_code_times


class Stopwatch:
    """Measures the duration of each phase, in milliseconds.

    Attributes
    ----------
    laps_ms : dict of str to float
        Phase name to milliseconds, in the order in which the phases ended. Compiling functions and kernels, and loading
        compiled ones, in any thread, is no part of them: see `code_ms`.
    """

    def __init__(self) -> None:
        self.laps_ms: dict[str, float] = {}
        self._begin = self._last = time.perf_counter()
        self._code_begin = self._code_last = read_code_times()

    def lap(self, name: str) -> None:
        """End the phase that began when the previous one ended; laps of the same name add up."""
        # In the order of __init__, so that the code's time lies within that of the lap.
        now = time.perf_counter()
        code = read_code_times()
        spent = code.since(self._code_last)
        # Two clocks are read one after the other, and another thread may be compiling between: no time below zero.
        lap_ms = max((now - self._last) * 1e3 - spent.compile_ms - spent.load_ms, 0.0)
        self.laps_ms[name] = self.laps_ms.get(name, 0.0) + lap_ms
        self._last, self._code_last = now, code

    @property
    def code(self) -> CodeTimes:
        """The time for machine code since the watch was made."""
        return read_code_times().since(self._code_begin)

    @property
    def code_ms(self) -> dict[str, float]:
        """Milliseconds for machine code since the watch was made, as phases: ``"compile"`` and ``"load_code"``."""
        code = self.code
        return {"compile": code.compile_ms, "load_code": code.load_ms}

    @property
    def total_ms(self) -> float:
        """Milliseconds since the watch was made."""
        return (time.perf_counter() - self._begin) * 1e3


def add_total(
    phases_ms: Mapping[str, float], total_ms: float, *, overlapping: Collection[str] = ()
) -> dict[str, float]:
    """Return the phases, the time between them as ``"other"``, and their sum as ``"total"``.

    Parameters
    ----------
    phases_ms : mapping of str to float
    total_ms : float
        Wall time of the whole job.
    overlapping : collection of str
        Phases that run during others, and so are no part of the sum.
    """
    known_ms = sum(ms for phase, ms in phases_ms.items() if phase not in overlapping)
    # A device's clock may run a little fast: there is no time below zero.
    return {**phases_ms, "other": max(total_ms - known_ms, 0.0), "total": total_ms}
