"""The source of a primitive's box and centroid: the mesh, each time anew, or two arrays filled before.

The first three variants recompute both in every comparison, all later ones look them up. The rest of the ladder asks
`bound_prim` and `centroid_of` and does not know which of the two it gets; numba compiles it once for each. So it also
runs on a source that counts (`clbvh.study.ladder_work`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from ...support.compiled import compiled

# A box is (min_x, min_y, min_z, max_x, max_y, max_z).
BOX = 6


class Recomputed(NamedTuple):
    """The mesh itself: boxes and centroids are computed from the corners each time."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]


class Cached(NamedTuple):
    """One box, (n, 6), and one centroid, (n, 3), per primitive, computed once."""

    aabbs: NDArray[np.float32]
    centroids: NDArray[np.float32]


def bound_prim(prims: Recomputed | Cached, prim: int) -> tuple[np.float32, ...]:
    """Return the box of a primitive; for compiled code only."""
    raise NotImplementedError


def centroid_of(prims: Recomputed | Cached, prim: int, axis: int) -> np.float32:
    """Return one coordinate of a primitive's centroid, the centre of its box; for compiled code only."""
    raise NotImplementedError


@compiled
def _bound_corners(vertices, faces, prim, axis):
    a, b, c = vertices[faces[prim, 0], axis], vertices[faces[prim, 1], axis], vertices[faces[prim, 2], axis]
    # Adding zero turns -0.0 into 0.0: which of the two a minimum gives would depend on the order of the primitives.
    return min(a, b, c) + np.float32(0.0), max(a, b, c) + np.float32(0.0)


@compiled
def _centre(lower, upper):
    # Halved before they are added: the sum of two large coordinates would overflow.
    return np.float32(0.5) * lower + np.float32(0.5) * upper


@overload(bound_prim)
def _bound_prim(prims, prim):
    if prims.instance_class is Cached:

        def bound(prims, prim):
            aabbs = prims.aabbs
            return aabbs[prim, 0], aabbs[prim, 1], aabbs[prim, 2], aabbs[prim, 3], aabbs[prim, 4], aabbs[prim, 5]

        return bound

    if prims.instance_class is Recomputed:

        def bound(prims, prim):
            min_x, max_x = _bound_corners(prims.vertices, prims.faces, prim, 0)
            min_y, max_y = _bound_corners(prims.vertices, prims.faces, prim, 1)
            min_z, max_z = _bound_corners(prims.vertices, prims.faces, prim, 2)
            return min_x, min_y, min_z, max_x, max_y, max_z

        return bound

    return None


@overload(centroid_of)
def _centroid_of(prims, prim, axis):
    if prims.instance_class is Cached:

        def centroid(prims, prim, axis):
            return prims.centroids[prim, axis]

        return centroid

    if prims.instance_class is Recomputed:

        def centroid(prims, prim, axis):
            # The whole box, as the report's comparison does, although one axis of it is asked for.
            box = bound_prim(prims, prim)
            return _centre(box[axis], box[axis + 3])

        return centroid

    return None


@compiled
def fill_cache(vertices, faces, begin, end, aabbs, centroids):
    """Write the boxes and centroids of the primitives from `begin` to `end`.

    Parameters
    ----------
    vertices : (V, 3) float32
    faces : (n, 3) int32
    aabbs : (n, 6) float32, written
    centroids : (n, 3) float32, written
    """
    for prim in range(begin, end):
        for axis in range(3):
            lower, upper = _bound_corners(vertices, faces, prim, axis)
            aabbs[prim, axis] = lower
            aabbs[prim, axis + 3] = upper
            centroids[prim, axis] = _centre(lower, upper)
