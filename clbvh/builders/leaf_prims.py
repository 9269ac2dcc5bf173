"""The primitives of a leaf: listed in ascending order, whatever order the builder meets them in."""

from __future__ import annotations

from ..support.compiled import compiled


@compiled
def insert_prim(prim_ids, begin, end, prim):
    """Insert a primitive into the ascending list `prim_ids[begin:end]`, which then ends one later.

    One step of an insertion sort: O(1) when primitives arrive in ascending order, and no memory besides the list.

    Parameters
    ----------
    prim_ids : (n,) int32, changed in place
        `prim_ids[end]` is overwritten.
    begin, end : int
    prim : int
    """
    slot = end
    while slot > begin and prim_ids[slot - 1] > prim:
        prim_ids[slot] = prim_ids[slot - 1]
        slot -= 1
    prim_ids[slot] = prim
