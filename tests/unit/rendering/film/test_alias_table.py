"""The choice of lamps by their power."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh.rendering.look_tables import make_alias_table


def find_shares(table):
    """Return the probability of each thing by its table, times the count and 2^32."""
    keeps = table["threshold"].astype(np.int64)
    shares = keeps.copy()
    np.add.at(shares, table["alias"], 2**32 - keeps)
    return shares


@pytest.mark.parametrize("count", [1, 2, 3, 7, 1000, 1_000_000])
@pytest.mark.parametrize("kind", ["equal", "extreme", "one", "zeros"])
def test_shares_are_those_of_the_weights(kind, count):
    rng = np.random.default_rng(count)
    weights = {
        "equal": np.full(count, 1e-30),
        "extreme": 10 ** rng.uniform(-12, 12, count),
        "one": np.where(np.arange(count) == count // 2, 1e300, 1.0),
        "zeros": np.where(np.arange(count) % 2 == 0, rng.random(count) + 1e-6, 0.0),
    }[kind]
    shares = find_shares(make_alias_table(weights))
    expected = weights / weights.max()
    expected *= count * 2.0**32 / expected.sum()
    others = np.arange(count) != np.argmax(weights)
    assert shares.sum() == count * 2**32
    np.testing.assert_allclose(shares[others], expected[others], rtol=1e-9, atol=0.51)
    np.testing.assert_allclose(shares, expected, rtol=1e-4, atol=0.51)
