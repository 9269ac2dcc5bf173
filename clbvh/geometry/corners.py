"""Corners, by which builders see the primitives of any shape; and boxes, a shape that has nothing else.

The box of a primitive is that of its three corners. A sphere, or an instance of a scene, has two opposite corners of
its box, one of them twice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import MeshError
from .local_frame import LocalFrame, find_bounds, find_frame, shift_and_scale

# A box grows by this share of the largest half side of all boxes, which is at most 1 in local coordinates and at least
# 1/2 there: rounding a coordinate to float32 moves it by 2^-25 of that at most.
_GROWTH = 2.0**-23


class Corners(NamedTuple):
    """The corners of primitives.

    Attributes
    ----------
    points : (m, 3) float32, local coordinates
    ids : (n, 3) int32
        The three points of each primitive, as the faces of a mesh have them.
    """

    points: NDArray[np.float32]
    ids: NDArray[np.int32]


def corners_of_boxes(boxes: NDArray[np.float32]) -> Corners:
    """Return the corners of primitives that are seen by their boxes, (n, 2, 3)."""
    first = 2 * np.arange(len(boxes), dtype=np.int32)
    return Corners(boxes.reshape(-1, 3), np.stack((first, first + 1, first), axis=1))


@dataclass(frozen=True, eq=False)
class Boxes(LocalFrame):
    """Boxes that a tree can be built over, in local coordinates.

    Attributes
    ----------
    corners : (n, 2, 3) float32, local coordinates
    origin : (3,) float64
    scale : float
        As those of a `Mesh`.
    name : str
        For messages.
    """

    corners: NDArray[np.float32]
    origin: NDArray[np.float64]
    scale: float
    name: str

    @classmethod
    def from_arrays(cls, lower: NDArray[np.float64], upper: NDArray[np.float64], name: str) -> Boxes:
        """Return boxes, each of which contains what float64 has of it.

        Parameters
        ----------
        lower, upper : (n, 3) float64
            At least one, with ``lower <= upper``.
        name : str

        Raises
        ------
        MeshError
            A corner is not finite, or the boxes together are too small or too large, see `Mesh.from_arrays`.
        """
        least, greatest = find_bounds(lower)[0], find_bounds(upper)[1]
        if not (np.isfinite(least) & np.isfinite(greatest)).all():
            raise MeshError(f"{name}: a corner of the box around them is not finite: give it in another unit")
        growth = _GROWTH * float(np.max(greatest / 2 - least / 2))
        with np.errstate(over="ignore"):  # refused by find_frame
            origin, scale = find_frame(least - growth, greatest + growth, name, subject="the group is")
        corners = np.empty((len(lower), 2, 3), np.float32)
        corners[:, 0] = shift_and_scale(lower - growth, origin, scale)
        corners[:, 1] = shift_and_scale(upper + growth, origin, scale)
        return cls(corners, origin, scale, name)

    @property
    def prim_count(self) -> int:
        """Number of primitives: the boxes."""
        return len(self.corners)

    @property
    def local_box(self) -> NDArray[np.float32]:
        """(2, 3) float32: the least and the greatest local coordinates of the boxes."""
        return np.stack(find_bounds(self.corners.reshape(-1, 3)))

    def find_corners(self) -> Corners:
        """Return two opposite corners of each box."""
        return corners_of_boxes(self.corners)
