"""The box around what is traced, and the local coordinates of rays and points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...geometry import Shape


class TreeBox(NamedTuple):
    """A box around the tree, symmetric about the mesh's origin, and the map to the mesh's local coordinates.

    Attributes
    ----------
    centre : (3,) float64, the file's coordinates
        The mesh's origin.
    scale : float
        A power of two: local units in one unit of the file.
    half : (3,) float64, local coordinates
        Half the size along each axis; the largest is about 1, or 0.
    """

    centre: NDArray[np.float64]
    scale: float
    half: NDArray[np.float64]

    def as_numbers(self) -> NDArray[np.float64]:
        """Return (7,) float64, as kernels and loops read it, see cl/rays/pack.cl."""
        return np.array([*self.centre, *self.half, self.scale])

    @classmethod
    def around(cls, bvh: Bvh) -> TreeBox:
        """Return the box around a tree."""
        root = bvh.nodes[0]
        half = np.maximum(np.abs(root["aabb_min"]), np.abs(root["aabb_max"])).astype(np.float64)
        return cls(bvh.shape.origin, bvh.shape.scale, half)

    @classmethod
    def of_shape(cls, shape: Shape) -> TreeBox:
        """Return the box around a shape without a tree."""
        return cls(shape.origin, shape.scale, np.abs(shape.local_box).max(axis=0).astype(np.float64))
