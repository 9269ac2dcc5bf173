"""The results of ray queries."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import ConfigError, QueryError
from ...geometry import Mesh
from ...structs import NO_PRIM
from ..rays.batch import broadcast_shape, check_room, read_vectors
from ..world.surface_arrays import SurfacePoints
from .interpolate import interpolate
from .normals import Normals
from .surface import Surface

# A start point, and one on each side of the triangle.
_POINT_BYTES = 3 * 24


@dataclass(frozen=True, eq=False)
class Hits:
    """One hit per ray, at ``(1 - u - v) a + u b + v c`` of the triangle with the corners a, b and c.

    On a sphere, u is the azimuth about the object's z axis in turns, from the x axis towards the y axis, and v is the
    angle from the z axis in half turns.

    Every array has the leading shape of the rays; for a single ray, (3,), that is ``()``. Indexing by anything that
    indexes this shape gives the hits of some rays: ``hits[hits.is_hit]`` are those that hit.

    Attributes
    ----------
    t : (...,) float64, or float32 in a picture, lengths of the ray's direction
        Distance from the ray's origin; infinite on a miss.
    u, v : (...,) of the same dtype
        Barycentric coordinates, or those of a sphere; 0 on a miss.
    prim_id : (...,) int32
        Face of the mesh, or sphere, by its number in its geometry; -1 on a miss.
    mesh : Mesh or None
        The mesh that was hit; None in a scene of spheres, of several instances, or of one that has a transform.
    is_front : (...,) bool or None
        Whether the ray came from the side to which `normals` point; false on a miss. None where it is not known.
    surface : Surface or None
        What was hit, a mesh or the instances of a scene; None where it is not known.
    known_instance_id : (...,) int32 or None
        `instance_id`, if it was computed along with the hits; None if all are on the first instance.

    Examples
    --------
    >>> import clbvh
    >>> mesh = clbvh.Mesh.from_arrays([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
    >>> with clbvh.Tracer(mesh) as tracer:
    ...     hits = tracer.closest_hit([[1, 2, 5], [3, 3, 5]], [[0, 0, -1], [0, 0, -1]])
    >>> hits
    Hits(shape=(2,), hits=1, t=5..5)
      [0] t=5, prim_id=0, location=(1, 2, 0)
    >>> hits[0], hits[1]
    (Hits(t=5, prim_id=0, location=(1, 2, 0)), Hits(miss))
    >>> hits.is_hit, hits.t, hits.prim_id
    (array([ True, False]), array([ 5., inf]), array([ 0, -1], dtype=int32))
    >>> hits.u, hits.v
    (array([0.25, 0.  ]), array([0.5, 0. ]))
    >>> hits.locations
    array([[ 1.,  2.,  0.],
           [nan, nan, nan]])
    >>> hits.normals
    array([[ 0.,  0.,  1.],
           [nan, nan, nan]])

    Visible points that the light reaches:

    >>> import numpy as np
    >>> mesh = clbvh.make_shape("knot", triangles=2000)
    >>> light = np.array([0.0, 0.0, 9.0])
    >>> with clbvh.Tracer(clbvh.build(mesh)) as tracer:
    ...     hits = tracer.closest_hit([0, 0, 5], np.random.default_rng(0).normal(size=(64, 48, 3)) - [0, 0, 5])
    ...     seen = hits[hits.is_hit]
    ...     in_light = ~tracer.any_hit(seen.offset_origins(), light - seen.locations, t_max=1.0)
    >>> bool(in_light.any()), bool(in_light.all())
    (True, False)
    """

    t: NDArray[np.floating]
    u: NDArray[np.floating]
    v: NDArray[np.floating]
    prim_id: NDArray[np.int32]
    mesh: Mesh | None = None
    is_front: NDArray[np.bool_] | None = field(default=None, kw_only=True)
    surface: Surface | None = field(default=None, kw_only=True)
    known_instance_id: NDArray[np.int32] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        # Each follows from the other one.
        if self.surface is not None:
            object.__setattr__(self, "mesh", self.surface.lone_mesh)
        elif self.mesh is not None:
            object.__setattr__(self, "surface", Surface.of_mesh(self.mesh))

    @property
    def shape(self) -> tuple[int, ...]:
        """Leading shape of the rays."""
        return self.prim_id.shape

    @property
    def is_hit(self) -> NDArray[np.bool_]:
        """(...,) bool: whether the ray hits anything."""
        return self.prim_id != NO_PRIM

    @property
    def count(self) -> int:
        """Number of rays that hit something."""
        return int(np.count_nonzero(self.is_hit))

    @property
    def instance_id(self) -> NDArray[np.int32]:
        """(...,) int32: the instance that was hit; 0 for every hit of a mesh, -1 on a miss."""
        if self.known_instance_id is not None:
            return self.known_instance_id
        return np.asarray(np.minimum(self.prim_id, np.int32(0)))

    @property
    def geometry_id(self) -> NDArray[np.int32]:
        """(...,) int32: the geometry that was hit; 0 for every hit of a mesh, -1 on a miss."""
        return self.instance_id if self.surface is None else self.surface.geometry_ids(self.instance_id)

    @property
    def part_id(self) -> NDArray[np.int32]:
        """(...,) int32: the part that was hit, an index into `Mesh.parts` of the geometry's mesh.

        -1 on a miss, on a mesh without parts and on spheres.

        Raises
        ------
        ConfigError
            These hits do not know their mesh.

        Examples
        --------
        >>> import clbvh
        >>> corners = [[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]]
        >>> halves = [clbvh.Part("lower", 0, 1), clbvh.Part("upper", 1, 2)]
        >>> square = clbvh.Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3]], parts=halves)
        >>> with clbvh.Tracer(square) as tracer:
        ...     hits = tracer.closest_hit([[1, 3, 5], [3, 1, 5], [9, 9, 5]], [[0, 0, -1]])
        >>> hits.part_id
        array([ 1,  0, -1], dtype=int32)
        >>> square.parts[hits.part_id[0]].name
        'upper'
        """
        return self._known_surface().part_ids(self._points())

    @property
    def locations(self) -> NDArray[np.float64]:
        """(..., 3) float64, the file's coordinates, or the world's: where the primitive is hit; NaN on a miss."""
        return self._known_surface().locate(self._points())

    @property
    def normals(self) -> Normals:
        """(..., 3) float64: the normal of length 1, on the side from which a, b, c run anticlockwise.

        NaN on a miss. The ray may come from either side, see `is_front`. A triangle thinner than about 2^-31 of its
        length has no reliable normal even in float64, and gets a vector across its longest edge.

        Normals of instances are perpendicular to the transformed surface, and on the object's outer side: that from
        which a, b, c run anticlockwise in the object, or the outside of a sphere. A mirror takes that side along, so
        the normals of a mirrored closed object still point outwards.

        The array can be called for other normals of the same hits: ``hits.normals(smooth=True)`` interpolates those of
        the vertices, ``hits.normals(facing=True)`` turns them to the side from which the ray came, and both together do
        both; see `Normals`.

        Examples
        --------
        >>> import clbvh
        >>> ball = clbvh.make_shape("icosphere", triangles=320)
        >>> with clbvh.Tracer(ball) as tracer:
        ...     hits = tracer.closest_hit([0, 0, 0], [0.6, 0.48, 0.64])
        >>> hits.normals.round(2)
        array([0.55, 0.45, 0.7 ])
        >>> hits.normals(smooth=True).round(2)
        array([0.6 , 0.48, 0.64])
        >>> hits.normals(smooth=True, facing=True).round(2)
        array([-0.6 , -0.48, -0.64])
        """
        return Normals._of(self._known_surface().normals(self._points()), self._find_normals)

    def interpolate(self, attribute: ArrayLike | Mapping[Any, ArrayLike]) -> NDArray[np.float64]:
        """Return the values of an attribute where the rays hit: colours, texture coordinates, temperatures.

        Parameters
        ----------
        attribute : (V,) or (V, k...) array of real numbers, or a mapping
            A value or a row of any shape for each vertex of the mesh, which u and v interpolate; of spheres, for each
            sphere, whose value holds for all of its surface. For a scene of several geometries: a mapping from
            geometries to their arrays, ``{car: colours, "ground": more_colours}``. A geometry is given by its handle,
            its name or its id. All rows have the same shape.

        Returns
        -------
        (...,) or (..., k...) float64
            NaN on a miss, and on a geometry that the mapping leaves out. A vertex with the value NaN makes its faces
            NaN.

        Raises
        ------
        QueryError
            Values that are not numbers, another number of them than vertices or spheres, a geometry that the scene does
            not have, an array for a scene of several geometries, rows of different shapes, or a result that does not
            fit the free memory.
        ConfigError
            These hits do not know their mesh.

        Examples
        --------
        >>> import clbvh
        >>> mesh = clbvh.Mesh.from_arrays([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
        >>> with clbvh.Tracer(mesh) as tracer:
        ...     hits = tracer.closest_hit([[1, 2, 5], [3, 3, 5]], [[0, 0, -1], [0, 0, -1]])
        >>> hits.interpolate([10, 20, 30])
        array([22.5,  nan])
        >>> hits[0].interpolate([[1, 0, 0], [0, 1, 0], [0, 0, 1]])
        array([0.25, 0.25, 0.5 ])
        """
        surface = self._known_surface()
        return interpolate(surface.shapes, surface.names, attribute, self._points(), self.geometry_id)

    def offset_origins(self, *, towards: ArrayLike | None = None) -> NDArray[np.float64]:
        """Return start points for rays that leave the surface: just above it, where they cannot meet it by rounding.

        Parameters
        ----------
        towards : (..., 3) float, optional
            Directions of the rays that will be cast, of any length above 0; their leading shape broadcasts against that
            of the hits. Each start point is on the side of the triangle to which its direction leads: for rays through
            the surface, such as refracted ones, or for those whose side is not known. Without it, all start points are
            on the side from which the ray came: for shadow rays, reflections and ambient occlusion. A ray from there to
            a light behind the triangle is blocked by the triangle, as it should be.

        Returns
        -------
        (..., 3) float64, the file's coordinates
            NaN on a miss, which no query takes: select the hits first, as in the example.

        Raises
        ------
        ConfigError
            These hits do not know their mesh or, without `towards`, the side from which the rays came.
        QueryError
            `towards` has a shape that does not broadcast or, for a hit, a direction that is not finite or has length
            zero.

        Notes
        -----
        A ray from there into the half space above the triangle, or along its plane, meets neither that triangle nor any
        other one below the plane: of a convex mesh, none at all. The half space is that of `normals`, on the side
        chosen. The distance is derived from the roundings on the way, and is at most 1e-5 of the largest side of the
        mesh's box; there is no constant to choose. A neighbouring triangle that rises above the plane, as at a concave
        edge, is met, however near it is: beside an acute edge of one degree and more, or in such a corner, the start
        point is moved along its triangle to where there is room, by up to 0.4 % of the largest side.

        What that needs of a face is found when it is first left, in about 1 us, and of the mesh once, in 0.1 s for a
        million faces; 16 bytes for each face, and 16 for its corners.

        Examples
        --------
        >>> import clbvh
        >>> mesh = clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
        >>> with clbvh.Tracer(clbvh.build(mesh)) as tracer:
        ...     hits = tracer.closest_hit([0.25, 0.25, 1], [0, 0, -1])
        ...     above, below = hits.offset_origins(), hits.offset_origins(towards=[0, 0, -1])
        ...     print(tracer.any_hit(above, [0, 0, 1]), tracer.any_hit(above, [0, 0, -1]))
        ...     print(tracer.any_hit(below, [0, 0, -1]), 0 < above[2] < 1e-5, below[2] == -above[2])
        False True
        False True True
        """
        hit, points = self._known_surface(), self._points()
        if towards is None:
            if self.is_front is None:
                raise ConfigError(
                    "these hits do not know from which side the rays came: call offset_origins(towards=directions)"
                )
            return hit.offset_points(points, self.is_front)
        directions = read_vectors(towards, "towards")
        try:
            shape = broadcast_shape(self.shape, directions.shape[:-1])
        except ValueError:
            raise QueryError(
                f"towards must have a shape that broadcasts against that of the hits, {self.shape}, and 3 coordinates, "
                f"not {directions.shape}"
            ) from None
        check_room(math.prod(shape), _POINT_BYTES)
        self._refuse_wrong(directions, shape)
        if shape == self.shape:
            directions = np.broadcast_to(directions, (*shape, 3))
            return hit.offset_points(points, hit.find_sides(points, directions))
        every = SurfacePoints(*(np.broadcast_to(values, shape) for values in points))
        sides = hit.find_sides(every, np.broadcast_to(directions, (*shape, 3)))
        front = hit.offset_points(points, np.ones(self.shape, np.bool_))
        back = hit.offset_points(points, np.zeros(self.shape, np.bool_))
        return np.where(sides[..., None], front, back)

    def take(self, rays: NDArray[np.int64] | int) -> Hits:
        """Return the hits of some rays, by their numbers in C order.

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> with clbvh.Tracer(trimesh.creation.box()) as tracer:
        ...     hits = tracer.closest_hit([[3, 0, 5], [0.1, 0.2, 5]], [[0, 0, -1], [0, 0, -1]])
        >>> hits.take(hits.is_hit.nonzero()[0]).t
        array([4.5])
        """
        return self._map(lambda values: values.reshape(-1)[rays])

    def to_dict(self) -> dict[str, NDArray[Any]]:
        """Return arrays of one axis by name, ray after ray in C order: `pandas.DataFrame` makes a table of them.

        Returns
        -------
        dict of str to array
            t, u, v, prim_id, instance_id and geometry_id; is_front, and x, y and z of `locations`, where they are
            known; of `AllHits` also ray_id.

        Examples
        --------
        >>> import clbvh
        >>> mesh = clbvh.Mesh.from_arrays([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
        >>> with clbvh.Tracer(mesh) as tracer:
        ...     table = tracer.closest_hit([[1, 2, 5], [3, 3, 5]], [0, 0, -1]).to_dict()
        >>> list(table)
        ['t', 'u', 'v', 'prim_id', 'instance_id', 'geometry_id', 'is_front', 'x', 'y', 'z']
        >>> table["t"], table["y"]
        (array([ 5., inf]), array([ 2., nan]))
        """
        table = {name: getattr(self, name) for name in ("t", "u", "v", "prim_id", "instance_id", "geometry_id")}
        if self.is_front is not None:
            table["is_front"] = self.is_front
        if self.surface is not None:
            table |= zip("xyz", np.moveaxis(self.locations, -1, 0), strict=True)
        return {name: np.ravel(values) for name, values in table.items()}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the points that were hit to a file for programs of point clouds: completely or not at all.

        Parameters
        ----------
        path : str or path
            ``.ply`` (binary), or ``.las`` or ``.laz``, which need laspy and round coordinates to 2^-30 of the largest
            side of their box. Each point has x, y and z in float64; the normal nx, ny, nz on the side from which the
            ray came, where that is known; t, the distance for directions of length 1; the number of its ray in C order,
            ray_id; prim_id; and in a scene instance_id.

        Raises
        ------
        ConfigError
            Another suffix, laspy is missing, a file that cannot be written, or hits that do not know their mesh.

        Examples
        --------
        >>> import clbvh
        >>> import tempfile
        >>> import trimesh
        >>> from pathlib import Path
        >>> camera = clbvh.Camera(eye=(0, 0, 5), look_at=(0, 0, 0))
        >>> with clbvh.Tracer(clbvh.make_shape("icosphere", triangles=320)) as tracer:
        ...     scan = tracer.closest_hit(*camera.rays(64, 48))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     scan.save(Path(folder, "scan.ply"))
        ...     trimesh.load(Path(folder, "scan.ply")).vertices.shape
        (736, 3)
        """
        from ...geometry.write_points import write_points  # few hits are saved

        surface, is_lone = self._known_surface(), self.known_instance_id is None
        rays = np.flatnonzero(self.is_hit)
        hits = self.take(rays)
        normals: NDArray[np.float64] = hits.normals
        columns = dict(zip("xyz", hits.locations.T, strict=True))
        if self.is_front is not None:
            normals = np.where(hits.is_front[:, None], normals, -normals)  # type: ignore[index]
        columns |= zip(("nx", "ny", "nz"), normals.T.astype(np.float32), strict=True)
        columns |= {"t": hits.t.astype(np.float64), "ray_id": self._ray_ids(rays), "prim_id": hits.prim_id}
        if not (is_lone or surface.arrays.is_lone):
            columns["instance_id"] = hits.instance_id
        write_points(path, columns)

    def _ray_ids(self, hits: NDArray[np.int64]) -> NDArray[np.int32]:
        """Return the numbers of the rays of some hits."""
        return hits.astype(np.int32)

    def __getitem__(self, index: Any) -> Hits:
        return self._map(lambda values: np.asarray(values[index]))

    def __len__(self) -> int:
        if not self.shape:
            raise TypeError("the hits of a single ray have no length: ask for hits.is_hit")
        return len(self.prim_id)

    def __iter__(self) -> Iterator[Hits]:
        return (self[index] for index in range(len(self)))

    def _map(self, change: Callable[[NDArray[Any]], NDArray[Any]]) -> Hits:
        t, u, v, prim_id = (change(values) for values in (self.t, self.u, self.v, self.prim_id))
        is_front, instance_id = (
            None if values is None else change(values) for values in (self.is_front, self.known_instance_id)
        )
        return Hits(t, u, v, prim_id, is_front=is_front, surface=self.surface, known_instance_id=instance_id)

    def _refuse_wrong(self, directions: NDArray[Any], shape: tuple[int, ...]) -> None:
        """Raise `QueryError` for the first direction that leads nowhere, and that is the direction of a hit."""
        x, y, z = np.moveaxis(np.abs(directions), -1, 0)
        largest = np.maximum(np.maximum(x, y), z)  # reductions along so short an axis take ten times as long
        is_right = (largest > 0) & (largest < np.inf)
        if is_right.all():
            return
        is_wrong = np.broadcast_to(~is_right, shape) & self.is_hit
        if is_wrong.any():
            first = np.unravel_index(np.argmax(is_wrong), shape)
            wrong = np.broadcast_to(directions, (*shape, 3))[first]
            place = f" of the hit {tuple(map(int, first))}" if shape else ""
            advice = "" if wrong.any() else "; the normal of a face without area is 0, see Mesh.degenerate_faces"
            raise QueryError(f"towards must be finite directions of length above 0, not {wrong}{place}{advice}")

    def _known_surface(self) -> Surface:
        if self.surface is None:
            raise ConfigError("these hits do not know their mesh: make them with Hits(..., mesh=...)")
        return self.surface

    def _find_normals(self, normals: NDArray[np.float64], smooth: bool, facing: bool) -> NDArray[np.float64]:
        """Return the answer of `Normals.__call__`."""
        if facing and self.is_front is None:
            raise ConfigError(
                "these hits do not know from which side the rays came: turn hits.normals by the rays' directions"
            )
        if smooth:
            normals = self._known_surface().smooth_normals(self._points(), normals)
        return (
            np.where(self.is_front[..., None], normals, -normals) if facing and self.is_front is not None else normals
        )

    def _points(self) -> SurfacePoints:
        return SurfacePoints(self.prim_id, self.instance_id, self.u, self.v)

    def _show(self) -> str:
        """Return the values of a single hit as text."""
        known = {} if self.known_instance_id is None else {"instance_id": self.known_instance_id}
        location = {} if self.surface is None else {"location": self.locations}
        return show_values(t=self.t, prim_id=self.prim_id, **known, **location)

    def __repr__(self) -> str:
        if not self.shape:
            return f"Hits({self._show() if self.is_hit else 'miss'})"
        return show_found(
            f"Hits(shape={self.shape}, hits={self.count:,}", "t", self.t, self.is_hit,
            lambda row: f"{show_index(row, self.shape)} {self.take(row)._show()}",
        )  # fmt: skip


# Results that are shown of many.
_MOST_SHOWN = 3


def show_values(**values: Any) -> str:
    """Return numbers and points by their names, to six digits, for a `repr`."""

    def show(value: Any) -> str:
        if np.ndim(value):
            return f"({', '.join(map(show, value))})"
        return f"{value:.6g}" if np.asarray(value).dtype.kind == "f" else str(value)

    return ", ".join(f"{name}={show(value)}" for name, value in values.items())


def show_index(row: int, shape: tuple[int, ...]) -> str:
    """Return the index of a row in C order, as it is written behind an array."""
    return f"[{', '.join(map(str, np.unravel_index(row, shape)))}]"


def show_found(
    title: str, measure: str, values: NDArray[np.floating], is_found: NDArray[np.bool_], show: Callable[[int], str]
) -> str:
    """Return many results as text: a title, the least and the greatest of the values found, and the first results."""
    rows = np.flatnonzero(is_found)
    found = values.reshape(-1)[rows]
    limits = f", {measure}={found.min():.6g}..{found.max():.6g}" if len(rows) else ""
    return f"{title}{limits})" + "".join(f"\n  {show(row)}" for row in rows[:_MOST_SHOWN])


@dataclass(frozen=True, eq=False)
class AllHits(Hits):
    """All hits, grouped by ray, sorted by t.

    The fields of `Hits` have one entry per hit; none is a miss.

    Attributes
    ----------
    offsets : (n + 1,) int64
        The hits of ray i are those from ``offsets[i]`` to ``offsets[i + 1]``.
    known_locations : (m, 3) float64 or None
        The result of `locations`, if it was computed along with the hits.

    Examples
    --------
    >>> import clbvh
    >>> import trimesh
    >>> with clbvh.Tracer(trimesh.creation.box()) as tracer:
    ...     hits = tracer.all_hits([[0.1, 0.2, 5], [3, 0, 5], [0.3, 0, 0]], [[0, 0, -1], [0, 0, -1], [1, 0, 0]])
    >>> hits
    AllHits(rays=3, hits=3, t=0.2..5.5)
      ray 0: t=4.5, prim_id=..., location=(0.1, 0.2, 0.5)
      ray 0: t=5.5, prim_id=..., location=(0.1, 0.2, -0.5)
      ray 2: t=0.2, prim_id=..., location=(0.5, 0, 0)
    >>> hits.t, hits.ray_id
    (array([4.5, 5.5, 0.2]), array([0, 0, 2]))
    >>> hits.counts, hits.offsets
    (array([2, 0, 1]), array([0, 2, 2, 3]))
    >>> hits.t[hits.offsets[0] : hits.offsets[1]]  # of ray 0
    array([4.5, 5.5])
    """

    offsets: NDArray[np.int64] = field(default_factory=lambda: np.zeros(1, np.int64), kw_only=True)

    known_locations: NDArray[np.float64] | None = field(default=None, kw_only=True)

    @property
    def locations(self) -> NDArray[np.float64]:
        """(m, 3) float64, the file's coordinates: where the triangles are hit."""
        return super().locations if self.known_locations is None else self.known_locations

    @property
    def counts(self) -> NDArray[np.int64]:
        """(n,) int64: hits of each ray."""
        return np.diff(self.offsets)

    @property
    def ray_id(self) -> NDArray[np.int64]:
        """(m,) int64: the ray of each hit."""
        return np.repeat(np.arange(len(self.offsets) - 1), self.counts)

    def to_dict(self) -> dict[str, NDArray[Any]]:
        """Return arrays of (m,) by name, for a table; see `Hits.to_dict`.

        Examples
        --------
        >>> import clbvh
        >>> with clbvh.Tracer(clbvh.make_shape("icosphere", triangles=320)) as tracer:
        ...     table = tracer.all_hits([[0.1, 0.2, 5], [0.3, 0, 0]], [[0, 0, -1], [1, 0, 0]]).to_dict()
        >>> table["ray_id"], table["x"].round(1)
        (array([0, 0, 1]), array([0.1, 0.1, 1. ]))
        """
        return {"ray_id": self.ray_id, **super().to_dict()}

    def _ray_ids(self, hits: NDArray[np.int64]) -> NDArray[np.int32]:
        return self.ray_id[hits].astype(np.int32)

    def __repr__(self) -> str:
        title = f"AllHits(rays={len(self.offsets) - 1:,}, hits={self.count:,}"
        rays = self.ray_id[:_MOST_SHOWN]
        return show_found(title, "t", self.t, self.is_hit, lambda row: f"ray {rays[row]}: {self.take(row)._show()}")
