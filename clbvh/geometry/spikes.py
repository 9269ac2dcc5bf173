"""Spikes: triangles that run to a vertex far away from all others, of which a coordinate was read or computed wrong.

The box of a spike begins among the other triangles, so it is no stray: see `strays.py`. Owns what counts as one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .mesh import Mesh
from .strays import find_strays

# The empty space before the vertex, in diagonals of the box around the others: with it in the picture, they would have
# less than a tenth of its width. It is more than for strays, because the top of a mast may be one vertex, too.
LEAST_GAP = 10.0


def find_spikes(mesh: Mesh, lower: NDArray[np.float64], upper: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which faces of a mesh are spikes, (F,) bool.

    Parameters
    ----------
    mesh : Mesh
    lower, upper : (3,) float64, local units
        A box around most of the mesh.

    Notes
    -----
    A face with two far corners belongs to something that is there, such as a ground or a mast: then there are no spikes
    at all.

    Examples
    --------
    >>> import clbvh
    >>> from clbvh.geometry.spikes import find_spikes
    >>> ball = clbvh.make_shape("icosphere", triangles=320)
    >>> vertices = ball.vertices.copy()
    >>> vertices[7] = 90, 0, 0
    >>> spiked = clbvh.Mesh.from_arrays(vertices, ball.faces)
    >>> middle = spiked.local_vertices[:7].astype(float)
    >>> int(find_spikes(spiked, middle.min(axis=0), middle.max(axis=0)).sum())
    5
    """
    none = np.zeros(mesh.face_count, bool)
    used = np.unique(mesh.faces)
    points = mesh.local_vertices[used].astype(np.float64)
    is_inside = ((points >= lower) & (points <= upper)).all(axis=1)
    around = np.flatnonzero(~is_inside)
    # What is in the box is one thing.
    begins, ends = np.concatenate((lower[None], points[around])), np.concatenate((upper[None], points[around]))
    counts = np.ones(len(begins))
    counts[0] += np.count_nonzero(is_inside)
    is_stray = find_strays(begins, ends, counts, counts, LEAST_GAP)
    is_far = np.zeros(len(mesh.vertices), bool)
    is_far[used[around[is_stray[1:]]]] = True
    far_corners = np.count_nonzero(is_far[mesh.faces], axis=1)
    return none if (far_corners > 1).any() else far_corners == 1
