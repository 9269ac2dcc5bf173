"""Strays: a few small things far away from all others, such as a triangle that a scanner or an export left behind.

Owns what counts as far and as few; must not know what the things are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Strays are at most this share of all things, by their number and by their area, all together.
MOST_SHARE = 0.01

# The empty space around the others is at least this many diagonals of the box around them: with a stray in the picture,
# they would have less than a third of its width. The outermost points of normal and exponential distributions are well
# below, and so are a mast and an aerial, which nothing separates from what they stand on.
LEAST_GAP = 2.0

# Steps in which the box grows; a dozen are usual.
_MOST_STEPS = 100


def find_strays(
    lower: NDArray[np.floating],
    upper: NDArray[np.floating],
    counts: NDArray[np.floating],
    areas: NDArray[np.floating],
    least_gap: float = LEAST_GAP,
) -> NDArray[np.bool_]:
    """Return which things are strays, (n,) bool: few, small, and far away from all others.

    Parameters
    ----------
    lower, upper : (n, 3) float
        Corners of the boxes around the things.
    counts, areas : (n,) float
        What each thing is of all: how many primitives, and how much surface.
    least_gap : float
        The empty space around the others, in diagonals of the box around them.

    Notes
    -----
    A box grows from the middle of the things over all that is near it, in diagonals of the box, until nothing is. What
    is left are strays if they are few. O(n log n). The result does not depend on the order of the things.

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
    none = np.zeros(len(begins), bool)
    # All but the strays on either side of each axis: both ends are at things that are no strays.
    middles = begins / 2 + ends / 2
    box_lower = _find_end(middles, counts)
    box_upper = -_find_end(-middles, counts)
    rest = np.arange(len(begins))
    for _ in range(_MOST_STEPS):
        reach = least_gap * np.linalg.norm(box_upper - box_lower)
        gaps = np.maximum(np.maximum(begins[rest] - box_upper, box_lower - ends[rest]), 0.0)
        is_near = np.linalg.norm(gaps, axis=1) <= reach
        if not is_near.any():
            break
        near, rest = rest[is_near], rest[~is_near]
        box_lower = np.minimum(box_lower, begins[near].min(axis=0))
        box_upper = np.maximum(box_upper, ends[near].max(axis=0))
    else:
        return none
    is_few = all(weights[rest].sum() <= MOST_SHARE * weights.sum() for weights in (counts, areas))
    if not is_few or not (box_upper > box_lower).any():
        return none
    none[rest] = True
    return none


def _find_end(points: NDArray[np.float64], counts: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return (3,) float64: along each axis the first point with more than the share of strays up to it."""
    end = np.empty(3)
    for axis in range(3):
        order = np.argsort(points[:, axis], kind="stable")
        so_far = np.cumsum(counts[order])
        end[axis] = points[order[np.searchsorted(so_far, MOST_SHARE * so_far[-1], side="right")], axis]
    return end
