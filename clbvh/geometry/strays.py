"""Strays: a few small things far away from all others, such as a triangle that a scanner or an export left behind.

Owns what counts as far and as few; must not know what the things are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Strays are at most this share of all things, by their number and by their area, all together.
MOST_SHARE = 0.01

# The empty space before them is at least this many diagonals of the box around the others: with all of them in the
# picture, the others would be less than a third as wide as it. The outermost of 10,000 points of a normal, an
# exponential or a Plummer distribution are well below, and so are a mast and an aerial, which nothing separates from
# what they stand on.
LEAST_GAP = 1.5

# Rounds of the search; in each, all that is left is looked at along each axis.
_MOST_ROUNDS = 16


def find_strays(
    lower: NDArray[np.floating], upper: NDArray[np.floating], counts: NDArray[np.floating], areas: NDArray[np.floating]
) -> NDArray[np.bool_]:
    """Return which things are strays, (n,) bool: few, small, and far away from the others along x, y or z.

    Parameters
    ----------
    lower, upper : (n, 3) float
        Corners of the boxes around the things.
    counts, areas : (n,) float
        What each thing is of all: how many primitives, and how much surface.

    Notes
    -----
    O(n log n). The result does not depend on the order of the things.

    Examples
    --------
    >>> import numpy as np
    >>> from clbvh.geometry.strays import find_strays
    >>> corners = np.random.default_rng(0).random((200, 3))
    >>> corners[7] += 50
    >>> np.flatnonzero(find_strays(corners, corners + 0.1, np.ones(200), np.ones(200)))
    array([7])
    """
    begins, ends = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
    limits = MOST_SHARE * np.array([counts.sum(), areas.sum()])
    weights = np.stack((counts, areas), axis=1).astype(np.float64)
    kept = np.arange(len(lower))
    for _ in range(_MOST_ROUNDS):
        strays = _find_farthest(begins[kept], ends[kept], weights[kept], limits)
        if strays is None:
            break
        limits = limits - weights[kept[strays]].sum(axis=0)
        kept = np.delete(kept, strays)
    is_stray = np.ones(len(lower), bool)
    is_stray[kept] = False
    return is_stray


def _find_farthest(
    lower: NDArray[np.float64], upper: NDArray[np.float64], weights: NDArray[np.float64], limits: NDArray[np.float64]
) -> NDArray[np.integer] | None:
    """Return the things behind the empty space that is the largest beside the rest; None if it is not large enough."""
    best, strays = LEAST_GAP, None
    for axis in range(3):
        # Towards +axis, then towards -axis: the same search in a mirror.
        for low, high in ((lower, upper), (-upper, -lower)):
            order = np.argsort(low[:, axis], kind="stable")
            box_lower = np.minimum.accumulate(low[order], axis=0)[:-1]
            box_upper = np.maximum.accumulate(high[order], axis=0)[:-1]
            gaps = low[order[1:], axis] - box_upper[:, axis]
            behind = weights.sum(axis=0) - np.cumsum(weights[order], axis=0)[:-1]
            is_few = (behind <= limits).all(axis=1)
            diagonals = np.sqrt(((box_upper - box_lower) ** 2).sum(axis=1))
            with np.errstate(divide="ignore", invalid="ignore"):
                ratios = np.where(is_few & (gaps > 0) & (diagonals > 0), gaps / diagonals, 0.0)
            if len(ratios) and ratios.max() >= best:
                first = int(np.argmax(ratios))
                best, strays = float(ratios[first]), order[first + 1 :]
    return strays
