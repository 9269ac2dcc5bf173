"""Warm-up, rounds, turns, resuming, interruption and cases that fail."""

from __future__ import annotations

import pytest

from clbvh.errors import PoolError
from clbvh.study.run import group_cases, sample_group
from clbvh.study.samples import NotMeasuredError, SampleFile
from clbvh.study.scale import Scale

from .made_up import MACHINE, make_experiment

SCALE = Scale("test", rounds=3, least_rounds=3, group_s=60, idle_gap_s=0)


class Recorder:
    """Measures by noting the case; at the nth measurement it raises."""

    def __init__(self, fails_at=None, error=KeyboardInterrupt):
        self.names = []
        self._fails_at, self._error = fails_at, error

    def __call__(self, case):
        self.names.append(case["name"])
        if len(self.names) == self._fails_at:
            raise self._error
        return {"wall_ms": float(len(self.names))}


def take(measure, folder, scale=SCALE, **fields):
    """Sample the first group of the made-up experiment; return the samples."""
    experiment = make_experiment(measure, **fields)
    samples = SampleFile(folder, "here")
    group, cases = next(iter(group_cases(experiment, experiment.cases(scale)).items()))
    list(sample_group(experiment, group, cases, scale, MACHINE, samples, folder / "pictures"))
    return samples


def test_cases_are_grouped_by_what_is_compared():
    experiment = make_experiment()
    groups = group_cases(experiment, experiment.cases(SCALE))
    assert [[case["name"] for case in cases] for cases in groups.values()] == [["one", "two"], ["x"]]


def test_cases_take_turns_after_a_warm_up(tmp_path):
    recorder = Recorder()
    samples = take(recorder, tmp_path)
    assert recorder.names == ["two", "one", "one", "two", "two", "one", "one", "two"]
    kept = [
        (record["case"]["name"], record["round"], record["values"]["wall_ms"]) for record in samples.samples("madeup")
    ]
    # The first two measurements are the warm-up.
    assert kept == [("one", 0, 3), ("two", 0, 4), ("two", 1, 5), ("one", 1, 6), ("one", 2, 7), ("two", 2, 8)]


def test_a_long_group_ends_after_the_least_rounds(tmp_path):
    scale = Scale("test", rounds=9, least_rounds=2, group_s=-1, idle_gap_s=0)
    assert len(take(Recorder(), tmp_path, scale).samples("madeup")) == 2 * 2


def test_counts_are_taken_once_without_a_warm_up(tmp_path):
    recorder = Recorder()
    take(recorder, tmp_path, counts=True)
    assert recorder.names == ["one", "two"]


def test_an_interrupted_group_goes_on_where_it_was(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        take(Recorder(fails_at=6), tmp_path)
    kept = SampleFile(tmp_path, "here")
    assert len(kept.samples("madeup")) == 3
    recorder = Recorder()
    samples = take(recorder, tmp_path)
    # A warm-up, and what was missing: nothing is measured again, nothing twice.
    assert recorder.names == ["two", "one", "one", "one", "two"]
    rounds = sorted((record["case"]["name"], record["round"]) for record in samples.samples("madeup"))
    assert rounds == [(name, turn) for name in ("one", "two") for turn in range(3)]


@pytest.mark.parametrize("error", [NotMeasuredError("no perf"), PoolError("a worker died"), MemoryError()], ids=repr)
def test_a_case_that_fails_does_not_stop_the_others(tmp_path, error):
    recorder = Recorder(fails_at=1, error=error)
    samples = take(recorder, tmp_path)
    (failure,) = samples.failures("madeup")
    assert failure["case"]["name"] == "two"
    assert failure["reason"] == (str(error) or "MemoryError")
    assert recorder.names == ["two", "one", "one", "one", "one"]
    assert samples.count("madeup", {"mesh": "a", "name": "one"}) == 3


def test_an_error_of_ours_is_not_swallowed(tmp_path):
    with pytest.raises(ZeroDivisionError):
        take(Recorder(fails_at=1, error=ZeroDivisionError), tmp_path)
