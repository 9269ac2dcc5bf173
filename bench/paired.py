"""Two things measured in turn in one run, so that a drift of the machine's speed meets both."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

DEFAULT_RUNS = 7


def measure_ms(task: Callable[[], Any]) -> float:
    """Return how long one call takes."""
    begin = time.perf_counter()
    task()
    return (time.perf_counter() - begin) * 1e3


def compare(title: str, ours: Callable[[], float], theirs: Callable[[], float], *, runs: int = DEFAULT_RUNS) -> float:
    """Measure two things A B A B ..., print both medians, and return the median of the ratios ours / theirs.

    Parameters
    ----------
    title : str
        What is printed in front.
    ours, theirs : function
        Does the work once and returns its milliseconds.
    runs : int
        Counted runs of each, after one that is not counted.
    """
    ours()
    theirs()
    pairs = [(ours(), theirs()) for _ in range(runs)]
    ratio = statistics.median(a / b for a, b in pairs)
    median_ours, median_theirs = (statistics.median(column) for column in zip(*pairs, strict=True))
    print(f"\n{title}: {median_ours:.1f} ms, peer {median_theirs:.1f} ms, ratio {ratio:.2f} (median of {runs} pairs)")
    return ratio
