"""The arrays of a mesh or of a scene in one value, for the compiled functions that compute in float64 on them.

Owns the concatenation of the geometries' arrays, and the matrices of the instances with their inverses. Must not know
of rays, hits and devices.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError
from ...geometry import Mesh, Shape
from ...structs import PRIM_KINDS
from ...support.compiled import compiled
from ...support.loop_functions import exponent_of, power_of_two, times_power_of_two
from ...support.memory import check_memory


class Triangles(NamedTuple):
    """What compiled functions need of a mesh.

    Attributes
    ----------
    vertices : (V, 3) float64, the file's coordinates
    faces : (F, 3) int32
    scale : float
        A power of two: local units in one unit of the file. Lengths are scaled by it before they are multiplied with
        each other, so that no product leaves float64.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    scale: float


def triangles_of(mesh: Mesh) -> Triangles:
    """Return the arrays of a mesh."""
    return Triangles(mesh.vertices, mesh.faces, mesh.scale)


class SurfacePoints(NamedTuple):
    """Points on the primitives of a surface.

    Attributes
    ----------
    prim_id : (...) int32
        The primitive, by its number in its geometry; -1 for none.
    instance_id : (...) int32
        The instance, -1 for none.
    u, v : (...) float
        The coordinates on the primitive; see `Hits`.
    """

    prim_id: NDArray[np.int32]
    instance_id: NDArray[np.int32]
    u: NDArray[np.floating]
    v: NDArray[np.floating]


# Half the largest side of an instance's box lies between these powers of two, or is zero: the limits of `Mesh`.
_LEAST_EXPONENT, _MOST_EXPONENT = -500, 500

_TRIANGLES, _SPHERES = PRIM_KINDS["triangles"], PRIM_KINDS["spheres"]


