"""What property tests share: hypothesis takes fixtures of the session only."""

import pytest

from clbvh import SubtreePool


@pytest.fixture(scope="session")
def opened(_opened_device):
    """The default device."""
    return _opened_device


@pytest.fixture(scope="session")
def pools():
    """Pools by their number of workers: 1, 2 and 5."""
    with SubtreePool(1) as one, SubtreePool(2) as two, SubtreePool(5) as five:
        yield {1: one, 2: two, 5: five}
