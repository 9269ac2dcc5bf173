"""Histograms for little space: neighbouring values are gathered into bars of equal width."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Bar:
    """The number of occurrences of the values from `first` to `last`, both included."""

    first: int
    last: int
    count: int

    @property
    def label(self) -> str:
        """The text beside the bar."""
        return str(self.first) if self.first == self.last else f"{self.first} to {self.last}"


def gather_bars(counts: Sequence[int], most_bars: int) -> list[Bar]:
    """Gather a histogram into bars of equal width.

    Parameters
    ----------
    counts : sequence of int
        Numbers of occurrences of 0, 1, 2, ...
    most_bars : int
        The number of bars that fit.

    Returns
    -------
    list of Bar
        From the lowest occurring value to the highest; empty if none occurs.
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
