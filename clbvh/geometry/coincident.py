"""Faces of a mesh that coincide: which of them a ray must not count, so that the parity of its hits tells the inside.

An export with both sides has each face twice, and a ray leaves its solid an even number of times. Two solids that touch
have their common wall twice, too, and there both count. Which of the two it is, is told for each surface, the faces
that hang together by edges, from where it is closed: parity is right on closed surfaces alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..device.host.loops import Loops
from .topology import INDEX_BITS, find_equal_points, find_points

# Corners in the same cell of this size, in local units, are as near as float32 tells apart at the rim of the mesh.
_CELLS = np.float32(2.0**24)

# A face of at least this many cells whose corners are in the cells of another's is a shifted copy, and no neighbour.
_LEAST_CELLS = 64

_CORNERS_OF_EDGE = 2

# Where more faces coincide, hardly any are left out, and to find them takes longer than to look at all.
_FEW = 8

_LOOPS = Loops("geometry/coincident")


class Coincidence(NamedTuple):
    """What coincident faces mean for the inside of a mesh.

    Attributes
    ----------
    faces : (n,) int64
        Faces that coincide with another one.
    repeated : (m,) int64
        Those of them that coincide with an earlier one.
    surplus : (k,) int64
        Those of these that do not count as hits of a ray, so that the parity of the others tells the inside.
    is_closed : bool or None
        Whether all surfaces are closed then, each face counting once; None where no faces coincide.
    has_shifted : bool
        Whether faces are so near to others that float32 can hardly tell them apart, without coinciding.
    """

    faces: NDArray[np.int64]
    repeated: NDArray[np.int64]
    surplus: NDArray[np.int64]
    is_closed: bool | None
    has_shifted: bool


_NONE = np.empty(0, np.int64)
NO_COINCIDENCE = Coincidence(_NONE, _NONE, _NONE, is_closed=None, has_shifted=False)


def find_coincidence(
    vertices: NDArray[np.float64],
    local_vertices: NDArray[np.float32],
    faces: NDArray[np.int32],
    is_even: Callable[[], bool],
) -> Coincidence:
    """Find the faces with the same three corners, in any order; vertices with equal coordinates are one corner.

    Parameters
    ----------
    vertices : (V, 3) float64
    local_vertices : (V, 3) float32
        The same, from -1 to 1.
    faces : (F, 3) int32
    is_even : function
        Returns whether each edge belongs to an even number of faces, see `is_closed`.

    Notes
    -----
    About 11 ms for 871,306 faces none of which coincide, 50 ms where few do, and 1.2 us a face where most do.
    """
    # Coincident faces have equal keys, and so have shifted copies. Hardly any others have, and these are compared.
    keys, face_keys = np.empty(len(vertices), np.uint64), np.empty(len(faces), np.uint64)
    _LOOPS.find_keys(local_vertices, faces, keys, face_keys)
    sorted_keys = np.sort(face_keys)
    repeated_keys = sorted_keys[1:][sorted_keys[1:] == sorted_keys[:-1]]
    if len(repeated_keys) == 0:
        return NO_COINCIDENCE

    # Where the mesh is closed as it is, only surfaces all of whose faces coincide with others can need another count:
    # these faces, and their neighbours, tell enough.
    chosen = np.arange(len(faces))
    is_closed_as_it_is = is_even()
    if is_closed_as_it_is and len(repeated_keys) < len(faces) // _FEW:
        is_near = np.isin(keys, keys[faces[np.isin(face_keys, repeated_keys)]])
        chosen = np.flatnonzero(is_near[faces].sum(axis=1) >= _CORNERS_OF_EDGE)
    near_faces = faces[chosen]
    is_used = np.zeros(len(vertices), np.bool_)
    is_used[near_faces] = True

    def find_ids(points: NDArray[Any]) -> NDArray[np.int64]:
        ids = np.zeros(len(points), np.int64)
        ids[is_used] = find_points(points[is_used]).ids
        return ids[near_faces]

    cells = np.rint(local_vertices * _CELLS)
    first, ids = find_equal_points(np.sort(find_ids(vertices), axis=1))
    has_shifted = _has_shifted(cells[near_faces[first]], find_ids(cells)[first])
    counts = np.bincount(ids, minlength=len(first))
    if len(first) == len(ids):
        return NO_COINCIDENCE._replace(has_shifted=has_shifted)

    # Of each group of coincident faces one. Faces with two corners in a point have no area, and only join surfaces.
    joined = find_ids(local_vertices)[first]
    groups = np.flatnonzero((joined != np.roll(joined, 1, axis=1)).all(axis=1))
    is_odd, is_closed = _choose_parities(joined[groups], counts[groups], is_closed_as_it_is)
    wrong = np.zeros(len(first), np.bool_)
    wrong[groups] = is_odd != (counts[groups] % 2 == 1)
    last = np.zeros(len(first), np.int64)
    np.maximum.at(last, ids, np.arange(len(ids)))
    repeated, surplus = np.delete(chosen, first), chosen[np.sort(last[wrong])]
    return Coincidence(chosen[counts[ids] > 1], repeated, surplus, is_closed, has_shifted)


def _has_shifted(cells: NDArray[np.float32], cell_ids: NDArray[np.int64]) -> bool:
    """Return whether two of different faces have their corners in the same cells; (n, 3, 3) and (n, 3)."""
    is_large = (np.ptp(cells, axis=1).max(axis=1) >= _LEAST_CELLS) & (cell_ids != np.roll(cell_ids, 1, 1)).all(axis=1)
    large = np.sort(cell_ids[is_large], axis=1)
    return len(find_equal_points(large).first) < len(large)


def _choose_parities(
    faces: NDArray[np.int64], counts: NDArray[np.int64], is_closed_as_it_is: bool
) -> tuple[NDArray[np.bool_], bool]:
    """Return which faces a ray is to count an odd number of times, and whether all surfaces are closed then.

    Parameters
    ----------
    faces : (n, 3) int64
        Points; none coincide.
    counts : (n,) int64
        How often each of them is there.
    is_closed_as_it_is : bool
        Whether surfaces with a face that is there once are closed where faces count as often as they are there.
    """
    ends = np.roll(faces, -1, axis=1)
    edges = np.minimum(faces, ends) << INDEX_BITS | np.maximum(faces, ends)
    numbers, edge_ids = np.unique(edges, return_inverse=True)
    edge_ids = edge_ids.reshape(-1, 3)
    surfaces = np.empty(len(faces), np.int64)
    _LOOPS.join_faces(edge_ids, np.full(len(numbers), -1), surfaces)

    def find_open(is_odd: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return of each face whether its surface has an edge at an odd number of faces that count."""
        uses = np.bincount(edge_ids[is_odd].reshape(-1), minlength=len(numbers))
        is_open = np.zeros(len(faces), np.bool_)
        is_open[surfaces[(uses[edge_ids] % 2 == 1).any(axis=1)]] = True
        return is_open[surfaces]

    # Where all faces of a surface are there twice, it is one of half as many: walls between touching solids may be
    # there four times. Else those that are there more often may be walls, or parts that are there once too often.
    common = np.zeros(len(faces), np.int64)
    np.gcd.at(common, surfaces, counts)
    is_odd = counts // common[surfaces] % 2 == 1
    is_open, is_open_once = find_open(is_odd), find_open(np.ones_like(is_odd))
    if is_closed_as_it_is:
        is_open &= common[surfaces] > 1
    is_odd = np.where(is_open, ~is_open_once | (counts % 2 == 1), is_odd)
    return is_odd, not (is_open & is_open_once).any()