class SurfaceArrays(NamedTuple):
    """What compiled functions need of a scene.

    A hit of instance i is on the geometry ``g = geometry_id[i]``, whose primitive p is row ``first_face[g] + p`` of
    `faces`, or row ``first_sphere[g] + p`` of `spheres`. A point x of the geometry is at ``offset[i] + linear[i] @ x``
    in the world; see `place_point`.

    Attributes
    ----------
    vertices : (V, 3) float64, object units
        The vertices of all meshes, one after the other. The mesh's own array if there is only one.
    faces : (F, 3) int32
        The faces of all meshes. The vertices of a face of the geometry g are the rows
        ``first_vertex[g] + faces[first_face[g] + p]``: the numbers are those of the mesh. Its own array if there is
        only one.
    spheres : (n, 4) float64, object units
        The centre and the radius of all spheres of all geometries.
    kind : (G,) int32
        One of `structs.PRIM_KINDS` of each geometry.
    first_vertex, first_face, first_sphere : (G,) int64
        Where the geometry's rows begin in `vertices`, `faces` and `spheres`; 0 where it has none.
    origin : (G, 3) float64, object units
        The zero of the geometry's local coordinates.
    scale : (G,) float64
        A power of two: the geometry's local units in one object unit.
    half_size : (G, 3) float64, object units
        Half the sides of the geometry's box, of which `origin` is the centre, to a rounding of float32.
    geometry_id : (n,) int32
        The geometry of each instance.
    linear : (n, 3, 3) float64
        The linear part of the map from object to world, by rows.
    offset : (n, 3) float64, world units
        The translation of the map from object to world.
    inverse : (n, 3, 3) float64
        The inverse of `linear`: a direction d of the world is ``inverse @ d`` in the object, and a normal m of the
        object has the direction ``inverse.T @ m`` in the world.
    world_scale : (n,) float64
        A power of two that brings half the largest side of the instance's box to a length from 1/2 to 1. Lengths in the
        world are scaled by it before they are multiplied with each other, so that no product leaves float64.
    is_mirrored : (n,) bool
        Whether the map turns right hands into left ones. Corners a, b, c that run anticlockwise, seen from the outer
        side of the object, run clockwise in the world, and the outer side is still that of the normal.
    is_lone : bool
        Whether this is one mesh where its coordinates say: no transform may change a bit of it, not even a zero's sign.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    spheres: NDArray[np.float64]
    kind: NDArray[np.int32]
    first_vertex: NDArray[np.int64]
    first_face: NDArray[np.int64]
    first_sphere: NDArray[np.int64]
    origin: NDArray[np.float64]
    scale: NDArray[np.float64]
    half_size: NDArray[np.float64]
    geometry_id: NDArray[np.int32]
    linear: NDArray[np.float64]
    offset: NDArray[np.float64]
    inverse: NDArray[np.float64]
    world_scale: NDArray[np.float64]
    is_mirrored: NDArray[np.bool_]
    is_lone: bool = False


_ZERO_ROW = np.zeros(1, np.int64)

# The lone mesh; its own arrays are missing.
_LONE = SurfaceArrays(
    np.empty((0, 3)), np.empty((0, 3), np.int32), np.empty((0, 4)), np.array([_TRIANGLES], np.int32),
    _ZERO_ROW, _ZERO_ROW, _ZERO_ROW, np.zeros((1, 3)), np.ones(1), np.zeros((1, 3)),
    np.zeros(1, np.int32), np.eye(3)[None], np.zeros((1, 3)), np.eye(3)[None], np.ones(1), np.zeros(1, np.bool_), True,
)  # fmt: skip


def lone_arrays(mesh: Mesh) -> SurfaceArrays:
    """Return the arrays of a mesh that lies where its coordinates say; nothing is copied."""
    return _LONE._replace(
        vertices=mesh.vertices, faces=mesh.faces, origin=np.array([mesh.origin]), scale=np.array([mesh.scale])
    )


def make_surface_arrays(
    shapes: Sequence[Shape], geometry_id: NDArray[np.integer], transforms: NDArray[np.float64]
) -> SurfaceArrays:
    """Return the arrays of a scene.

    Parameters
    ----------
    shapes : sequence of Mesh or Spheres
        The shape of each geometry.
    geometry_id : (n,) int
        The geometry of each instance.
    transforms : (n, 4, 4) float64
        The map of each instance from object to world.

    Returns
    -------
    SurfaceArrays
        In a scene of several meshes, 24 bytes for each vertex and 12 for each face are copied; 32
        for each sphere.

    Raises
    ------
    SceneError
        An instance is smaller or larger than float64 can compute with, or the copies do not fit the free memory.
    """
    meshes = [shape for shape in shapes if isinstance(shape, Mesh)]
    spheres = [shape for shape in shapes if not isinstance(shape, Mesh)]
    copied_bytes = 32 * sum(len(shape.radii) for shape in spheres)
    if len(meshes) > 1:
        copied_bytes += sum(mesh.vertices.nbytes + mesh.faces.nbytes for mesh in meshes)
    check_memory("the arrays of the scene", copied_bytes, SceneError)
    no_instances = _frames_of(shapes, geometry_id)._replace(
        vertices=_join([mesh.vertices for mesh in meshes], np.empty((0, 3))),
        faces=_join([mesh.faces for mesh in meshes], np.empty((0, 3), np.int32)),
        spheres=_join([np.column_stack((shape.centres, shape.radii)) for shape in spheres], np.empty((0, 4))),
        first_vertex=_first_rows([len(shape.vertices) if isinstance(shape, Mesh) else 0 for shape in shapes]),
        first_face=_first_rows([len(shape.faces) if isinstance(shape, Mesh) else 0 for shape in shapes]),
        first_sphere=_first_rows([0 if isinstance(shape, Mesh) else len(shape.radii) for shape in shapes]),
    )
    return move_instances(no_instances, transforms)


def _frames_of(shapes: Sequence[Shape], geometry_id: NDArray[np.integer]) -> SurfaceArrays:
    """Return the boxes of geometries, without their primitives and without instances."""
    empty, no_rows = np.empty(0), np.zeros(len(shapes), np.int64)
    return SurfaceArrays(
        empty.reshape(0, 3), np.empty((0, 3), np.int32), empty.reshape(0, 4),
        np.array([_TRIANGLES if isinstance(shape, Mesh) else _SPHERES for shape in shapes], np.int32),
        no_rows, no_rows, no_rows,
        np.array([shape.origin for shape in shapes], np.float64).reshape(-1, 3),
        np.array([shape.scale for shape in shapes], np.float64),
        np.array([_half_size(shape) for shape in shapes]).reshape(-1, 3),
        np.ascontiguousarray(geometry_id, np.int32),
        empty.reshape(0, 3, 3), empty.reshape(0, 3), empty.reshape(0, 3, 3), empty, np.empty(0, np.bool_),
    )  # fmt: skip


def move_instances(arrays: SurfaceArrays, transforms: NDArray[np.float64]) -> SurfaceArrays:
    """Return the arrays of a scene whose instances have other transforms; those of the geometries are shared.

    Parameters
    ----------
    arrays : SurfaceArrays
    transforms : (n, 4, 4) float64
        The map of each instance from object to world.

    Raises
    ------
    SceneError
        See `make_surface_arrays`.
    """
    count = len(transforms)
    moved = arrays._replace(
        linear=np.empty((count, 3, 3)),
        offset=np.empty((count, 3)),
        inverse=np.empty((count, 3, 3)),
        world_scale=np.empty(count),
        is_mirrored=np.empty(count, np.bool_),
    )
    wrong = _place_instances(np.ascontiguousarray(transforms, np.float64), moved, np.empty((3, 3)), np.empty((3, 3)))
    if wrong >= 0:
        raise SceneError(
            f"instance {wrong} is smaller than {2.0**_LEAST_EXPONENT:.0e} or larger than {2.0**_MOST_EXPONENT:.0e} "
            "units, with which float64 has no room to compute: give its transform another scale"
        )
    return moved


def _half_size(shape: Shape) -> NDArray[np.float64]:
    """Return (3,) float64: half the sides of the shape's box."""
    # Local coordinates are in memory, and a rounding of float32 does not matter.
    return np.abs(shape.local_box).max(axis=0).astype(np.float64) / shape.scale


