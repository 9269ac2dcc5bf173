"""What rays hit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..layout import NO_PRIM


@dataclass(frozen=True, eq=False)
class Hits:
    """One crossing per ray, at ``(1 - u - v) a + u b + v c`` of the triangle with the corners a, b and c.

    Attributes
    ----------
    t : (...,) float32, lengths of the ray's direction
        Distance from the ray's origin; infinite on a miss.
    u, v : (...,) float32
        Barycentric coordinates; 0 on a miss.
    prim_id : (...,) int32
        Face of the mesh; -1 on a miss.
    """

    t: NDArray[np.float32]
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    prim_id: NDArray[np.int32]

    @classmethod
    def from_device(cls, hits: NDArray[np.void]) -> Hits:
        """Take an array of `layout.HIT` apart; the fields are views of it."""
        return cls(hits["t"], hits["u"], hits["v"], hits["prim_id"])

    @property
    def is_hit(self) -> NDArray[np.bool_]:
        """(...,) bool: whether the ray hits anything."""
        return self.prim_id != NO_PRIM

    @property
    def count(self) -> int:
        """Number of rays that hit something."""
        return int(np.count_nonzero(self.is_hit))

    def take(self, rays: NDArray[np.int64]) -> Hits:
        """Return the hits of some rays, by their numbers in C order."""
        return Hits(self.t.flat[rays], self.u.flat[rays], self.v.flat[rays], self.prim_id.flat[rays])

    def __len__(self) -> int:
        return len(self.prim_id)
