"""Wall time of the phases of one job."""

from __future__ import annotations

import time
from collections.abc import Mapping


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


def add_total(phases_ms: Mapping[str, float], total_ms: float) -> dict[str, float]:
    """Return the phases, the rest of the wall time as ``"other"``, and all of it as ``"total"``."""
    # A device's clock may run a little fast: there is no time below zero.
    return {**phases_ms, "other": max(total_ms - sum(phases_ms.values()), 0.0), "total": total_ms}
