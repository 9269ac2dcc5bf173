"""The arrays of a mesh or of a scene in one value, for the loops that compute in float64 on them.

Owns the concatenation of the geometries' arrays, and the matrices of the instances with their inverses. Must not know
of rays, hits and devices.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...device.host.loops import Loops, pack_struct
from ...errors import SceneError
from ...geometry import Mesh, Shape
from ...geometry.spheres import join_numbers
from ...support.memory import check_memory

INSTANCES = Loops("world/instances")

# Unit roundoffs of float32 and float64; and what stands for the latter where float64 decides: users round normals and
# directions, and those of needles by more.
FLOAT_ROUNDING = 2.0**-24
DOUBLE_ROUNDING = 2.0**-53
FINE_ROUNDING = 2.0**-42


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

    def flat(self) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
        """Return prim_id, instance_id, u and v as contiguous arrays of one axis, in float64."""
        prim_id, instance_id = (np.ascontiguousarray(ids, np.int32).reshape(-1) for ids in self[:2])
        u, v = (np.ascontiguousarray(coordinates, np.float64).reshape(-1) for coordinates in self[2:])
        return prim_id, instance_id, u, v


# Half the largest side of an instance's box lies between these powers of two, or is zero: the limits of `Mesh`.
_LEAST_EXPONENT, _MOST_EXPONENT = -500, 500


class _SurfaceArrays(NamedTuple):
    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    solids: NDArray[np.float64]
    margins: NDArray[np.float32]
    kind: NDArray[np.int32]
    first_vertex: NDArray[np.int64]
    first_face: NDArray[np.int64]
    first_solid: NDArray[np.int64]
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
    rounding: float = FLOAT_ROUNDING


class SurfaceArrays(_SurfaceArrays):
    """What loops need of a scene.

    A hit of instance i is on the geometry ``g = geometry_id[i]``, whose primitive p is row ``first_face[g] + p`` of
    `faces`, or the p-th row of numbers from ``first_solid[g]`` on in `solids`. A point x of the geometry is at
    ``offset[i] + linear[i] @ x`` in the world.

    Attributes
    ----------
    vertices : (V, 3) float64, object units
        The vertices of all meshes, one after the other. The mesh's own array if there is only one.
    faces : (F, 3) int32
        The faces of all meshes. The vertices of a face of the geometry g are the rows
        ``first_vertex[g] + faces[first_face[g] + p]``: the numbers are those of the mesh. Its own array if there is
        only one.
    solids : (n,) float64, object units
        The numbers of all other primitives, row by row, see `Kind.arrays`: of a sphere the centre and the radius.
    margins : (F, 4) float32
        Of the faces: how close to an edge, and to a corner, of a face a start point may have another triangle beside
        it, on the outer side and on the inner one; see cl/host/hits/room.cl, which writes it. 0: not known yet.
    kind : (G,) int32
        The number of each geometry's `Kind`.
    first_vertex, first_face, first_solid : (G,) int64
        Where the geometry's rows begin in `vertices` and `faces`, and its numbers in `solids`; 0 where it has none.
    origin : (G, 3) float64, object units
        The zero of the geometry's local coordinates.
    scale : (G,) float64
        A power of two: the geometry's local units in one object unit.
    half_size : (G, 3) float64, object units
        Half the sides of the geometry's box, of which `origin` is the centre, to a rounding of float32; 0 of a lone
        shape.
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
        Whether this is one shape where its coordinates say: no transform may change a bit of it, not even a zero's
        sign. Its `world_scale` is its `scale`.
    rounding : float
        That of the numbers in which the tracer decides what rays hit: relative to local coordinates and to the size of
        the shape, or, where it is smaller than `FLOAT_ROUNDING`, of the primitive.
    """

    @cached_property
    def addresses(self) -> NDArray[np.uint64]:
        """(20,) uint64: the struct `surfaces_t` of cl/hits/surfaces.cl, for loops; valid as long as this lives."""
        return pack_struct(*self, True)

    def __getstate__(self) -> None:
        """Leave the addresses out of copies."""


_FIRST = np.zeros(1, np.int32)
_IDENTITY = np.eye(3)[None]


def lone_arrays(shape: Shape) -> SurfaceArrays:
    """Return the arrays of one shape that lies where its coordinates say; nothing of a mesh is copied."""
    return make_surface_arrays((shape,), _FIRST, None)


def make_surface_arrays(
    shapes: Sequence[Shape],
    geometry_id: NDArray[np.integer],
    transforms: NDArray[np.float64] | None,
) -> SurfaceArrays:
    """Return the arrays of a scene.

    Parameters
    ----------
    shapes : sequence of Mesh or Spheres
        The shape of each geometry.
    geometry_id : (n,) int
        The geometry of each instance.
    transforms : (n, 4, 4) float64 or None
        The map of each instance from object to world; None for one instance that is where its shape's coordinates say.

    Returns
    -------
    SurfaceArrays
        In a scene of several meshes, 24 bytes for each vertex and 12 for each face are copied; 32
        for each sphere. Start points take 16 bytes for each face.

    Raises
    ------
    SceneError
        An instance is smaller or larger than float64 can compute with, or the copies do not fit the free memory.
    """
    meshes = [shape for shape in shapes if isinstance(shape, Mesh)]
    numbers = [join_numbers(shape) for shape in shapes]
    copied_bytes = sum(own.nbytes for own in numbers if own is not None)
    if len(meshes) > 1:
        copied_bytes += sum(mesh.vertices.nbytes + mesh.faces.nbytes for mesh in meshes)
    check_memory("the arrays of the scene", copied_bytes, SceneError)
    scales = np.array([shape.scale for shape in shapes], np.float64)
    arrays = SurfaceArrays(
        vertices=_join([mesh.vertices for mesh in meshes], np.empty((0, 3))),
        faces=_join([mesh.faces for mesh in meshes], np.empty((0, 3), np.int32)),
        solids=_join([own.ravel() for own in numbers if own is not None], np.empty(0)),
        # Zeros are no memory until they are touched.
        margins=meshes[0].margins if len(meshes) == 1 else np.zeros((sum(mesh.face_count for mesh in meshes), 4), "f4"),
        kind=np.array([shape.kind.number for shape in shapes], np.int32),
        first_vertex=_first_rows([len(shape.vertices) if isinstance(shape, Mesh) else 0 for shape in shapes]),
        first_face=_first_rows([len(shape.faces) if isinstance(shape, Mesh) else 0 for shape in shapes]),
        first_solid=_first_rows([0 if own is None else own.size for own in numbers]),
        origin=np.array([shape.origin for shape in shapes], np.float64).reshape(-1, 3),
        scale=scales,
        half_size=np.zeros((len(shapes), 3)) if transforms is None else _half_sizes(shapes, scales),
        geometry_id=np.ascontiguousarray(geometry_id, np.int32),
        linear=_IDENTITY,
        offset=np.zeros((1, 3)),
        inverse=_IDENTITY,
        world_scale=np.array([shapes[geometry].scale for geometry in geometry_id[:1]]),
        is_mirrored=np.zeros(1, np.bool_),
        is_lone=transforms is None,
        rounding=FINE_ROUNDING if any(shape.spans_scales for shape in shapes) else FLOAT_ROUNDING,
    )
    return arrays if transforms is None else move_instances(arrays, transforms)


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
    linear = np.ascontiguousarray(transforms[:, :3, :3], np.float64)
    with np.errstate(over="ignore"):
        x, y, z = np.einsum("nij,nj->ni", np.abs(linear), arrays.half_size[arrays.geometry_id]).T
    sizes = np.maximum(np.maximum(x, y), z)
    is_right = (sizes == 0) | ((sizes >= 2.0 ** (_LEAST_EXPONENT - 1)) & (sizes < 2.0**_MOST_EXPONENT))
    if not is_right.all():
        raise SceneError(
            f"instance {np.argmin(is_right)} is smaller than {2.0**_LEAST_EXPONENT:.0e} or larger than "
            f"{2.0**_MOST_EXPONENT:.0e} units, with which float64 has no room to compute: give its transform another "
            "scale"
        )
    moved = arrays._replace(
        linear=linear,
        offset=np.ascontiguousarray(transforms[:, :3, 3], np.float64),
        inverse=np.empty(linear.shape),
        world_scale=np.ldexp(1.0, -np.frexp(sizes)[1]),
        is_mirrored=np.empty(len(linear), np.bool_),
        is_lone=False,
    )
    INSTANCES.invert(linear, moved.inverse, moved.is_mirrored)
    return moved


def _half_sizes(shapes: Sequence[Shape], scales: NDArray[np.float64]) -> NDArray[np.float64]:
    # Local coordinates are in memory, and a rounding of float32 does not matter.
    boxes = np.array([shape.local_box for shape in shapes]).reshape(-1, 2, 3)
    return np.abs(boxes).max(axis=1).astype(np.float64) / scales[:, None]


def _join(parts: list[NDArray], nothing: NDArray) -> NDArray:
    """Return the rows of all parts, without a copy if there is only one."""
    if len(parts) == 1:
        return np.ascontiguousarray(parts[0])
    return np.concatenate(parts) if parts else nothing


def _first_rows(counts: list[int]) -> NDArray[np.int64]:
    """Return the sums of the counts before each one, 0 where the count is."""
    row_counts = np.array(counts, np.int64)
    return np.where(row_counts > 0, np.cumsum(row_counts) - row_counts, 0)
