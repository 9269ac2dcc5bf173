"""The fuzz notices every kind of failure, and goes on behind it."""

from __future__ import annotations

from random import Random

import pytest

from .campaign import fuzz
from .mutate import mutate, mutate_json
from .readers import READERS
from .worker import make_file

REASONS = {
    "raises": "IndexError",
    "warns": "RuntimeWarning: a value is odd",
    "grows": "MemoryError",
    "blames": "DeviceError",
    "dies": "the process ended with -9",
    "hangs": "took longer than 2 s",
}


def test_each_kind_of_failure_is_noticed():
    """In two files each: the second is read although the first killed the process."""
    outcome = fuzz(0, 2, ["off", *REASONS][:-1])
    failures = [failure for failure in outcome.failures if failure.reader != "off"]
    failures += fuzz(0, 1, ["hangs"], file_limit_s=2).failures
    expected = [(reader, index) for index in range(2) for reader in [*REASONS][:-1]] + [("hangs", 0)]
    assert [(failure.reader, failure.index) for failure in failures] == expected
    for failure in failures:
        assert REASONS[failure.reader] in failure.reason
    assert sum(outcome.counts["off", word] for word in ("accepted", "refused")) == 2


@pytest.mark.parametrize("reader", READERS)
def test_a_file_follows_from_its_seed_and_number(reader):
    files = [make_file(READERS[reader], reader, 3, index) for index in range(20)]
    assert files == [make_file(READERS[reader], reader, 3, index) for index in range(20)]
    assert len(set(files)) > 10
    assert files != [make_file(READERS[reader], reader, 4, index) for index in range(20)]


def test_nothing_to_damage():
    for seed in range(100):
        assert len(mutate(b"", Random(seed), [b""])) < 1 << 16
        mutate_json({}, Random(seed))
