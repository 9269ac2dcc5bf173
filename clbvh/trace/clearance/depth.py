"""How deep two convex bodies are in each other: the shortest way that parts them.

The differences of a point of one and a point of the other make a convex body, too, and the way is from the origin to
the nearest point of its surface. It is found from within: a hull of some differences grows where it is nearest. See
van den Bergen, "Proximity queries and penetration depth computation on 3D game objects", 2001. The hulls are Qhull's.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError

# Of the bodies' size: a body that is thinner is flat, a face that is nearer by less need not grow.
_TOLERANCE = 2.0**-40

# Of the bodies' size: ways that differ by less are equally short.
_TIE = 2.0**-50

# Faces of a hull that grow in one step.
_MOST_FACES = 256

_FIRST_WAYS = np.array([way for way in product((-1.0, 0.0, 1.0), repeat=3) if any(way)])


class Overlap(NamedTuple):
    """What two convex bodies have in common, as one way to part them tells it.

    Attributes
    ----------
    depth : float
        How far the other has to move; 0 if the bodies only touch.
    normal : (3,) float64
        Where to, of unit length. Of equally short ways that are found the first one, by x, then y, then z.
    points : (2, 3) float64
        The deepest point of each in the other: they are `depth` apart, along the normal.
    """

    depth: float
    normal: NDArray[np.float64]
    points: NDArray[np.float64]


def measure_overlap(one: NDArray[np.float64], other: NDArray[np.float64], least: float = -1.0) -> Overlap | None:
    """Return the shortest way that parts two convex bodies that touch or overlap.

    Parameters
    ----------
    one, other : (m, 3) and (n, 3) float64
        Their corners, and maybe points between them.
    least : float, optional
        A depth: bodies that are not deeper are not measured.

    Returns
    -------
    Overlap or None
        Exact but for roundings, about 1e-14 of the bodies' size; None if it is not deeper than the least.

    Raises
    ------
    ConfigError
        SciPy is not installed.
    """
    centre = one.mean(axis=0)
    size = float(np.ptp(one, axis=0).max() + np.ptp(other, axis=0).max())
    one, other = (one - centre) / size, (other - centre) / size
    found = _find_shortest(one, other, least / size)
    if found is None:
        return None
    depth, normal = found
    return Overlap(depth * size, normal, _find_deepest(one, other, depth, normal) * size + centre)


def _find_shortest(
    one: NDArray[np.float64], other: NDArray[np.float64], least: float
) -> tuple[float, NDArray[np.float64]] | None:
    """Return how far it is along the shortest way, and its direction; None if it is not farther than the least."""
    _, spreads, axes = np.linalg.svd(np.concatenate((one, other - other.mean(axis=0))), full_matrices=False)
    is_flat = spreads[-1] <= _TOLERANCE
    if is_flat:
        ways = axes[-1:]
    else:
        # Those of boxes, and those along the bodies, which meet slender ones on all sides.
        ways = np.concatenate((_FIRST_WAYS, _FIRST_WAYS @ axes))
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    known_ways, known_widths, corners = np.empty((0, 3)), np.empty(0), np.empty((0, 3))
    while len(ways):
        reach = one[(one @ ways.T).argmax(axis=0)] - other[(other @ ways.T).argmin(axis=0)]
        known_ways = np.concatenate((known_ways, ways))
        known_widths = np.concatenate((known_widths, (reach * ways).sum(axis=1)))
        if known_widths.min() <= least:
            return None
        before, corners = len(corners), np.unique(np.concatenate((corners, reach)), axis=0)
        if is_flat or len(corners) == before:
            break  # across two flat bodies, nothing is in the way
        # No way is shorter than the hull's nearest face: a face that is farther than a known way need not grow.
        faces = _find_faces(corners)
        faces = faces[-faces[:, 3] < known_widths.min() - _TOLERANCE]
        ways = faces[np.argsort(-faces[:, 3])[:_MOST_FACES], :3]
    shortest = np.flatnonzero(known_widths <= known_widths.min() + _TIE)
    first = shortest[np.lexsort(known_ways[shortest].round(9).T[::-1])[0]]
    return max(float(known_widths[first]), 0.0), known_ways[first] + 0.0  # no -0.0


def _find_faces(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the faces of the hull of points, (n, 4): their unit normals, and minus their distances from the origin."""
    try:
        from scipy.spatial import ConvexHull, QhullError  # type: ignore[import-untyped]
    except ImportError as error:
        raise ConfigError("the depth of a collision needs SciPy: run 'pip install scipy'") from error
    try:
        return np.asarray(ConvexHull(corners).equations)
    except QhullError:  # points that it cannot order in float64 are moved a little
        return np.asarray(ConvexHull(corners, qhull_options="QJ").equations)


def _find_deepest(
    one: NDArray[np.float64], other: NDArray[np.float64], depth: float, normal: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the deepest point of each, (2, 3), across from each other: means of the corners that lie deepest."""
    from scipy.optimize import nnls  # type: ignore[import-untyped]

    heights = one @ normal, -(other @ normal)
    pieces = [own[each >= each.max() - _TOLERANCE] for own, each in zip((one, other), heights, strict=True)]
    counts = [len(piece) for piece in pieces]
    across = np.concatenate((pieces[0], -pieces[1])).T
    sums = np.repeat(np.eye(2), counts, axis=0).T
    shares, _ = nnls(np.concatenate((across, sums)), np.append(normal * depth, (1.0, 1.0)))
    return np.array([own @ piece for own, piece in zip(np.split(shares, counts[:1]), pieces, strict=True)])
