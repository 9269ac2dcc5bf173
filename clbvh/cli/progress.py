"""The progress of the work on a picture, in a terminal, and the notes for its user."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

# No estimate of the time that is left before this many seconds, nor below 1 %: the first samples say little.
_LEAST_S = 0.5


class Progress:
    """Shows the phase of the work, and the time that is left, if stderr is a terminal; and keeps notes for the end.

    Attributes
    ----------
    notes : list of str
        What the user should know, for stderr.
    """

    def __init__(self) -> None:
        from rich.console import Console

        self.notes: list[str] = []
        self._begin = self._phase_begin = time.perf_counter()
        self._phase = ""
        self._status = Console(stderr=True).status("")

    def __enter__(self) -> Progress:
        self._status.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._status.stop()

    @property
    def callbacks(self) -> dict[str, Any]:
        """The functions that those who draw call with phases and notes."""
        return {"on_phase": self.enter, "on_note": self.notes.append}

    @property
    def spent_s(self) -> float:
        """Seconds since the beginning."""
        return time.perf_counter() - self._begin

    def enter(self, phase: str) -> None:
        """Show the phase that begins."""
        self._phase, self._phase_begin = phase, time.perf_counter()
        self._status.update(f"{phase} ...")

    def show_share(self, done: int, total: int) -> None:
        """Show how much of the phase is done."""
        spent = time.perf_counter() - self._phase_begin
        if spent > _LEAST_S:
            percent, left = 100 * done // total, spent * (total - done) / done
            estimate = f", about {left:.0f} s left" if percent else ""
            self._status.update(f"{self._phase}: {percent} %{estimate} ...")

    def show_samples(self, limit_s: float | None) -> Callable[[int, int], None]:
        """Return a function that shows how many samples are done, or how much of a limited time has passed."""

        def show(done: int, total: int) -> None:
            if limit_s is None:
                self.show_share(done, total)
            else:
                spent = time.perf_counter() - self._phase_begin
                self._status.update(f"{self._phase}: {spent:.0f} of {limit_s:.0f} s ...")

        return show
