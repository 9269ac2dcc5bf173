"""The check that links between nodes make a tree, for nodes of a builder or of an untrusted file."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import ValidationError

_MOST_NAMED = 10  # leaves in a message


def check_links(
    first: NDArray[np.integer], count: NDArray[np.integer], prim_ids: NDArray[np.int32], prim_count: int
) -> None:
    """Check that nodes and primitives make a tree, so that links can be followed without leaving the arrays.

    Every node but the root is the child of exactly one interior node before it, the leaves' ranges cover `prim_ids`
    once, and that is a permutation.
    """
    if not 0 < len(first) < 2 * prim_count:
        raise ValidationError(f"a tree over {prim_count} triangles cannot have {len(first)} nodes")
    if prim_ids.shape != (prim_count,):
        raise ValidationError(f"the tree lists {prim_ids.size} primitives; the mesh has {prim_count} triangles")
    interior, leaves = np.flatnonzero(count == 0), np.flatnonzero(count > 0)
    lefts, begins, sizes = first[interior], first[leaves], count[leaves]

    def owners_of(slot: int) -> str:
        return ", ".join(map(str, leaves[(begins <= slot) & (slot < begins + sizes)][:_MOST_NAMED]))

    refuse_nodes(np.flatnonzero(count < 0), "node {} has a negative count")
    bad = (lefts <= interior) | (lefts >= len(first) - 1)
    refuse_nodes(interior[bad], "interior node {} does not have both its children behind it, inside the tree")
    references = np.bincount(lefts, minlength=len(first))
    references[1:] += references[:-1].copy()  # the right child lies behind the left one
    references[0] += 1
    refuse_nodes(np.flatnonzero(references != 1), "node {} is not reached exactly once")

    bad = (begins < 0) | (sizes > prim_count - begins)
    refuse_nodes(leaves[bad], "leaf {} lists primitives outside the mesh")
    changes = np.bincount(begins, minlength=prim_count + 1) - np.bincount(begins + sizes, minlength=prim_count + 1)
    covered = np.cumsum(changes)[:-1]
    if (covered != 1).any():
        slot = int(np.flatnonzero(covered != 1)[0])
        raise ValidationError(
            f"prim_ids[{slot}] lies in {covered[slot]} leaves ({owners_of(slot) or 'none'}) instead of one"
        )
    outside = np.flatnonzero((prim_ids < 0) | (prim_ids >= prim_count))
    if len(outside):
        prim, owner = prim_ids[outside[0]], owners_of(outside[0])
        raise ValidationError(f"leaf {owner} lists triangle {prim}, which the mesh does not have")
    uses = np.bincount(prim_ids, minlength=prim_count)
    if (uses > 1).any():
        prim = int(prim_ids[np.argmax(uses[prim_ids] > 1)])
        owners = ", ".join(owners_of(slot) for slot in np.flatnonzero(prim_ids == prim)[:_MOST_NAMED])
        raise ValidationError(f"triangle {prim} is listed {uses[prim]} times instead of once, in leaves {owners}")


def refuse_nodes(nodes: NDArray[np.intp], message: str) -> None:
    """Raise for the first of some wrong nodes."""
    if len(nodes):
        raise ValidationError(message.format(nodes[0]))
