"""Transforms of instances: as users write them, and the checks of (4, 4) matrices, for many at a time.

Must not know of scenes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError
from ..geometry.arrays import read_numbers
from ..geometry.local_frame import is_singular, rotation_matrix
from ..geometry.mesh import Mesh
from .handles import Vector, read_vector, shorten


@dataclass(frozen=True)
class Transform:
    """A placement: scale, then rotation, then translation; or any affine map, by its rows.

    Attributes
    ----------
    scale : float, or (3,) float
        Scale of all axes, or of x, y and z; not zero.
    rotate : (3,) float
        Degrees about x, then y, then z.
    translate : (3,) float, the scene's units
    rows : (3, 4) or (4, 4) float, optional
        Rows of the matrix, in place of the three above: a point x of the geometry is at ``rows[:, :3] @ x +
        rows[:, 3]``. A fourth row is 0, 0, 0, 1. Kept as a tuple of three rows.

    Raises
    ------
    SceneError
        A value is not finite, or the scale is zero; rows of another shape, of a singular matrix, or beside one of the
        others.

    Examples
    --------
    >>> import clbvh
    >>> upright = clbvh.Transform(scale=0.001, rotate=(-90, 0, 0))  # millimetres, z up, to metres, y up
    >>> part = clbvh.Mesh.from_arrays([[0, 0, 0], [1000, 0, 0], [0, 0, 2000]], [[0, 1, 2]])
    >>> upright.apply(part).vertices.round(6).max(axis=0)
    array([1., 2., 0.])
    >>> clbvh.Transform(rows=[[0, -1, 0, 5], [1, 0, 0, 0], [0, 0, 1, 0]]).matrix[:3, 3]
    array([5., 0., 0.])
    """

    scale: float | Vector = 1.0
    rotate: Vector = (0.0, 0.0, 0.0)
    translate: Vector = (0.0, 0.0, 0.0)
    rows: tuple[tuple[float, float, float, float], ...] | None = None

    def __post_init__(self) -> None:
        for name in ("rotate", "translate"):
            values = read_vector(getattr(self, name), f"the transform's {name} must be three finite numbers")
            object.__setattr__(self, name, values)
        is_number = isinstance(self.scale, Real)
        scales = (self.scale,) * 3 if is_number else self.scale
        expected = "the transform's scale must be a finite number other than 0, or three of them"
        scale = read_vector(scales, expected)
        if not all(scale):
            raise SceneError(f"{expected}, not {self.scale!r}")
        object.__setattr__(self, "scale", scale[0] if is_number else scale)
        if self.rows is not None:
            rows = read_numbers(self.rows, "the transform's rows", SceneError)
            matrix = check_transform(np.vstack((rows, np.eye(4)[3:])) if rows.shape == (3, 4) else rows)
            if (self.scale, self.rotate, self.translate) != (1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)):
                raise SceneError("a transform has rows, or scale, rotate and translate, not both")
            object.__setattr__(self, "rows", tuple(map(tuple, matrix[:3].tolist())))

    @classmethod
    def from_quaternion(
        cls, quaternion: ArrayLike, translate: ArrayLike = (0.0, 0.0, 0.0), *, scale: float | Vector = 1.0
    ) -> Transform:
        """Return a placement whose rotation is a quaternion: scale, then rotation, then translation.

        Parameters
        ----------
        quaternion : (4,) float
            w, x, y, z, the real part first, of any length above 0: for length 1, a right-handed turn by ``2 acos(w)``
            about (x, y, z). ROS and scipy have w last.
        translate : (3,) float, the scene's units
        scale : float, or (3,) float

        Raises
        ------
        SceneError
            A quaternion that is not four finite numbers, or is zero; and see `Transform`.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Transform.from_quaternion((1, 0, 0, 1), (5, 0, 0)).matrix.round(6)  # a quarter turn about z
        array([[ 0., -1.,  0.,  5.],
               [ 1.,  0.,  0.,  0.],
               [ 0.,  0.,  1.,  0.],
               [ 0.,  0.,  0.,  1.]])
        """
        parts = read_numbers(quaternion, "the quaternion", SceneError)
        if parts.shape != (4,) or not np.isfinite(parts).all() or not parts.any():
            raise SceneError(
                f"a quaternion must be four finite numbers w, x, y, z, not all 0, not {shorten(quaternion)}"
            )
        unit = parts / np.abs(parts).max()
        w, x, y, z = (unit / np.linalg.norm(unit)).tolist()
        rest = cls(scale, translate=translate)  # type: ignore[arg-type]  # checked there
        return cls(rows=np.column_stack((rotation_matrix(x, y, z, w) * rest.scale, rest.translate)))  # type: ignore[arg-type]

    @np.errstate(over="ignore", invalid="ignore")  # coordinates that are not finite are refused by the mesh
    def apply(self, mesh: Mesh) -> Mesh:
        """Return the mesh in the scene's coordinates.

        Examples
        --------
        >>> import clbvh
        >>> mesh = clbvh.make_shape("icosphere", triangles=1000)
        >>> clbvh.Transform(translate=(0, 0, 5)).apply(mesh).origin
        array([0., 0., 5.])
        """
        if self == Transform():
            return mesh
        matrix = self.matrix
        points = mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3]
        appearance = None if mesh.appearance is None else mesh.appearance.transformed(matrix)
        return Mesh.from_arrays(points, mesh.faces, name=mesh.name, appearance=appearance, parts=mesh.parts)

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(4, 4) float64: the matrix that `Scene.place` takes.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Transform(scale=2, translate=(0, 0, 5)).matrix
        array([[2., 0., 0., 0.],
               [0., 2., 0., 0.],
               [0., 0., 2., 5.],
               [0., 0., 0., 1.]])
        """
        matrix = np.eye(4)
        matrix[:3, :3] = self._rotation * self.scale
        matrix[:3, 3] = self.translate
        if self.rows is not None:
            matrix[:3] = self.rows
        return matrix

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return `matrix`, so that a transform can be given for an array."""
        return self.matrix if dtype is None else self.matrix.astype(dtype)

    @property
    def _rotation(self) -> NDArray[np.float64]:
        rotation = np.eye(3)
        for axis, degrees in enumerate(self.rotate):
            rotation = _rotate_about(axis, math.radians(degrees)) @ rotation
        return rotation


def _rotate_about(axis: int, angle: float) -> NDArray[np.float64]:
    """Return the right-handed rotation about one axis, (3, 3) float64."""
    rotation = np.eye(3)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rotation[first, first] = rotation[second, second] = math.cos(angle)
    rotation[second, first] = math.sin(angle)
    rotation[first, second] = -math.sin(angle)
    return rotation


# The faults of a matrix.
_NOT_FINITE, _NOT_AFFINE, _SINGULAR = 1, 2, 3

# Matrices that are checked at a time: few enough for the cache.
_CHECKED = 1 << 12


def check_transform(transform: ArrayLike | None, name: str = "the transform") -> NDArray[np.float64]:
    """Return one transform as a new (4, 4) float64 array; the identity for None.

    Raises
    ------
    SceneError
        See `check_transforms`.
    """
    if transform is None:
        return np.eye(4)
    matrix = read_numbers(transform, name, SceneError)
    if matrix.shape != (4, 4):
        raise SceneError(f"{name} must be a matrix of shape (4, 4), not {matrix.shape}")
    return check_transforms(matrix[None], lambda _: name)[0]


def check_transforms(
    transforms: ArrayLike, name_of: Callable[[int], str] = lambda index: f"transform {index}"
) -> NDArray[np.float64]:
    """Return transforms as a new (n, 4, 4) float64 array.

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
    array = read_numbers(transforms, "the transforms", SceneError)
    if array.ndim != 3 or array.shape[1:] != (4, 4):
        raise SceneError(f"the transforms must be an array of shape (n, 4, 4), not {array.shape}")
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is found below
        matrices = np.array(array, np.float64, order="C")
    for begin in range(0, len(matrices), _CHECKED):
        faults = _find_faults(matrices[begin : begin + _CHECKED])
        if faults.any():
            index = begin + int(np.argmax(faults != 0))
            raise SceneError(f"{name_of(index)} {_describe_fault(faults[index - begin], matrices[index])}")
    return matrices


def _describe_fault(fault: int, matrix: NDArray[np.float64]) -> str:
    if fault == _NOT_FINITE:
        row, column = np.argwhere(~np.isfinite(matrix))[0]
        return f"must be finite, but has {matrix[row, column]} in row {row}, column {column} (from 0)"
    if fault == _NOT_AFFINE:
        last = ", ".join(f"{value:g}" for value in matrix[3])
        return f"must be affine, with the last row 0, 0, 0, 1, not {last}: is it transposed?"
    return "is singular: it flattens what it moves, and rays cannot be moved back"


def _find_faults(matrices: NDArray[np.float64]) -> NDArray[np.integer]:
    """Return the first fault of each of (n, 4, 4) matrices, n > 0: one of the constants above, or 0."""
    entries = np.ascontiguousarray(matrices.transpose(1, 2, 0))  # numpy is slow along short axes
    is_finite = np.isfinite(entries).all(axis=(0, 1))
    is_affine = (entries[3].T == (0.0, 0.0, 0.0, 1.0)).all(axis=1)
    return np.select((~is_finite, ~is_affine, is_singular(entries)), (_NOT_FINITE, _NOT_AFFINE, _SINGULAR), 0)
