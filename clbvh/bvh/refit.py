"""New boxes for a tree whose links are known: bottom-up, in one pass over the nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..device.host.loops import Loops
from ..geometry.spheres import Bounded
from ..structs import NODE

_LOOPS = Loops("bvh/nodes")


def fit_nodes(
    first: NDArray[np.int32], count: NDArray[np.int32], prim_ids: NDArray[np.int32], shape: Bounded
) -> NDArray[np.void]:
    """Return the nodes of a tree, each with the smallest box around the primitives below it.

    Parameters
    ----------
    first, count : (N,) int32
        The links of valid nodes, see `structs.NODE`: children lie behind their parent. Not checked.
    prim_ids : (F,) int32
        A permutation of the shape's primitives.
    shape : Mesh, Spheres or Boxes

    Returns
    -------
    (N,) `structs.NODE`
        No coordinate is a negative zero, so that equal boxes are equal bytes: over the shape that the tree was built
        for, the nodes equal the builder's.

    Notes
    -----
    O(N + F), in this thread.
    """
    nodes = np.empty(len(first), NODE)
    # A field of structs is not contiguous, but its first item is.
    stride = first.strides[0] // first.itemsize
    _LOOPS.fit_nodes(first[:1], count[:1], stride, prim_ids, *shape.find_corners(), nodes)
    return nodes
