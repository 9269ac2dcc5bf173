"""The choice of one of many things by their weights, in one step: the alias method; see cl/film/choice.cl."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...structs import LIGHT_CHOICE

# Weights are whole numbers whose mean is this one: sums of 2^24 of them are exact in 64 bits.
_MEAN = 2**32


def make_alias_table(weights: NDArray[np.float64]) -> NDArray[np.void]:
    """Return the table, (n,) `structs.LIGHT_CHOICE`.

    The probability of each thing is exact but for its rounding to a multiple of 2^-32 / n, and for the sum of all these
    roundings, which the largest one takes.

    The table is that of Vose's algorithm ("A linear algorithm for generating random numbers with a given distribution",
    1991), by prefix sums instead of lists: the things below the mean take what they lack from those above it, in order,
    and one that has given too much takes that from the next one.

    Parameters
    ----------
    weights : (n,) float64, 0 or more
        At least one of them above 0.
    """
    count = len(weights)
    # Divided first: the sum of the largest float64 numbers is none.
    shares = weights / weights.max()
    whole = np.rint(shares * (_MEAN * count / shares.sum())).astype(np.int64)
    whole[np.argmax(whole)] += _MEAN * count - int(whole.sum())

    below = np.flatnonzero(whole < _MEAN)
    above = np.flatnonzero(whole >= _MEAN)
    # What things lack that come before each one, and what has been given up to each one.
    lacks = np.concatenate([[0], np.cumsum(_MEAN - whole[below])])
    gifts = np.cumsum(whole[above] - _MEAN)

    keeps, aliases = whole.copy(), np.arange(count)
    aliases[below] = above[np.searchsorted(gifts, lacks[:-1], side="right")]
    # After its last gift, a thing may have less than the mean: what it lacks is taken from the next one.
    taken = lacks[np.searchsorted(lacks[:-1], gifts, side="left")]
    keeps[above] = _MEAN + gifts - taken
    aliases[above[:-1]] = above[1:]

    table = np.zeros(count, LIGHT_CHOICE)
    is_whole = keeps >= _MEAN
    table["threshold"] = np.where(is_whole, 0, keeps)
    table["alias"] = np.where(is_whole, np.arange(count), aliases)
    return table
