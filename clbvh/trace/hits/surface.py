"""The surface that rays have hit: the placed geometries of a scene, or one mesh.

`Hits` asks its surface where the hits are, which normals they have, and from where rays leave them. A surface knows
shapes and transforms, and nothing of rays and devices.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Mesh, Shape
from ...structs import NO_PRIM
from ..world.surface_arrays import SurfaceArrays, SurfacePoints, lone_arrays, make_surface_arrays
from .interpolate import find_smooth_normals
from .locations import find_locations, find_normals
from .offsets import find_offset_points, find_sides


@dataclass(frozen=True, eq=False)
class Surface:
    """The surfaces of a scene's instances in world coordinates, as they were when the rays were cast.

    Its methods are functions of points; where a point is on no primitive, they return NaN.

    Attributes
    ----------
    arrays : SurfaceArrays
    shapes : sequence of Mesh or Spheres
        The shape of each geometry.
    names : sequence of str
        The name of each geometry.
    """

    arrays: SurfaceArrays
    shapes: Sequence[Shape]
    names: Sequence[str]

    @classmethod
    def from_shapes(
        cls,
        shapes: Sequence[Shape],
        names: Sequence[str],
        geometry_id: NDArray[np.integer],
        transforms: NDArray[np.float64],
    ) -> Surface:
        """Return the surfaces of instances; see `make_surface_arrays`."""
        return cls(make_surface_arrays(shapes, geometry_id, transforms), shapes, names)

    @classmethod
    def of_mesh(cls, mesh: Mesh) -> Surface:
        """Return the surface of one mesh in the file's coordinates."""
        return cls(lone_arrays(mesh), (mesh,), (mesh.name,))

    @property
    def lone_mesh(self) -> Mesh | None:
        """The mesh, if it is all that there is."""
        return self.shapes[0] if self.arrays.is_lone and isinstance(self.shapes[0], Mesh) else None

    @cached_property
    def scene_reach(self) -> float:
        """Half the largest side of the box around all instances, in world units."""
        arrays = self.arrays
        if len(arrays.geometry_id) == 0:
            return 0.0
        middles = np.einsum("nij,nj->ni", arrays.linear, arrays.origin[arrays.geometry_id]) + arrays.offset
        halves = np.einsum("nij,nj->ni", np.abs(arrays.linear), arrays.half_size[arrays.geometry_id])
        return float(np.max((middles + halves).max(axis=0) / 2 - (middles - halves).min(axis=0) / 2))

    def geometry_ids(self, points: SurfacePoints) -> NDArray[np.int32]:
        """Return (...) int32: the geometry of each point, -1 for none."""
        geometry_id, instances = self.arrays.geometry_id, points.instance_id
        if len(geometry_id) == 0:
            return instances
        return np.asarray(np.where(instances == NO_PRIM, np.int32(NO_PRIM), geometry_id[instances]))

    def locate(self, points: SurfacePoints) -> NDArray[np.float64]:
        """Return (..., 3) float64: where the points are."""
        return find_locations(self.arrays, points)

    def normals(self, points: SurfacePoints) -> NDArray[np.float64]:
        """Return (..., 3) float64: unit normals of the primitives, on their outer side."""
        return find_normals(self.arrays, points)

    def smooth_normals(self, points: SurfacePoints, normals: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (..., 3) float64: interpolated unit normals, on the sides of `normals`, those of the primitives."""
        return find_smooth_normals(self.arrays, self.shapes, points, self.geometry_ids(points), normals)

    def find_sides(self, points: SurfacePoints, directions: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Return (...) bool: whether each direction, (..., 3) float of any length, leads to the outer side."""
        return find_sides(self.normals(points), directions)

    def offset_points(
        self, points: SurfacePoints, locations: NDArray[np.float64], is_front: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Return (..., 3) float64: start points of rays, next to the locations on the outer side or the inner one."""
        return find_offset_points(self.arrays, self.scene_reach, points, locations, is_front)


def find_parts(
    shapes: Sequence[Shape], prim_id: NDArray[np.int32], geometry_id: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Return (...) int32: the part of each primitive, by its number in its mesh; -1 for none.

    Parameters
    ----------
    shapes : sequence of Mesh or Spheres
        The shape of each geometry.
    prim_id, geometry_id : (...) int32
        Both are -1 for no primitive.
    """
    # Primitives are counted through all shapes, and a shape without parts is a range without a number.
    firsts, begins, numbers = [], [-1], [NO_PRIM]
    first = 0
    for shape in shapes:
        parts = shape.parts if isinstance(shape, Mesh) else ()
        firsts.append(first)
        begins += [first + part.begin for part in parts] or [first]
        numbers += range(len(parts)) if parts else [NO_PRIM]
        first += shape.prim_count
    prims = np.where(prim_id == NO_PRIM, -1, np.array(firsts, np.int64)[geometry_id] + prim_id)
    return np.asarray(np.array(numbers, np.int32)[np.searchsorted(begins, prims, side="right") - 1])


class Normals(np.ndarray):
    """(..., 3) float64: the normals of hits, and a function that returns others; see `Hits.normals`.

    Behaves as a plain array and shows itself as one. Arithmetic, functions of numpy, indices and pickles give plain
    arrays, which cannot be called.

    Examples
    --------
    >>> import clbvh
    >>> ball = clbvh.make_shape("icosphere", triangles=320)
    >>> with clbvh.Tracer(ball) as tracer:
    ...     hits = tracer.closest_hit([[0.1, 0.2, 0], [0.1, 0.2, 5]], [[0, 0, 1], [0, 0, -1]])
    >>> hits.normals.round(2)
    array([[0.09, 0.15, 0.98],
           [0.09, 0.15, 0.98]])
    >>> hits.normals(facing=True).round(2)
    array([[-0.09, -0.15, -0.98],
           [ 0.09,  0.15,  0.98]])
    >>> type(2 * hits.normals), type(hits.normals[0])
    (<class 'numpy.ndarray'>, <class 'numpy.ndarray'>)
    """

    _find: Callable[[NDArray[np.float64], bool, bool], NDArray[np.float64]] | None = None

    @classmethod
    def _of(
        cls, normals: NDArray[np.float64], find: Callable[[NDArray[np.float64], bool, bool], NDArray[np.float64]]
    ) -> Normals:
        """Return an array that calls a function with itself and with the answers to `smooth` and `facing`."""
        callable_normals = normals.view(cls)
        callable_normals._find = find
        return callable_normals

    def __call__(self, *, smooth: bool = False, facing: bool = False) -> NDArray[np.float64]:
        """Return (..., 3) float64: other normals of the same hits, of length 1; NaN on a miss.

        Parameters
        ----------
        smooth : bool, optional
            Normals that change continuously over the faces: those of `Mesh.vertex_normals`, interpolated with u and v,
            and in a scene transformed as normals are. Each is on the side to which the face's own normal points; where
            it would not be, at creases sharper than a right angle or where faces around disagree about their sides, it
            is the face's own. A sphere has the same normals anyway.
        facing : bool, optional
            On the side from which the ray came: turned by `Hits.is_front`. So the product of the ray's direction with a
            normal of `smooth=False` is never above zero. A smooth one keeps to the side of the face, and near a
            silhouette it may still point away from the ray.

        Raises
        ------
        ConfigError
            `facing` for hits that do not know from which side the rays came.
        """
        if self._find is None:
            raise TypeError("only the normals of hits can be called: hits.normals(smooth=..., facing=...)")
        return self._find(np.asarray(self), smooth, facing)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **arguments: Any) -> Any:
        if "out" in arguments:
            arguments["out"] = tuple(_plain(out) for out in arguments["out"])
        return getattr(ufunc, method)(*(_plain(value) for value in inputs), **arguments)

    def __array_function__(self, function: Any, types: Any, arguments: Any, named: Any) -> Any:
        return super().__array_function__(function, types, _all_plain(arguments), _all_plain(named))

    def __getitem__(self, index: Any) -> Any:
        return np.asarray(self)[index]

    def __reduce__(self) -> Any:
        return np.asarray(self).__reduce__()

    def __copy__(self) -> Any:
        return np.array(self)

    def __deepcopy__(self, memo: Any, /) -> Any:
        return np.array(self)

    def __repr__(self) -> str:
        return repr(np.asarray(self))

    def __str__(self) -> str:
        return str(np.asarray(self))


def _plain(value: Any) -> Any:
    return np.asarray(value) if isinstance(value, Normals) else value


def _all_plain(values: Any) -> Any:
    """Return arguments of a function with plain arrays in place of normals, also within lists."""
    if isinstance(values, dict):
        return {name: _all_plain(value) for name, value in values.items()}
    if isinstance(values, list | tuple):
        return type(values)(_all_plain(value) for value in values)
    return _plain(values)
