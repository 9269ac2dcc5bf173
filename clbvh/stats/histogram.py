"""Histograms that have to fit somewhere: long ones are gathered into a few bars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Bar:
    """How often values from `first` to `last` occur, both included."""

    first: int
    last: int
    count: int

    @property
    def label(self) -> str:
        """What stands beside the bar."""
        return str(self.first) if self.first == self.last else f"{self.first} to {self.last}"


def gather_bars(counts: Sequence[int], most_bars: int) -> list[Bar]:
    """Gather a histogram into bars of equal width.

    Parameters
    ----------
    counts : sequence of int
        How often 0, 1, 2, ... occur.
    most_bars : int
        As many as fit.

    Returns
    -------
    list of Bar
        From the lowest value that occurs to the highest one; empty when none does.
    """
    occurring = [value for value, count in enumerate(counts) if count > 0]
    if not occurring:
        return []
    first, last = occurring[0], occurring[-1]
    width = -(-(last + 1 - first) // most_bars)
    return [
        Bar(begin, min(begin + width - 1, last), sum(counts[begin : begin + width]))
        for begin in range(first, last + 1, width)
    ]
