"""Transforms of instances: the checks of (4, 4) matrices, and their inverses, for many at a time.

Owns the limit at which a matrix counts as singular. Must not know of scenes.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError
from ..support.masked import has_masked_values

# A linear part whose rows and columns are scaled to a largest entry of about 1 is refused below this determinant: that
# is ten times its rounding error, so nothing would be known about the inverse.
_LEAST_DETERMINANT = 2.0**-46

_AFFINE_ROW = (0.0, 0.0, 0.0, 1.0)


def check_transform(transform: ArrayLike | None, name: str = "the transform") -> NDArray[np.float64]:
    """Return one transform as (4, 4) float64 of our own; the identity for None.

    Raises
    ------
    SceneError
        See `check_transforms`.
    """
    if transform is None:
        return np.eye(4)
    matrix = _as_numbers(transform, name)
    if matrix.shape != (4, 4):
        raise SceneError(f"{name} must be a matrix of shape (4, 4), not {matrix.shape}")
    return check_transforms(matrix[None], lambda _: name)[0]


def check_transforms(
    transforms: ArrayLike, name_of: Callable[[int], str] = lambda index: f"transform {index}"
) -> NDArray[np.float64]:
    """Return transforms as (n, 4, 4) float64 of our own.

    Parameters
    ----------
    transforms : (n, 4, 4) float
        Affine maps to the scene's coordinates: the last row is 0, 0, 0, 1. Rotation, scale of any kind, shear and
        mirror are allowed.
    name_of : function, optional
        The name of transform i in messages.

    Raises
    ------
    SceneError
        Another shape or dtype, an entry that is not finite, another last row, or a matrix that has no inverse to within
        rounding. The message names the first fault.
    """
    given = _as_numbers(transforms, "the transforms")
    if given.ndim != 3 or given.shape[1:] != (4, 4):
        raise SceneError(f"the transforms must be an array of shape (n, 4, 4), not {given.shape}")
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is found below
        matrices = np.array(given, np.float64, order="C")
    finite = np.isfinite(matrices).all(axis=(1, 2))
    if not finite.all():
        index = int(np.argmin(finite))
        row, column = np.argwhere(~np.isfinite(matrices[index]))[0]
        raise SceneError(f"{name_of(index)} has {matrices[index, row, column]} in row {row}, column {column}")
    affine = (matrices[:, 3] == _AFFINE_ROW).all(axis=1)
    if not affine.all():
        index = int(np.argmin(affine))
        raise SceneError(
            f"{name_of(index)} must be affine, with the last row 0, 0, 0, 1, not "
            f"{', '.join(f'{value:g}' for value in matrices[index, 3])}: is it transposed?"
        )
    regular = _are_regular(matrices[:, :3, :3])
    if not regular.all():
        raise SceneError(
            f"{name_of(int(np.argmin(regular)))} is singular: it flattens what it moves, and rays cannot be moved back"
        )
    return matrices


def invert_transforms(transforms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverses of (n, 4, 4) transforms that `check_transforms` has accepted."""
    inverses = np.zeros_like(transforms)
    linear = np.linalg.inv(transforms[:, :3, :3])
    inverses[:, :3, :3] = linear
    inverses[:, :3, 3] = -(linear @ transforms[:, :3, 3:])[..., 0]
    inverses[:, 3, 3] = 1.0
    return inverses


def _as_numbers(values: ArrayLike, name: str) -> NDArray:
    try:
        array = np.asarray(values)
    except (ValueError, TypeError) as error:
        raise SceneError(f"{name} must be a matrix of shape (4, 4): {error}") from error
    if has_masked_values(values):
        raise SceneError(f"{name} must be numbers, but some are masked")
    if array.dtype.kind not in "iuf":
        raise SceneError(f"{name} must be numbers, not {array.dtype}")
    return array


def _are_regular(linear: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return for each (3, 3) matrix whether its inverse is known.

    Rows and columns are scaled by powers of two first, which rounds nothing. So the unit of either side does not
    matter, nor does a scale that differs between the axes of the geometry or of the scene.
    """
    # Columns before rows: rows of a flattened and rotated geometry are all alike.
    scaled = linear
    for axis in (1, 2):
        largest = np.abs(scaled).max(axis=axis, keepdims=True)
        scaled = np.ldexp(scaled, -np.frexp(largest)[1])
    a, b, c = scaled[:, 0], scaled[:, 1], scaled[:, 2]
    determinant = (
        a[:, 0] * (b[:, 1] * c[:, 2] - b[:, 2] * c[:, 1])
        + a[:, 1] * (b[:, 2] * c[:, 0] - b[:, 0] * c[:, 2])
        + a[:, 2] * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
    )
    return np.abs(determinant) >= _LEAST_DETERMINANT
