"""The faces of a world that a count of hits leaves out to tell the inside, as the device and the host look them up."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ...scene.state import SceneState

_WORD_BITS = 32


class Surplus(NamedTuple):
    """The surplus faces of all instances; see `Coincidence`.

    Attributes
    ----------
    bits : (n,) uint32
        A bit for each face, the first one in the lowest bit; each mesh that has surplus faces begins a new number.
    first : (instances,) int32
        Where the bits of each instance begin in `bits`; -1 where its shape has no surplus faces.
    """

    bits: NDArray[np.uint32]
    first: NDArray[np.int32]

    @classmethod
    def find(cls, state: SceneState) -> Self | None:
        """Return the surplus faces of the shapes that are placed, or None if there are none."""
        parts, first, count = list[NDArray[np.uint32]](), np.full(len(state.shapes), -1, np.int32), 0
        for geometry_id in np.unique(state.geometry_ids):
            shape = state.shapes[geometry_id]
            if len(shape.coincidence.surplus):
                is_surplus = np.zeros(-(-shape.prim_count // _WORD_BITS) * _WORD_BITS, np.bool_)
                is_surplus[shape.coincidence.surplus] = True
                parts.append(np.packbits(is_surplus, bitorder="little").view("<u4").astype(np.uint32))
                first[geometry_id], count = count, count + len(parts[-1])
        return cls(np.concatenate(parts), first[state.geometry_ids]) if parts else None

    def holds(self, prim_ids: NDArray[np.integer], instance_ids: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Return (n,) bool: which of the primitives of instances are surplus faces."""
        first = self.first[instance_ids]
        numbers = self.bits[np.where(first < 0, 0, first + prim_ids // _WORD_BITS)]
        return (first >= 0) & (numbers >> (prim_ids % _WORD_BITS).astype(np.uint32) & 1 == 1)
