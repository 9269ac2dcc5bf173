"""A few meshes of the fuzz of geometry; `make fuzz` takes many."""

from __future__ import annotations

import pytest

from ..profiles import seeds
from .geometry import check_geometry

SHORT_SEEDS = 12


@pytest.mark.parametrize("seed", seeds(SHORT_SEEDS))
def test_every_layout_and_the_oracle_agree(session, seed):
    check_geometry(session, seed)
