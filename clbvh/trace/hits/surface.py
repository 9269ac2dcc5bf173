"""The surface that rays have hit: one shape in its place, or the instances of a world.

`Hits` asks its surface where the hits are, which normals they have, and from where rays leave them. A surface knows
shapes and transforms, and nothing of rays and devices.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ...device.host.loops import Loops
from ...errors import QueryError
from ...geometry import Mesh, Shape
from ...structs import NO_PRIM
from ...support.host_threads import HostThreads
from ..world.surface_arrays import SurfaceArrays, SurfacePoints, lone_arrays, make_surface_arrays
from ..world.world import World
from .interpolate import group_by_geometry, interpolate_vertices

# To ask for threads would take longer than fewer points.
_FEW_POINTS = 1 << 10

# The mean of unit vectors is no direction if its square is smaller: they cancel each other.
_LEAST_SQUARE = 2.0**-40

_LOCATIONS, _OFFSETS, _ROOM = Loops("hits/locations"), Loops("hits/offsets"), Loops("hits/room")


@dataclass(frozen=True, eq=False)
class Surface:
    """The surfaces of a world's instances in its coordinates, as they were when the rays were cast.

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
        transforms: NDArray[np.float64] | None,
    ) -> Surface:
        """Return the surfaces of instances; see `make_surface_arrays`."""
        return cls(make_surface_arrays(shapes, geometry_id, transforms), shapes, names)

    @classmethod
    def of_world(cls, world: World) -> Surface:
        """Return the surfaces of a world."""
        return cls(world.arrays, world.state.shapes, world.state.names)

    @classmethod
    def of_mesh(cls, mesh: Mesh) -> Surface:
        """Return the surface of one mesh in the file's coordinates."""
        return cls(lone_arrays(mesh), (mesh,), (mesh.name,))

    @property
    def lone_mesh(self) -> Mesh | None:
        """The mesh that is all there is, where its coordinates say; None of anything else."""
        shape = self.shapes[self.arrays.geometry_id[0]] if self.arrays.is_lone else None
        return shape if isinstance(shape, Mesh) else None

    @cached_property
    def reach(self) -> float:
        """Half the largest side of the box around all instances, in world units."""
        arrays = self.arrays
        if len(arrays.geometry_id) == 0:
            return 0.0
        middles = np.einsum("nij,nj->ni", arrays.linear, arrays.origin[arrays.geometry_id]) + arrays.offset
        halves = np.einsum("nij,nj->ni", np.abs(arrays.linear), arrays.half_size[arrays.geometry_id])
        return float(np.max((middles + halves).max(axis=0) / 2 - (middles - halves).min(axis=0) / 2))

    def list_faces(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return (n,) int64 each: the instance and the number of every face, instance after instance.

        Their corners are those of ``place_points(surface, prims[:, None], np.eye(3), instances[:, None])``.

        Raises
        ------
        QueryError
            There are spheres.
        """
        if not all(isinstance(shape, Mesh) for shape in self.shapes):
            raise QueryError("only meshes have faces: the tracer has spheres")
        counts = np.array([shape.prim_count for shape in self.shapes] or [0])[self.arrays.geometry_id]
        instances = np.repeat(np.arange(len(counts)), counts)
        return instances, np.arange(len(instances)) - np.repeat(np.cumsum(counts) - counts, counts)

    def geometry_ids(self, instance_id: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return (...) int32: the geometry of each instance, -1 for none."""
        geometry_id = self.arrays.geometry_id
        if not geometry_id.any():
            return np.asarray(np.minimum(instance_id, np.int32(0)))
        return np.asarray(np.where(instance_id == NO_PRIM, np.int32(NO_PRIM), geometry_id[instance_id]))

    def part_ids(self, points: SurfacePoints) -> NDArray[np.int32]:
        """Return (...) int32: the part of each primitive, by its number in its mesh; -1 for none."""
        # Primitives are counted through all shapes, and a shape without parts is a range without a number.
        firsts, begins, numbers = [], [-1], [NO_PRIM]
        first = 0
        for shape in self.shapes:
            parts = shape.parts if isinstance(shape, Mesh) else ()
            firsts.append(first)
            begins += [first + part.begin for part in parts] or [first]
            numbers += range(len(parts)) if parts else [NO_PRIM]
            first += shape.prim_count
        own = np.array(firsts or [0], np.int64)[self.geometry_ids(points.instance_id)] + points.prim_id
        prims = np.where(points.prim_id == NO_PRIM, -1, own)
        return np.asarray(np.array(numbers, np.int32)[np.searchsorted(begins, prims, side="right") - 1])

    def locate(self, points: SurfacePoints) -> NDArray[np.float64]:
        """Return (..., 3) float64: where the points are, on a triangle at ``a + (u (b - a) + v (c - a))``."""
        return self._for_points(_locate, points)

    def normals(self, points: SurfacePoints) -> NDArray[np.float64]:
        """Return (..., 3) float64: unit normals of the primitives, on the object's outer side.

        The outer side of a triangle is the one from which its corners run anticlockwise in the object, and that of a
        sphere is its outside. A mirror takes it along. A triangle so thin that float64 does not know its normal has one
        across its longest edge, and one whose corners are one point has NaN.
        """
        return self._for_points(_find_normals, points)

    def turn_normals(self, instance_id: NDArray[np.int32], normals: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (n, 3) float64: unit normals in the world of (n, 3) vectors of about length 1, normal in objects."""
        turned = np.empty(normals.shape)
        _LOCATIONS.turn_normals(
            self.arrays.addresses, np.ascontiguousarray(instance_id), np.ascontiguousarray(normals), turned
        )
        return turned

    def smooth_normals(self, points: SurfacePoints, normals: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (..., 3) float64: interpolated unit normals, on the sides of `normals`, those of the primitives.

        See `Normals.__call__`.
        """
        smooth = normals.reshape(-1, 3).copy()
        prims, instances, us, vs = points.flat()
        for geometry, hits in group_by_geometry(self.geometry_ids(instances)):
            mesh = self.shapes[geometry]
            if not isinstance(mesh, Mesh):
                continue
            blended = interpolate_vertices(mesh.vertex_normals, mesh.faces, prims[hits], us[hits], vs[hits])
            squares = np.einsum("ij,ij->i", blended, blended)
            squares[~(squares > _LEAST_SQUARE)] = np.nan
            blended /= np.sqrt(squares)[:, None]
            blended = self.turn_normals(instances[hits], blended)
            # Written so that NaN is on no side.
            is_kept = np.einsum("ij,ij->i", blended, smooth[hits]) > 0.0
            smooth[hits] = np.where(is_kept[:, None], blended, smooth[hits])
        return smooth.reshape(normals.shape)

    def find_sides(self, points: SurfacePoints, directions: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return (...) bool: whether each direction, (..., 3) of any length, leads to the outer side."""
        shape = points.prim_id.shape
        sides = np.empty(shape, np.bool_)
        self._for_points(_find_sides, points, directions, into=sides.reshape(-1))
        return sides

    def offset_points(self, points: SurfacePoints, is_front: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return (..., 3) float64: start points of rays, next to points on the outer side or the inner one."""
        return self._for_points(_offset, points, np.asarray(is_front, np.bool_), prepare=Surface._find_margins)

    def _find_margins(self, prim_ids: NDArray[np.int32], instance_ids: NDArray[np.int32]) -> None:
        """Find what start points need of the faces that points are on, as far as it is not known."""
        arrays = self.arrays
        hits = np.flatnonzero(prim_ids != NO_PRIM)
        is_one = len(self.shapes) == 1  # then nothing is to be sorted
        groups = ((0, hits),) if is_one else group_by_geometry(self.geometry_ids(instance_ids))
        for geometry, rows in groups:
            mesh, first = self.shapes[geometry], arrays.first_face[geometry]
            if not isinstance(mesh, Mesh):
                continue
            margins, faces = arrays.margins[first : first + mesh.face_count], prim_ids[rows]
            chosen = _find_distinct(faces[margins[faces, 2] == 0.0], mesh.face_count)
            if len(chosen) == 0:
                continue
            find = partial(_find_face_margins, mesh, margins, chosen, _count_walls(mesh, chosen))
            if len(chosen) < _FEW_POINTS:
                find(0, len(chosen))
                continue
            with HostThreads() as threads:
                threads.for_ranges(len(chosen), find)

    def _check_ids(self, prim_ids: NDArray[np.int32], instance_ids: NDArray[np.int32]) -> None:
        """Raise `QueryError` unless a surface has these primitives, (n,), but for those that are none."""
        if len(prim_ids) == 0:
            return
        counts, geometry_id = self._prim_counts, self.arrays.geometry_id
        is_known = instance_ids.max() < len(geometry_id) and min(instance_ids.min(), prim_ids.min()) >= NO_PRIM
        if is_known and (instance_ids.min() < 0 or prim_ids.max() >= counts.min()):
            is_prim = prim_ids != NO_PRIM
            prims, instances = prim_ids[is_prim], instance_ids[is_prim]
            is_known = bool((instances >= 0).all() and (prims < counts[geometry_id[instances]]).all())
        if not is_known:
            raise QueryError("these hits have primitives or instances that their surface does not have")

    @cached_property
    def _prim_counts(self) -> NDArray[np.int64]:
        return np.array([shape.prim_count for shape in self.shapes], np.int64)

    def _for_points(
        self, compute: Callable[..., None], points: SurfacePoints, *more: NDArray[Any],
        into: NDArray[Any] | None = None, prepare: Callable[..., None] | None = None,
    ) -> NDArray[Any]:  # fmt: skip
        """Return what a function of the surface writes for points and more of their data: (..., 3) float64, or `into`.

        Before, `prepare` is called with the surface and all primitives and instances.
        """
        shape = points.prim_id.shape
        vectors = np.empty((*shape, 3)) if into is None else into
        flat = vectors.reshape(-1, 3) if into is None else into
        others = (np.ascontiguousarray(values).reshape(len(flat), *values.shape[len(shape) :]) for values in more)
        inputs: list[NDArray[Any]] = [*points.flat(), *others]
        self._check_ids(*inputs[:2])
        if prepare is not None:
            prepare(self, *inputs[:2])

        def compute_part(begin: int, end: int) -> None:
            compute(self, *(values[begin:end] for values in inputs), flat[begin:end])

        if len(flat) < _FEW_POINTS:
            compute_part(0, len(flat))
            return vectors
        with HostThreads() as threads:
            threads.for_ranges(len(flat), compute_part)
        return vectors


def _locate(surface: Surface, *of_points: NDArray[Any]) -> None:
    _LOCATIONS.locate_points(surface.arrays.addresses, *of_points)


def _find_sides(surface: Surface, *of_points: NDArray[Any]) -> None:
    _LOCATIONS.find_sides(surface.arrays.addresses, *of_points)


def _find_normals(surface: Surface, *of_points: NDArray[Any]) -> None:
    _LOCATIONS.find_normals(surface.arrays.addresses, *of_points)


def _offset(
    surface: Surface,
    prim_ids: NDArray[np.int32],
    instance_ids: NDArray[np.int32],
    us: NDArray[np.float64],
    vs: NDArray[np.float64],
    is_front: NDArray[np.bool_],
    starts: NDArray[np.float64],
) -> None:
    arrays, reach, heights = surface.arrays, surface.reach, np.empty(len(us))
    _OFFSETS.offset_points(arrays.addresses, reach, False, prim_ids, instance_ids, us, vs, is_front, starts, heights)
    crowded = np.flatnonzero(heights)
    if len(crowded) == 0:
        return
    points = prim_ids[crowded], instance_ids[crowded], us[crowded], vs[crowded], is_front[crowded]
    moved, heights = np.empty((len(crowded), 3)), heights[crowded]
    _OFFSETS.offset_points(arrays.addresses, reach, True, *points, moved, heights)
    for geometry, rows in group_by_geometry(surface.geometry_ids(points[1])):
        mesh, first = cast(Mesh, surface.shapes[geometry]), arrays.first_face[geometry]
        _ROOM.make_room(
            *_list_arrays(mesh), arrays.margins[first : first + mesh.face_count], rows,
            np.empty((_count_walls(mesh, points[0][rows]), 3, 3)), points[0], *points[2:], heights,
        )  # fmt: skip
    is_moved = heights > 0.0
    _OFFSETS.offset_points(arrays.addresses, reach, True, *points, moved, heights)
    starts[crowded[is_moved]] = moved[is_moved]


def _find_face_margins(
    mesh: Mesh, margins: NDArray[np.float32], faces: NDArray[np.int32], walls: int, begin: int, end: int
) -> None:
    _ROOM.find_face_margins(*_list_arrays(mesh), margins, faces[begin:end], np.empty((walls, 3, 3)))


def _find_distinct(ids: NDArray[np.int32], count: int) -> NDArray[np.int32]:
    """Return ids, from 0 to count - 1, without repetitions; sorting many takes longer than to mark them."""
    if len(ids) < count >> 4:
        return np.unique(ids)
    is_there = np.zeros(count, np.bool_)
    is_there[ids] = True
    return np.flatnonzero(is_there).astype(np.int32)


def _list_arrays(mesh: Mesh) -> tuple[Any, ...]:
    """Return what cl/host/hits/room.cl is told of a mesh."""
    return mesh.vertices, mesh.faces, mesh.origin, mesh.scale, *mesh.corner_faces


def _count_walls(mesh: Mesh, faces: NDArray[np.int32]) -> int:
    """Return the most faces around the corners of one of some faces."""
    around = mesh.corner_faces
    corners = around.points[mesh.faces[faces]]
    return int((around.begins[corners + 1] - around.begins[corners]).sum(axis=1).max())
