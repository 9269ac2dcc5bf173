"""Statistics against formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clbvh.study.statistics import NOISY_SPREAD, Summary, amdahl_speedup, fit_amdahl, growth_exponent, lane_use


def test_summary_of_samples():
    summary = Summary.of([4.0, 1.0, 3.0])
    assert (summary.median, summary.low, summary.high, summary.count) == (3, 1, 4, 3)
    assert summary.spread == 1
    assert Summary.of([2.0, 4.0]).median == 3
    assert math.isnan(Summary.of([]).scaled(2).rate(3).median)


@pytest.mark.parametrize(("high", "is_noisy"), [(1 + 0.9 * NOISY_SPREAD, False), (1 + 1.1 * NOISY_SPREAD, True)])
def test_noise_is_a_wide_spread(high, is_noisy):
    assert Summary.of([1.0, 1.0, high]).is_noisy is is_noisy


def test_rates_turn_the_range_around():
    rate = Summary.of([2.0, 4.0, 5.0]).rate(20)
    assert (rate.median, rate.low, rate.high) == (5, 4, 10)


def test_scaling_keeps_the_spread():
    summary = Summary.of([2.0, 3.0, 5.0])
    assert summary.scaled(1e3).spread == summary.spread
    assert summary.scaled(1e3).low == 2e3


@pytest.mark.parametrize("serial", [0.0, 0.1, 0.5, 1.0])
def test_the_fit_of_amdahls_law_finds_the_fraction_it_was_made_with(serial):
    times = {workers: 50 * (serial + (1 - serial) / workers) for workers in (1, 2, 4, 8)}
    assert fit_amdahl(times) == pytest.approx(serial)
    assert amdahl_speedup(serial, 8) == pytest.approx(times[1] / times[8])


def test_the_reports_serial_fraction():
    # (1 / 4.714 - 1 / 8) / (1 - 1 / 8).
    assert fit_amdahl({1: 2687, 8: 570}) == pytest.approx((570 / 2687 - 1 / 8) / (7 / 8))


@pytest.mark.parametrize("times", [{}, {1: 3.0}, {2: 3.0, 4: 2.0}])
def test_no_fit_without_one_worker_and_another_number(times):
    assert math.isnan(fit_amdahl(times))


@pytest.mark.parametrize(("times", "serial"), [({1: 1.0, 2: 0.1}, 0.0), ({1: 1.0, 2: 5.0}, 1.0)])
def test_a_serial_fraction_stays_from_0_to_1(times, serial):
    assert fit_amdahl(times) == serial


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0, 2.0])
def test_growth_exponent_of_a_power(power):
    sizes = [10, 100, 1000]
    assert growth_exponent(sizes, [7 * size**power for size in sizes]) == pytest.approx(power, abs=1e-9)


def test_no_growth_exponent_of_one_size():
    assert math.isnan(growth_exponent([10, 10], [1, 2]))


def test_lane_use_is_mean_over_maximum():
    # One group: 1 + 2 + 3 + 2 steps in the time of four lanes with 3 steps each.
    assert lane_use([[1, 2, 3, 2]], 4) == 8 / 12
    assert lane_use(np.full((4, 8), 5), 8) == 1


def test_lane_use_weights_groups_by_their_time():
    # The second group works ten times as long, with one lane of two.
    assert lane_use([[1, 1, 10, 0]], 2) == 12 / (2 * 1 + 2 * 10)


def test_lane_use_of_tiles():
    work = np.array([[1, 1, 9, 9], [1, 1, 9, 9]])
    assert lane_use(work, 4) == 40 / (8 * 9)
    assert lane_use(work, 4, rows=2) == 1


def test_groups_at_the_border_are_left_out():
    assert lane_use([[2, 2, 100], [0, 0, 0]], 2) == 1
    assert math.isnan(lane_use([[1, 1, 1]], 4))
    assert math.isnan(lane_use([[0, 0]], 2))
