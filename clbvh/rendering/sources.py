"""Sources of meshes, and the transform that users write: a scale, rotations about the axes, a translation."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry import Mesh, load_mesh
from ..geometry.appearance.material import Material
from ..geometry.fetch import find_known_mesh
from ..geometry.shapes.make_shape import make_shape
from ..geometry.spheres import with_material
from .vectors import Vector, check_vector, is_vector


@dataclass(frozen=True)
class MeshSource:
    """The source of a scene's mesh: exactly one of `path`, `name`, `shape` and `mesh`.

    Attributes
    ----------
    path : str
        A mesh file.
    name : str
        A known mesh, such as ``bunny``.
    shape : str
        A procedural shape, with `triangles`, `seed` and the shape's own `options`.
    mesh : Mesh
        A mesh in memory.
    material : Material, optional
        Of the whole mesh, instead of its own materials and colours.

    Raises
    ------
    SceneError
        None of the four is given, or several.

    Examples
    --------
    >>> import clbvh
    >>> clbvh.MeshSource(shape="icosphere", triangles=1000).load()
    Mesh('icosphere', vertices=492, faces=980)
    >>> clbvh.MeshSource(path="part.ply", name="bunny")
    Traceback (most recent call last):
    clbvh.errors.SceneError: the mesh needs exactly one of path, name and shape, or a Mesh
    """

    path: str | None = None
    name: str | None = None
    shape: str | None = None
    triangles: int = 100_000
    seed: int = 0
    options: dict[str, float] = field(default_factory=dict)
    mesh: Mesh | None = None
    material: Material | None = None

    def __post_init__(self) -> None:
        if sum(value is not None for value in (self.path, self.name, self.shape, self.mesh)) != 1:
            raise SceneError("the mesh needs exactly one of path, name and shape, or a Mesh")

    def load(self) -> Mesh:
        """Return the mesh; raise `MeshError` or `ConfigError` if there is none.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.MeshSource(shape="icosphere", triangles=1000).load().face_count
        980
        """
        mesh = self._load_bare()
        return mesh if self.material is None else with_material(mesh, self.material)

    def _load_bare(self) -> Mesh:
        if self.mesh is not None:
            return self.mesh
        if self.shape is not None:
            return make_shape(self.shape, triangles=self.triangles, seed=self.seed, **self.options)
        return load_mesh(self.file())

    def file(self) -> Path:
        """Return the file that `load` reads.

        Examples
        --------
        >>> import clbvh
        >>> print(clbvh.MeshSource(path="part.ply").file())
        part.ply
        """
        return find_known_mesh(self.name) if self.name is not None else Path(str(self.path))


@dataclass(frozen=True)
class Transform:
    """The placement of the mesh: scaled, then rotated, then translated.

    Attributes
    ----------
    scale : float, or (3,) float
        Of all axes, or of x, y and z. Not zero.
    rotate : (3,) float
        Degrees about x, then y, then z.
    translate : (3,) float, the scene's units

    Raises
    ------
    SceneError
        A value is not finite, or the scale is zero.

    Examples
    --------
    >>> import clbvh
    >>> upright = clbvh.Transform(scale=0.001, rotate=(-90, 0, 0))  # millimetres, z up, to metres, y up
    >>> part = clbvh.Mesh.from_arrays([[0, 0, 0], [1000, 0, 0], [0, 0, 2000]], [[0, 1, 2]])
    >>> upright.apply(part).vertices.round(6).max(axis=0)
    array([1., 2., 0.])
    """

    scale: float | Vector = 1.0
    rotate: Vector = (0.0, 0.0, 0.0)
    translate: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        is_number = isinstance(self.scale, Real) and math.isfinite(self.scale)
        if not (is_number or is_vector(self.scale)) or not np.all(self.scale):
            raise SceneError(
                f"the transform's scale must be a finite number other than 0, or three of them, not {self.scale!r}"
            )
        if not is_number:
            object.__setattr__(self, "scale", tuple(map(float, self.scale)))  # type: ignore[arg-type]
        check_vector("the transform's rotate", self.rotate)
        check_vector("the transform's translate", self.translate)

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
        if self == NO_TRANSFORM:
            return mesh
        points = mesh.vertices * self.scale @ self._rotation.T + np.asarray(self.translate)
        appearance = None if mesh.appearance is None else mesh.appearance.transformed(self.matrix)
        return Mesh.from_arrays(points, mesh.faces, name=mesh.name, appearance=appearance)

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(4, 4) float64: the transform that `Scene.place` takes.

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


NO_TRANSFORM = Transform()


def _rotate_about(axis: int, angle: float) -> NDArray[np.float64]:
    """Return the right-handed rotation about one axis, (3, 3) float64."""
    rotation = np.eye(3)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rotation[first, first] = rotation[second, second] = math.cos(angle)
    rotation[second, first] = math.sin(angle)
    rotation[first, second] = -math.sin(angle)
    return rotation
