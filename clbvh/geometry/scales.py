"""Shapes that span scales: parts so small beside the whole that float32 cannot tell them apart.

Owns the rule by which float64 decides what rays hit, and where such a shape has its origin. Must not know of rays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..device.host.loops import Loops
from .local_frame import find_bounds, find_frame, shift_and_scale

# A shape spans scales if a part of it is smaller than this share of half its box: a vertex all of whose triangles are,
# or a sphere. Float32 moves rays and corners by 2^-22 of the half, all roundings together. The dragon of 871,306
# triangles, which has slivers of 2^-21, has no such vertex below 2^-15.2; a mesh of 100 million is at 2^-13.
LEAST_SHARE = 2.0**-16

_LOOPS = Loops("geometry/faces")


class Frame(NamedTuple):
    """The local coordinates of a mesh.

    Attributes
    ----------
    local_vertices : (V, 3) float32
        Zero for vertices that no face uses.
    origin : (3,) float64
        The centre of the box around all vertices that faces use; if the mesh spans scales, one of the vertices of its
        smallest parts, since float32 resolves most there.
    scale : float
        A power of two.
    spans_scales : bool
    loose_vertices : (n,) int64
        Those that no face uses, ascending.
    sized_scale : float
        The scale of the mesh when its sizes were looked at, now or before it moved.
    """

    local_vertices: NDArray[np.float32]
    origin: NDArray[np.float64]
    scale: float
    spans_scales: bool
    loose_vertices: NDArray[np.int64]
    sized_scale: float


def find_mesh_frame(vertices: NDArray[np.float64], faces: NDArray[np.int32], name: str) -> Frame:
    """Return the local coordinates of a mesh.

    Raises
    ------
    MeshError
        The box is too small or too large, see `find_frame`.
    """
    sizes = np.full(len(vertices), -1.0)
    _LOOPS.find_sizes(vertices, faces, sizes)
    loose = np.flatnonzero(sizes < 0.0)
    bounds = _find_used_bounds(vertices, loose)
    origin, scale = find_frame(*bounds, name, subject="the mesh is")
    is_small = (sizes > 0.0) & (sizes * scale < LEAST_SHARE)
    spans_scales = bool(is_small.any())
    if spans_scales:
        # In the middle of the small parts, along the longest side of the box.
        small = vertices[is_small]
        along = small[:, int(np.argmax(bounds[1] - bounds[0]))]
        origin = small[np.argpartition(along, len(small) // 2)[len(small) // 2]]
        reach = np.maximum(bounds[1] - origin, origin - bounds[0])
        scale = find_frame(-reach, reach, name, subject="the mesh is")[1]
    return Frame(_localize(vertices, loose, origin, scale), origin, scale, spans_scales, loose, scale)


def move_frame(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    name: str,
    *,
    loose: NDArray[np.int64],
    sized_scale: float,
) -> Frame:
    """Return the local coordinates of a mesh that did not span scales, and has moved.

    Its sizes are looked at again if it has grown to more than twice its size, since that takes half as long as the
    whole refit of a tree: 12 of 22 ms for 871,306 triangles.
    """
    origin, scale = find_frame(*_find_used_bounds(vertices, loose), name, subject="the mesh is")
    if scale < sized_scale / 2:
        return find_mesh_frame(vertices, faces, name)
    return Frame(_localize(vertices, loose, origin, scale), origin, scale, False, loose, sized_scale)


def _find_used_bounds(
    vertices: NDArray[np.float64], loose: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return find_bounds(np.delete(vertices, loose, axis=0) if len(loose) else vertices)


def _localize(
    vertices: NDArray[np.float64], loose: NDArray[np.int64], origin: NDArray[np.float64], scale: float
) -> NDArray[np.float32]:
    if len(loose):
        vertices = vertices.copy()
        vertices[loose] = origin
    return shift_and_scale(vertices, origin, scale)
