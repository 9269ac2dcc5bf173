"""Samples: warm-up, rounds, turns, resuming and failures; how they are kept; their machine and their statistics."""

from __future__ import annotations

import csv
import math

import numpy as np
import pytest

from clbvh import PoolError
from clbvh.study.experiment import Experiment
from clbvh.study.machine import Machine
from clbvh.study.run import group_cases, sample_group
from clbvh.study.samples import FILE_NAME, NotMeasuredError, Sample, SampleFile
from clbvh.study.scale import Scale
from clbvh.study.statistics import NOISY_SPREAD, Summary, fit_amdahl, growth_exponent, lane_use

SCALE = Scale("test", rounds=3, least_rounds=3, group_s=60, idle_gap_s=0)
CASE = {"mesh": "knot-1000", "workers": 2}


class MadeUp(Experiment):
    """Made up.

    Does it work?

    By hand.
    """

    def __init__(self, fails_at=None, error=KeyboardInterrupt):
        self.names = []
        self._fails_at, self._error = fails_at, error

    def cases(self, scale):
        return [{"mesh": "a", "name": "one"}, {"mesh": "a", "name": "two"}, {"mesh": "b", "name": "x"}]

    def measure(self, bench, case):
        self.names.append(case["name"])
        if len(self.names) == self._fails_at:
            raise self._error
        return Sample({"wall_ms": float(len(self.names))})

    def present(self, results):
        return []


def take(experiment, folder, scale=SCALE):
    """Sample the first group of the made-up experiment; return the samples."""
    folder.mkdir(exist_ok=True)
    samples, machine = SampleFile(folder, "here"), Machine({"cores": "2"}, None, "no device")
    groups = group_cases(experiment, experiment.cases(scale))
    assert [[case["name"] for case in cases] for cases in groups.values()] == [["one", "two"], ["x"]]
    group, cases = next(iter(groups.items()))
    list(sample_group(experiment, group, cases, scale, machine, samples, folder / "pictures"))
    return samples


def test_cases_take_turns_after_a_warm_up(tmp_path):
    experiment = MadeUp()
    records = take(experiment, tmp_path / "all").samples("madeup")
    assert experiment.names == ["two", "one", "one", "two", "two", "one", "one", "two"]
    kept = [(record["case"]["name"], record["round"], record["values"]["wall_ms"]) for record in records]
    # The first two measurements are the warm-up.
    assert kept == [("one", 0, 3), ("two", 0, 4), ("two", 1, 5), ("one", 1, 6), ("one", 2, 7), ("two", 2, 8)]
    # A long group ends after the least rounds, and counts are taken once.
    scale = Scale("test", rounds=9, least_rounds=2, group_s=-1, idle_gap_s=0)
    assert len(take(MadeUp(), tmp_path / "long", scale).samples("madeup")) == 2 * 2
    counts = MadeUp()
    counts.counts = True
    take(counts, tmp_path / "counts")
    assert counts.names == ["one", "two"]


def test_a_case_that_fails_does_not_stop_the_others(tmp_path):
    for error in (NotMeasuredError("no perf"), PoolError("a worker died"), MemoryError()):
        experiment = MadeUp(fails_at=1, error=error)
        (failure,) = take(experiment, tmp_path / type(error).__name__).failures("madeup")
        assert (failure["case"]["name"], failure["reason"]) == ("two", str(error) or "MemoryError")
        assert experiment.names == ["two", "one", "one", "one", "one"]


def test_statistics_find_the_numbers_they_were_made_with():
    rate = Summary.of([2.0, 5.0, 4.0]).rate(20)
    assert (rate.median, rate.low, rate.high) == (5, 4, 10)
    assert [Summary.of([1.0, 1.0, 1 + factor * NOISY_SPREAD]).is_noisy for factor in (0.9, 1.1)] == [False, True]
    assert fit_amdahl({workers: 50 * (0.1 + 0.9 / workers) for workers in (1, 2, 8)}) == pytest.approx(0.1)
    assert growth_exponent([10, 100, 1000], [7, 700, 70000]) == pytest.approx(2)


def test_an_interrupted_group_goes_on_where_it_was(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        take(MadeUp(fails_at=6), tmp_path)
    assert len(SampleFile(tmp_path, "here").samples("madeup")) == 3
    experiment = MadeUp()
    samples = take(experiment, tmp_path)
    # A warm-up, and what was missing: nothing is measured again, nothing twice.
    assert experiment.names == ["two", "one", "one", "one", "two"]
    rounds = sorted((record["case"]["name"], record["round"]) for record in samples.samples("madeup"))
    assert rounds == [(name, turn) for name in ("one", "two") for turn in range(3)]


def test_samples_are_kept_one_by_one_and_told_apart_by_their_machine(tmp_path):
    samples = SampleFile(tmp_path, "here")
    samples.add_sample("ladder", CASE, 0, Sample({"build_ms": 1.5}, {"picture": "abc"}))
    samples.add_sample("ladder", CASE, 1, Sample({"build_ms": 2.5}))
    with samples.write_table().open(newline="") as file:
        rows = [(row["case"], row["round"], row["quantity"], row["value"]) for row in csv.DictReader(file)]
    case = "mesh=knot-1000 workers=2"
    assert rows == [(case, "0", "build_ms", "1.5"), (case, "0", "picture", "abc"), (case, "1", "build_ms", "2.5")]
    assert (SampleFile(tmp_path, "elsewhere").samples("ladder"), SampleFile(tmp_path, "elsewhere").others) == ([], 2)
    again = SampleFile(tmp_path, "here")
    assert [record["values"] for record in again.samples("ladder")] == [{"build_ms": 1.5}, {"build_ms": 2.5}]
    assert [again.count("ladder", {"workers": workers, "mesh": "knot-1000"}) for workers in (1, 2)] == [0, 2]
    # A line that was cut off is lost alone.
    path = tmp_path / FILE_NAME
    path.write_bytes(path.read_bytes()[:-10])
    SampleFile(tmp_path, "here").add_sample("ladder", CASE, 1, Sample({"build_ms": 3.0}))
    values = [record["values"]["build_ms"] for record in SampleFile(tmp_path, "here").samples("ladder")]
    assert values == [1.5, 3.0]


def test_lane_use_is_mean_over_maximum_of_each_group():
    assert lane_use([[1, 2, 3, 2]], 4) == 8 / 12
    assert lane_use([[1, 1, 10, 0]], 2) == 12 / (2 * 1 + 2 * 10)  # weighted by the time
    work = np.array([[1, 1, 9, 9], [1, 1, 9, 9]])
    assert (lane_use(work, 4), lane_use(work, 4, rows=2)) == (40 / (8 * 9), 1)
    # Groups at the border are left out.
    assert lane_use([[2, 2, 100], [0, 0, 0]], 2) == 1
    assert math.isnan(lane_use([[1, 1, 1]], 4))