def _join(parts: list[NDArray], nothing: NDArray) -> NDArray:
    """Return the rows of all parts, without a copy if there is only one."""
    if len(parts) == 1:
        return np.ascontiguousarray(parts[0])
    return np.concatenate(parts) if parts else nothing


def _first_rows(counts: list[int]) -> NDArray[np.int64]:
    """Return the sums of the counts before each one, 0 where the count is."""
    row_counts = np.array(counts, np.int64)
    return np.where(row_counts > 0, np.cumsum(row_counts) - row_counts, 0)


@compiled
def place_point(arrays, instance, x, y, z):
    """Return the world coordinates of a point of an instance's geometry; those of the object for the identity."""
    linear, offset = arrays.linear, arrays.offset
    return (
        linear[instance, 0, 0] * x + linear[instance, 0, 1] * y + linear[instance, 0, 2] * z + offset[instance, 0],
        linear[instance, 1, 0] * x + linear[instance, 1, 1] * y + linear[instance, 1, 2] * z + offset[instance, 1],
        linear[instance, 2, 0] * x + linear[instance, 2, 1] * y + linear[instance, 2, 2] * z + offset[instance, 2],
    )


@compiled
def place_vector(arrays, instance, x, y, z):
    """Return the difference of two points of an instance's geometry in world coordinates."""
    linear = arrays.linear
    return (
        linear[instance, 0, 0] * x + linear[instance, 0, 1] * y + linear[instance, 0, 2] * z,
        linear[instance, 1, 0] * x + linear[instance, 1, 1] * y + linear[instance, 1, 2] * z,
        linear[instance, 2, 0] * x + linear[instance, 2, 1] * y + linear[instance, 2, 2] * z,
    )


@compiled
def to_object(arrays, instance, x, y, z):
    """Return a vector of the world in the coordinates of an instance's geometry."""
    return to_object_by(arrays.inverse, instance, x, y, z)


