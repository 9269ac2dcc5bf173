"""Times that the device itself measured, from OpenCL events."""

from __future__ import annotations

from typing import Any

_NS_PER_MS = 1e6

# Most events held at a time: a driver keeps memory for each of them.
_MOST_EVENTS = 256


class EventTimes:
    """Sums of the run times of commands, by label: ``upload``, ``kernel``, ``download``."""

    def __init__(self) -> None:
        self._events: list[tuple[str, Any]] = []
        self._sums_ms: dict[str, float] = {}

    def note(self, label: str, event: Any) -> None:
        """Add an enqueued command; its times are read later, when the sums are wanted."""
        self._events.append((label, event))
        if len(self._events) >= _MOST_EVENTS:
            self.sums_ms()

    def sums_ms(self) -> dict[str, float]:
        """Wait for all noted commands and return the milliseconds of each label since the start."""
        for label, event in self._events:
            event.wait()
            duration = (event.profile.end - event.profile.start) / _NS_PER_MS
            self._sums_ms[label] = self._sums_ms.get(label, 0.0) + duration
        self._events.clear()
        return dict(self._sums_ms)
