"""Where the eye of an automatic view is: as near as possible, with what is seen in the middle of the picture.

Owns the choice of the eye; must not know how points are read.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh
from .extent_bounds import find_bounds_of_all
from .scene_extent import SceneExtent
from .view_bounds import Turn, View, ViewBounds

# The slopes of the picture's sides for which bounds are known, as shares of the whole ones. With four of them, the two
# margins of a tilted plate differ by less than a hundredth of the picture.
_SHARES = (0.0, 1 / 3, 2 / 3, 1.0)


def find_eye(view: View | Turn, mesh: Mesh | SceneExtent) -> tuple[NDArray[np.float64], ViewBounds]:
    """Return the eye of a view that sees all of a mesh, (3,) float64 in local coordinates, and the bounds of the view.

    Notes
    -----
    The tightest pair of sides gives the distance of the eye. Where the other pair leaves room, the eye could stand
    anywhere between them. Halfway is not the middle of the picture: what is near moves more than what is far.
    The eye stands where a narrower picture would see all: for slopes s of its sides, the planes that touch the points
    from above and below meet the plane of the eye in ``highest(s) - s distance`` and ``lowest(s) + s distance``, and s
    is the least for which the first is not above the second. Both are known for a few s, and linear in between;
    as ``highest`` is convex and ``lowest`` concave, no point is left out.
    """
    several = find_bounds_of_all([view.narrowed(share) for share in _SHARES], mesh)
    look = view.view if isinstance(view, Turn) else view
    distance = look.find_distance(several[-1])
    centre = [_find_middle(several, look.tangents[axis] * distance, axis) for axis in range(2)]
    return look.across @ centre - distance * look.forward, several[-1]


def _find_middle(several: Sequence[ViewBounds], reach: float, axis: int) -> float:
    """Return the eye's coordinate along one axis of the picture; `reach` is half the picture's side in depth 0."""
    excesses = [
        float(bounds.highest[axis] - bounds.lowest[axis]) - 2 * share * reach
        for share, bounds in zip(_SHARES, several, strict=True)
    ]
    # The last is 0 along the tightest axis, but for rounding.
    after = next((number for number, excess in enumerate(excesses[:-1]) if excess <= 0), len(_SHARES) - 1)
    if after == 0 or excesses[after] >= 0:
        return float(several[after].middle[axis])
    part = excesses[after - 1] / (excesses[after - 1] - excesses[after])
    before, behind = several[after - 1].middle[axis], several[after].middle[axis]
    return float(before + part * (behind - before))
