"""Samples are kept one by one, read back, and told apart by their machine."""

from __future__ import annotations

import csv

import pytest

from clbvh.study.samples import FILE_NAME, Sample, SampleFile

CASE = {"mesh": "knot-1000", "workers": 2}


@pytest.fixture
def samples(tmp_path):
    kept = SampleFile(tmp_path, "here")
    kept.add_sample("ladder", CASE, 0, Sample({"build_ms": 1.5}, {"picture": "abc"}))
    kept.add_sample("ladder", CASE, 1, Sample({"build_ms": 2.5}))
    return kept


def test_samples_are_in_the_file_at_once(samples, tmp_path):
    again = SampleFile(tmp_path, "here")
    assert [record["values"] for record in again.samples("ladder")] == [{"build_ms": 1.5}, {"build_ms": 2.5}]
    assert again.count("ladder", {"workers": 2, "mesh": "knot-1000"}) == 2
    assert again.count("ladder", {**CASE, "workers": 1}) == 0
    assert again.samples("scaling") == []


def test_samples_of_another_machine_are_kept_but_not_seen(samples, tmp_path):
    other = SampleFile(tmp_path, "elsewhere")
    assert (other.samples("ladder"), other.others) == ([], 2)
    other.add_sample("ladder", CASE, 0, Sample({"build_ms": 9.0}))
    assert len(SampleFile(tmp_path, "here").samples("ladder")) == 2


def test_a_line_that_was_cut_off_is_lost_alone(samples, tmp_path):
    path = tmp_path / FILE_NAME
    path.write_bytes(path.read_bytes()[:-10])
    cut = SampleFile(tmp_path, "here")
    assert cut.count("ladder", CASE) == 1
    cut.add_sample("ladder", CASE, 1, Sample({"build_ms": 3.0}))
    values = [record["values"]["build_ms"] for record in SampleFile(tmp_path, "here").samples("ladder")]
    assert values == [1.5, 3.0]


def test_a_failure_is_forgotten_when_the_case_is_measured(samples):
    samples.add_failure("ladder", CASE, "no memory")
    samples.add_failure("ladder", {"mesh": "drill"}, "first")
    samples.add_failure("ladder", {"mesh": "drill"}, "second")
    assert [record["reason"] for record in samples.failures("ladder")] == ["second"]


def test_groups_that_are_done(samples, tmp_path):
    samples.add_done("ladder", "bunny", "quick")
    again = SampleFile(tmp_path, "here")
    assert again.is_done("ladder", "bunny", "quick")
    assert not again.is_done("ladder", "bunny", "full")
    assert not again.is_done("ladder", "dragon", "quick")


def test_the_table_has_a_line_for_each_value(samples):
    with samples.write_table().open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["round"], row["quantity"], row["value"]) for row in rows] == [
        ("0", "build_ms", "1.5"), ("0", "picture", "abc"), ("1", "build_ms", "2.5"),
    ]  # fmt: skip
    assert rows[0]["case"] == "mesh=knot-1000 workers=2"
