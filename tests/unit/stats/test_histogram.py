"""Histograms that fit."""

from __future__ import annotations

import pytest

from clbvh.stats.tree_stats import Bar, gather_bars


def test_a_short_histogram_stays_as_it_is():
    assert gather_bars([0, 5, 0, 2, 0], 3) == [Bar(1, 1, 5), Bar(2, 2, 0), Bar(3, 3, 2)]


def test_a_long_one_is_gathered_into_equal_bars():
    assert gather_bars([0, 0, 1, 2, 3, 4, 5, 0], 2) == [Bar(2, 4, 6), Bar(5, 6, 9)]


@pytest.mark.parametrize("most_bars", [1, 2, 7, 16, 99, 100, 101])
def test_nothing_is_lost_and_it_fits(most_bars):
    counts = [0, *range(1, 101)]
    bars = gather_bars(counts, most_bars)
    assert len(bars) <= most_bars
    assert sum(bar.count for bar in bars) == sum(counts)
    assert [bar.first for bar in bars[1:]] == [bar.last + 1 for bar in bars[:-1]]
    assert (bars[0].first, bars[-1].last) == (1, 100)


@pytest.mark.parametrize("counts", [[], [0, 0]])
def test_nothing_gives_nothing(counts):
    assert gather_bars(counts, 5) == []


def test_labels():
    assert (Bar(3, 3, 1).label, Bar(3, 5, 1).label) == ("3", "3 to 5")
