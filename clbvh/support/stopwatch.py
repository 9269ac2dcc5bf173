"""Wall time of the phases of one job."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping


class Stopwatch:
    """Measures the duration of each phase, in milliseconds.

    Attributes
    ----------
    laps_ms : dict of str to float
        Phase name to milliseconds, in the order in which the phases ended.
    """

    def __init__(self) -> None:
        self.laps_ms: dict[str, float] = {}
        self._begin = self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """End the phase that began when the previous one ended; laps of the same name add up."""
        now = time.perf_counter()
        self.laps_ms[name] = self.laps_ms.get(name, 0.0) + (now - self._last) * 1e3
        self._last = now

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