@compiled
def to_object_by(inverse, instance, x, y, z):
    """Return the same, given the inverse matrices alone: for loops over hits, which look them up once."""
    return (
        inverse[instance, 0, 0] * x + inverse[instance, 0, 1] * y + inverse[instance, 0, 2] * z,
        inverse[instance, 1, 0] * x + inverse[instance, 1, 1] * y + inverse[instance, 1, 2] * z,
        inverse[instance, 2, 0] * x + inverse[instance, 2, 1] * y + inverse[instance, 2, 2] * z,
    )


@compiled(error_model="numpy")
def _place_instances(transforms, arrays, balanced, inverse):
    """Write the arrays of all instances; return the first one whose size float64 cannot compute with, or -1."""
    linear = arrays.linear
    for instance in range(len(transforms)):
        largest = 0.0
        for row in range(3):
            extent = 0.0
            for column in range(3):
                linear[instance, row, column] = transforms[instance, row, column]
                extent += abs(linear[instance, row, column]) * arrays.half_size[arrays.geometry_id[instance], column]
            arrays.offset[instance, row] = transforms[instance, row, 3]
            largest = max(largest, extent)
        exponent = exponent_of(largest) + 1
        if largest == 0.0:
            exponent = 0
        elif not _LEAST_EXPONENT <= exponent <= _MOST_EXPONENT:
            return instance
        arrays.world_scale[instance] = power_of_two(-exponent)
        arrays.is_mirrored[instance] = _invert(linear, instance, arrays.inverse, balanced, inverse)
    return -1


@compiled(error_model="numpy")
def _invert(linear, instance, inverses, balanced, inverse):
    """Write the inverse of one matrix, and return whether its determinant is below zero.

    Rows and columns are scaled by powers of two first, which rounds nothing: then the products of a matrix that
    stretches its axes by factors far apart neither underflow nor drown each other. One step of Newton's method removes
    most of what the cofactors lose by cancellation.
    """
    row_exponents = (
        _row_exponent(linear, instance, 0), _row_exponent(linear, instance, 1), _row_exponent(linear, instance, 2)
    )  # fmt: skip
    for row in range(3):
        for column in range(3):
            balanced[row, column] = times_power_of_two(linear[instance, row, column], -row_exponents[row])
    column_exponents = (
        _column_exponent(balanced, 0), _column_exponent(balanced, 1), _column_exponent(balanced, 2)
    )  # fmt: skip
    for row in range(3):
        for column in range(3):
            balanced[row, column] = times_power_of_two(balanced[row, column], -column_exponents[column])
    determinant = 0.0
    for row in range(3):
        for column in range(3):
            # The indices are cyclic, so the cofactors have no signs of their own.
            next_row, last_row = (row + 1) % 3, (row + 2) % 3
            next_column, last_column = (column + 1) % 3, (column + 2) % 3
            inverse[column, row] = (
                balanced[next_row, next_column] * balanced[last_row, last_column]
                - balanced[next_row, last_column] * balanced[last_row, next_column]
            )
    for column in range(3):
        determinant += balanced[0, column] * inverse[column, 0]
    for row in range(3):
        for column in range(3):
            inverse[row, column] /= determinant
    for row in range(3):
        for column in range(3):
            inverses[instance, row, column] = inverse[row, column]
            for inner in range(3):
                # The residual: the identity less the product of the matrix and its inverse.
                residual = 1.0 if inner == column else 0.0
                for index in range(3):
                    residual -= balanced[inner, index] * inverse[index, column]
                inverses[instance, row, column] += inverse[row, inner] * residual
    for row in range(3):
        for column in range(3):
            exponent = -column_exponents[row] - row_exponents[column]
            inverses[instance, row, column] = times_power_of_two(inverses[instance, row, column], exponent)
    return determinant < 0.0


@compiled
def _row_exponent(linear, instance, row):
    largest = 0.0
    for column in range(3):
        largest = max(largest, abs(linear[instance, row, column]))
    return exponent_of(largest)


@compiled
def _column_exponent(balanced, column):
    largest = 0.0
    for row in range(3):
        largest = max(largest, abs(balanced[row, column]))
    return exponent_of(largest)
