"""The times of what ran on a device."""

from __future__ import annotations

from collections import deque
from typing import Any

from ..support.forks import make_lock
from .context import check_process

_NS_PER_MS = 1e6

# Most events held at a time: a driver keeps memory for each of them. At this number the older half is summed up, whose
# commands have long ended.
_MOST_EVENTS = 256


class CommandTimes:
    """Sums of the run times of commands, by label: ``upload``, ``kernel``, ``download``; from any thread."""

    def __init__(self) -> None:
        self._events: deque[tuple[str, Any]] = deque()
        self._lock = make_lock()
        self._sums_ms = dict.fromkeys(("upload", "kernel", "download"), 0.0)

    def note(self, label: str, event: Any) -> None:
        """Add an enqueued command; its times are read later, when the sums are wanted."""
        self._events.append((label, event))
        if len(self._events) >= _MOST_EVENTS:
            self._sum_up(_MOST_EVENTS // 2)

    def add(self, label: str, duration_ms: float) -> None:
        """Add a time that the host has measured."""
        with self._lock:
            self._sums_ms[label] += duration_ms

    def sums_ms(self) -> dict[str, float]:
        """Wait for all noted commands and return the milliseconds of each label since the start.

        Raises
        ------
        DeviceError
            This process was forked from one that has used OpenCL.
        """
        if self._events:  # none on the host, which needs no pyopencl
            check_process()
            self._sum_up(len(self._events))
        with self._lock:
            return dict(self._sums_ms)

    def _sum_up(self, count: int) -> None:
        """Add the times of the oldest `count` events to the sums, at most."""
        import pyopencl as cl

        for _ in range(count):
            try:
                label, event = self._events.popleft()
            except IndexError:  # another thread has taken it
                return
            try:
                event.wait()
                profile = event.profile
                duration = (profile.end - profile.start) / _NS_PER_MS
            except cl.Error:  # the command failed, which those who wait for its results learn
                continue
            self.add(label, duration)
