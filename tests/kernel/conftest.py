"""Functions of `cl/` on both devices."""

from functools import partial

import pytest

from . import programs


@pytest.fixture(scope="session")
def call(_opened_device):
    """The function `programs.call` on the device."""
    return partial(programs.call, _opened_device)
