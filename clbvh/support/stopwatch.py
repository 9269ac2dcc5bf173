"""Wall time of the phases of one job."""

from __future__ import annotations

import time


class Stopwatch:
    """Notes how long each phase took, in milliseconds.

    Attributes
    ----------
    laps_ms : dict of str to float
        Phase name to milliseconds, in the order in which the phases ended.
    """

    def __init__(self) -> None:
        self.laps_ms: dict[str, float] = {}
        self._begin = self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """End a phase that began with the previous one's end; laps of the same name add up."""
        now = time.perf_counter()
        self.laps_ms[name] = self.laps_ms.get(name, 0.0) + (now - self._last) * 1e3
        self._last = now

    @property
    def total_ms(self) -> float:
        """Milliseconds since the watch was made."""
        return (time.perf_counter() - self._begin) * 1e3
