"""Statistics of samples: medians with their range, Amdahl's law, growth, and the use of lanes."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

# A figure whose samples lie further apart than this, relative to the median, is called noisy.
NOISY_SPREAD = 0.25


@dataclass(frozen=True)
class Summary:
    """Samples of one quantity.

    Attributes
    ----------
    median, low, high : float
        The median, the smallest and the largest sample; NaN without samples.
    count : int
        The number of samples.
    """

    median: float
    low: float
    high: float
    count: int

    @classmethod
    def of(cls, samples: Sequence[float]) -> Summary:
        """Return the summary of samples; not a number without any."""
        if not samples:
            return cls(math.nan, math.nan, math.nan, 0)
        return cls(statistics.median(samples), min(samples), max(samples), len(samples))

    @property
    def spread(self) -> float:
        """Largest minus smallest sample, relative to the median; 0 where the median is 0."""
        return (self.high - self.low) / abs(self.median) if self.median else 0.0

    @property
    def is_noisy(self) -> bool:
        """Whether the samples lie further apart than `NOISY_SPREAD`."""
        return self.spread > NOISY_SPREAD

    def scaled(self, factor: float) -> Summary:
        """Return the summary of the samples times a positive factor: another unit."""
        return Summary(self.median * factor, self.low * factor, self.high * factor, self.count)

    def rate(self, amount: float) -> Summary:
        """Return the summary of `amount` over the samples: a speed, from times."""
        return Summary(amount / self.median, amount / self.high, amount / self.low, self.count)


def fit_amdahl(times: Mapping[int, float]) -> float:
    """Return the serial fraction that fits times on 1, 2, ... workers best.

    Parameters
    ----------
    times : mapping of int to float
        Number of workers to time; 1 and at least one other.

    Returns
    -------
    float
        The s, from 0 to 1, of T(w) = T(1) (s + (1 - s) / w), by least squares of T(w) / T(1). NaN if there is no time
        for one worker, or none for more.

    Notes
    -----
    G. Amdahl, "Validity of the single processor approach to achieving large scale computing capabilities", 1967.
    """
    if 1 not in times or len(times) < 2:
        return math.nan
    # T(w) / T(1) - 1 / w = s (1 - 1 / w): a line through the origin.
    x = np.array([1 - 1 / workers for workers in times])
    y = np.array([time / times[1] - 1 / workers for workers, time in times.items()])
    return float(np.clip((x @ y) / (x @ x), 0.0, 1.0))


def amdahl_speedup(serial: float, workers: float) -> float:
    """Return the speed-up that a serial fraction allows."""
    return 1 / (serial + (1 - serial) / workers)


def growth_exponent(sizes: Sequence[float], times: Sequence[float]) -> float:
    """Return the p of time = c size^p, by least squares of the logarithms; NaN for fewer than two sizes."""
    if len(set(sizes)) < 2:
        return math.nan
    slope, _ = np.polyfit(np.log(sizes), np.log(times), 1)
    return float(slope)


def lane_use(work: ArrayLike, width: int, *, rows: int = 1) -> float:
    """Return the share of lanes that work while groups of neighbouring work-items run in lockstep.

    Parameters
    ----------
    work : (height, width) int
        The work of each pixel, in steps.
    width : int
        Work-items in a group.
    rows : int, optional
        Rows of pixels that a group covers; `width` is a multiple of it. Groups at the border are left out.

    Returns
    -------
    float
        The work of all groups over the time of all lanes: a group takes as long as its longest work-item. This is mean
        over maximum within a group, each group weighted by its time, as a hardware counter of active lanes sees it.
        NaN where no group fits, or nothing works.
    """
    work = np.asarray(work, np.int64)
    columns = width // rows
    height, length = work.shape[0] // rows * rows, work.shape[1] // columns * columns
    tiles = work[:height, :length].reshape(height // rows, rows, length // columns, columns)
    groups = tiles.transpose(0, 2, 1, 3).reshape(-1, width)
    lane_time = width * int(groups.max(axis=1, initial=0).sum()) if groups.size else 0
    return int(groups.sum()) / lane_time if lane_time else math.nan
