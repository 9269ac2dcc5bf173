"""The looks of the parts of a file, joined to those of one mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..appearance.appearance import Appearance, turn_normals
from ..appearance.flat_normals import find_flat_normals
from ..appearance.material import Material
from .finished_looks import finish_looks

# Of corners whose part has none of them: the middle of no texture, and white, which tints nothing.
_FILLERS = {"uvs": ((3, 2), np.float32, 0), "colours": ((3, 4), np.uint8, 255)}


class LooksPiece(NamedTuple):
    """The looks of a part: arrays of corners by name, one material, and the triangles that they belong to."""

    arrays: Mapping[str, NDArray]
    material: Material | None
    points: NDArray[np.floating]
    faces: NDArray[np.integer]

    def moved(
        self, matrix: NDArray[np.float64], points: NDArray[np.floating], faces: NDArray[np.integer], *, is_turned: bool
    ) -> LooksPiece:
        """Return the piece of moved points.

        Parameters
        ----------
        matrix : (4, 4) float64
            By which the points were moved.
        points, faces : (V, 3) float and (F, 3) int
        is_turned : bool
            Whether the corners of the faces are listed backwards now, because the matrix mirrors.
        """
        arrays = dict(self.arrays)
        if "normals" in arrays and not (matrix == np.eye(4)).all():
            with np.errstate(all="ignore"):
                turned = turn_normals(arrays["normals"], matrix)
            arrays["normals"] = -turned if is_turned else turned
        if is_turned:
            arrays = {name: np.ascontiguousarray(values[:, ::-1]) for name, values in arrays.items()}
        return LooksPiece(arrays, self.material, points, faces)


def join_looks(pieces: Sequence[LooksPiece]) -> Appearance | None:
    """Return the looks of parts that follow each other; None if none of them has any.

    Where some parts have normals, the others have those of their faces.
    """
    arrays: dict[str, NDArray] = {}
    if any("normals" in piece.arrays for piece in pieces):
        arrays["normals"] = _concatenate([_find_normals(piece) for piece in pieces])
    for name, (shape, dtype, filler) in _FILLERS.items():
        if any(name in piece.arrays for piece in pieces):
            fillers = [np.broadcast_to(np.array(filler, dtype), (len(piece.faces), *shape)) for piece in pieces]
            arrays[name] = _concatenate(
                [piece.arrays.get(name, filled) for piece, filled in zip(pieces, fillers, strict=True)]
            )
    used = dict.fromkeys(piece.material for piece in pieces)
    if list(used) == [None] or not used:
        return finish_looks(arrays, [])
    numbers = {material: number for number, material in enumerate(used)}
    if len(used) > 1:
        ids = np.array([numbers[piece.material] for piece in pieces], np.int32)
        arrays["material_ids"] = np.repeat(ids, [len(piece.faces) for piece in pieces])
    # A part without a material in the midst of others is like a mesh without one; its colours are not tinted.
    plain = Material(base_colour=(1.0, 1.0, 1.0)) if "colours" in arrays else Material()
    return finish_looks(arrays, [material or plain for material in used])


def _find_normals(piece: LooksPiece) -> NDArray[np.float32]:
    if "normals" in piece.arrays:
        return piece.arrays["normals"]
    return np.repeat(find_flat_normals(piece.points[piece.faces])[:, None], 3, axis=1)


def _concatenate(arrays: list[NDArray]) -> NDArray:
    return np.ascontiguousarray(arrays[0]) if len(arrays) == 1 else np.concatenate(arrays)
