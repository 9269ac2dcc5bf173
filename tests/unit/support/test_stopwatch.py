"""Laps add up, and a total accounts for the time between them."""

from __future__ import annotations

from clbvh.support.stopwatch import Stopwatch, add_total


def test_laps_of_one_name_add_up():
    watch = Stopwatch()
    for name in ("a", "b", "a"):
        watch.lap(name)
    assert list(watch.laps_ms) == ["a", "b"]
    assert 0 < sum(watch.laps_ms.values()) <= watch.total_ms


def test_a_total_is_the_sum_of_its_phases():
    times = add_total({"load": 3.0, "build": 4.0}, 10.0)
    assert times == {"load": 3.0, "build": 4.0, "other": 3.0, "total": 10.0}
    assert list(times)[-2:] == ["other", "total"]


def test_a_clock_that_runs_fast_gives_no_time_below_zero():
    assert add_total({"kernel": 10.001}, 10.0)["other"] == 0
