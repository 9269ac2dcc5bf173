"""What property tests share: examples that are the same in every run."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, settings

from clbvh import SubtreePool

# The examples follow from the test's code alone, so a failure comes again; nothing is written to disk. Compiling and
# a busy machine make single examples slow.
settings.register_profile(
    "clbvh",
    derandomize=True,
    database=None,
    deadline=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("clbvh")


@pytest.fixture(scope="session")
def pools():
    """Pools by their number of workers: 1, 2 and 5."""
    with SubtreePool(1) as one, SubtreePool(2) as two, SubtreePool(5) as five:
        yield {1: one, 2: two, 5: five}
