"""Values of a file's lists, spread to the corners of its triangles.

Owns what happens to values that cannot be used. The lists are those of the file: one value per vertex, or lists of
their own with an index for each corner.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ..appearance.flat_normals import find_flat_normals
from ..appearance.srgb import to_bytes
from ..appearance.unit_vectors import normalize

_MAX_BYTE = 255


def spread_normals(
    normals: NDArray[np.number],
    ids: NDArray[np.integer],
    vertices: NDArray[np.number],
    faces: NDArray[np.integer],
) -> NDArray[np.float32]:
    """Return unit normals at corners, (F, 3, 3) float32. Corners without one have that of their face.

    Parameters
    ----------
    normals : (n, 3) float
        Of any length. Those of length 0 are none.
    ids : (F, 3) int
        The normal of each corner; -1 where it has none.
    vertices, faces : (V, 3) float and (F, 3) int
        The triangles.

    Raises
    ------
    MeshError
        A normal is not finite, or an id is out of range.
    """
    check_ids(ids, len(normals))
    if not np.isfinite(normals).all():
        raise MeshError("some are not finite")
    unit, has_direction = normalize(normals)
    if has_direction.all() and (len(ids) == 0 or ids.min() >= 0):
        return np.take(unit, ids, axis=0)  # three times as fast as an index
    # The last one is for the id -1.
    spread = np.concatenate((unit, np.zeros((1, 3), np.float32)))[ids]
    missing = ~np.append(has_direction, False)[ids]
    lacking = np.flatnonzero(missing.any(axis=1))
    # A face that has a vertex out of range is refused later.
    flat = find_flat_normals(vertices[np.clip(faces[lacking], 0, len(vertices) - 1)])
    spread[lacking] = np.where(missing[lacking][..., None], flat[:, None], spread[lacking])
    return spread


def spread_uvs(uvs: NDArray[np.number], ids: NDArray[np.integer]) -> NDArray[np.float32]:
    """Return texture coordinates at corners, (F, 3, 2) float32; (0, 0) where the id is -1.

    Raises
    ------
    MeshError
        A coordinate is not finite, or an id is out of range.
    """
    check_ids(ids, len(uvs))
    with np.errstate(over="ignore"):
        small = uvs.astype(np.float32)
    if not np.isfinite(small).all():
        raise MeshError("some are not finite")
    if len(ids) and ids.min() < 0:
        small = np.concatenate((small, np.zeros((1, 2), np.float32)))
    # Two numbers are one of eight bytes: gathered ten times as fast.
    pairs = np.ascontiguousarray(small).view(np.uint64)[:, 0]
    return pairs[ids][..., None].view(np.float32)


def join_channels(channels: list[NDArray[np.number]], dtype: np.dtype) -> NDArray[np.uint8]:
    """Return colours, (n, 4) uint8, of three or four lists of numbers.

    Parameters
    ----------
    channels : list of (n,) number
        Red, green, blue and perhaps alpha.
    dtype : dtype
        The type of the file: whole numbers are shares of 255, or of the greatest of 16 bits; others are shares of 1,
        but of 255 if one is above 1.

    Raises
    ------
    ValueError
        A number is NaN.
    """
    whole = dtype.kind in "iu"
    if whole and all(channel.dtype == np.uint8 for channel in channels):
        values = np.column_stack(channels)
    else:
        numbers = np.column_stack(channels)
        if whole:
            most = np.iinfo(np.uint16).max if dtype.itemsize == 2 else _MAX_BYTE
        else:
            most = _MAX_BYTE if len(numbers) and np.nanmax(numbers, initial=0) > 1 else 1
        values = to_bytes(numbers / np.float32(most))
    if values.shape[1] == 3:
        values = np.column_stack((values, np.full(len(values), _MAX_BYTE, np.uint8)))
    return np.ascontiguousarray(values)


def check_ids(ids: NDArray[np.integer], count: int) -> None:
    """Raise `MeshError` if an id is out of range; -1 is allowed."""
    if len(ids) and not -1 <= int(ids.min()) <= int(ids.max()) < count:
        raise MeshError(f"a corner refers to one that is not among the {count:,}")


def spread_colours(colours: NDArray[np.uint8], ids: NDArray[np.integer]) -> NDArray[np.uint8]:
    """Return colours at corners, (F, 3, 4) uint8, of a list, (n, 4) uint8."""
    check_ids(ids, len(colours))
    # Four bytes are one number: gathered four times as fast.
    return colours.view(np.uint32)[:, 0][ids][..., None].view(np.uint8)
