"""A short run of the fuzz, for which `make fuzz` is the long one; and that it notices every kind of failure."""

from random import Random

import pytest

from ..profiles import is_long, seeds
from .campaign import fuzz
from .geometry import check_geometry
from .mutate import mutate, mutate_json
from .readers import READERS
from .worker import make_file

SEED = 10
SHORT_COUNT, LONG_COUNT = 60, 5000
SHORT_SEEDS = 12

REASONS = {
    "raises": "IndexError",
    "warns": "RuntimeWarning: a value is odd",
    "grows": "MemoryError",
    "blames": "DeviceError",
    "dies": "the process ended with -9",
    "hangs": "took longer than 2 s",
}


@pytest.fixture(scope="module")
def outcome():
    """One process for all readers: it starts in two seconds."""
    return fuzz(SEED, LONG_COUNT if is_long() else SHORT_COUNT, list(READERS))


@pytest.mark.parametrize("reader", READERS)
def test_a_damaged_file_is_read_or_refused(outcome, reader):
    assert [failure for failure in outcome.failures if failure.reader == reader] == []
    # Damage that is always refused, or never, would look only at the beginning of a reader.
    assert outcome.counts[reader, "accepted"] > 0
    assert outcome.counts[reader, "refused"] > 0


@pytest.mark.parametrize("seed", seeds(SHORT_SEEDS))
def test_every_layout_and_the_oracle_agree_about_hard_meshes(session, seed):
    check_geometry(session, seed)


def test_each_kind_of_failure_is_noticed():
    """In two files each: the second is read although the first killed the process."""
    *traps, _ = REASONS
    outcome = fuzz(0, 2, ["off", *traps])
    failures = [failure for failure in outcome.failures if failure.reader != "off"]
    failures += fuzz(0, 1, ["hangs"], file_limit_s=2).failures
    expected = [(reader, index) for index in range(2) for reader in traps] + [("hangs", 0)]
    assert [(failure.reader, failure.index) for failure in failures] == expected
    for failure in failures:
        assert REASONS[failure.reader] in failure.reason
    assert sum(outcome.counts["off", word] for word in ("accepted", "refused")) == 2


def test_a_file_follows_from_its_seed_and_number():
    for name, reader in READERS.items():
        files, again, others = ([make_file(reader, name, seed, index) for index in range(20)] for seed in (3, 3, 4))
        assert files == again != others
        assert len(set(files)) > 10
    for seed in range(100):  # of nothing, too
        assert len(mutate(b"", Random(seed), [b""])) < 1 << 16
        mutate_json({}, Random(seed))
