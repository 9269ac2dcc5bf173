"""A short run of the fuzz; `make fuzz` is the long one."""

from __future__ import annotations

import pytest

from ..profiles import is_long
from .campaign import fuzz
from .readers import READERS

SEED = 10
SHORT_COUNT, LONG_COUNT = 60, 5000


@pytest.fixture(scope="module")
def outcome():
    """One process for all readers: it starts in two seconds."""
    return fuzz(SEED, LONG_COUNT if is_long() else SHORT_COUNT, list(READERS))


@pytest.mark.parametrize("reader", READERS)
def test_a_damaged_file_is_read_or_refused(outcome, reader):
    failures = [failure for failure in outcome.failures if failure.reader == reader]
    assert failures == []
    # Damage that is always refused, or never, would look only at the beginning of a reader.
    assert outcome.counts[reader, "accepted"] > 0
    assert outcome.counts[reader, "refused"] > 0
