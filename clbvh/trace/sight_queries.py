"""The queries of a tracer that ask who sees whom: points each other, and an eye or a camera primitives."""

from __future__ import annotations

import math
from numbers import Integral
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ConfigError, QueryError
from ..geometry import Mesh
from ..views.cameras.camera import Camera
from .hits.hits import Hits
from .hits.points_on import place_points
from .hits.surface import Surface
from .points.refine import ClosestPoints
from .ray_queries import RayQueries
from .rays.batch import check_room, check_side, read_vectors
from .rays.pieces import Progress

# Rays in memory at a time: about 200 MB with all that is known of their ends.
_RAYS_AT_ONCE = 1 << 20

# Of a cosine times a length, relative to coordinates: a direction is along a surface if it is less.
_ROUNDING = 2.0**-48

_MOST_SAMPLES = 1 << 16

# Samples of faces that are worth a call.
_FEW = 1 << 14

# Steps of the sequence R2 (Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018).
_STEP_U, _STEP_V = 0.7548776662466927, 0.5698402909980532


class SightQueries(RayQueries):
    """The queries of a `Tracer` about sight."""

    def line_of_sight(
        self,
        a: ArrayLike | Hits | ClosestPoints,
        b: ArrayLike | Hits | ClosestPoints,
        *,
        side: str | None = None,
        mask: ArrayLike | None = None,
        progress: Progress | None = None,
    ) -> NDArray[np.bool_]:
        """Return (...,) bool: whether nothing is between two points.

        Parameters
        ----------
        a, b : (..., 3) float, Hits or ClosestPoints
            Broadcast: ``line_of_sight(points[:, None], points)`` asks about all pairs. The surfaces on which hits and
            closest points are do not hide them, nor do others there: see `Hits.offset_origins`. Closest points get
            another shape by `as_hits`: ``closest.as_hits()[:, None]``.
        side : str, optional
            ``"front"``: hits and closest points see only what is in front of their surfaces, as those of closed meshes
            do. ``"back"``: behind them. Both sides without it. Along its surface, a point sees on every side.
        mask : (...,) int, optional
            See `closest_hit`.
        progress : function, optional
            Called with the number of pairs that are done, and of all.

        Raises
        ------
        QueryError
            Points are not finite, or shapes do not broadcast.
        ConfigError
            There is no such side.

        Notes
        -----
        A point sees itself. The memory besides the result does not grow with the number of pairs.

        Examples
        --------
        Which faces of a knot see each other, and which an antenna above it:

        >>> import clbvh
        >>> knot = clbvh.make_shape("knot", triangles=600)
        >>> with clbvh.Tracer(knot) as tracer:
        ...     faces = tracer.points_on(range(knot.face_count))
        ...     sees = tracer.line_of_sight(faces[:, None], faces, side="front")
        ...     covered = tracer.line_of_sight(faces, [0, 0, 5], side="front")
        >>> sees.shape, round(sees.mean().item(), 2), round(covered.mean().item(), 2)
        ((600, 600), 0.11, 0.39)
        """
        return self._look(a, b, side, mask, progress, sees_along=True)

    def _look(
        self, a: ArrayLike | Hits | ClosestPoints, b: ArrayLike | Hits | ClosestPoints, side: str | None,
        mask: ArrayLike | None = None, progress: Progress | None = None, *, sees_along: bool,
    ) -> NDArray[np.bool_]:  # fmt: skip
        """Return what `line_of_sight` does; maybe without lines along a surface, which see nothing of it."""
        check_side(side)
        ends = _End.read(a, "a"), _End.read(b, "b")
        try:
            shape = np.broadcast_shapes(ends[0].shape, ends[1].shape, () if mask is None else np.shape(mask))
        except (ValueError, RuntimeError):  # numpy's limit of axes
            shapes = " and ".join(map(str, [ends[0].shape, ends[1].shape, *([] if mask is None else [np.shape(mask)])]))
            raise QueryError(
                f"points{'' if mask is None else ' and masks'} of shapes {shapes} do not broadcast"
            ) from None
        count = math.prod(shape)
        check_room(count, 1, "pairs")
        seen = np.empty(count, np.bool_)
        numbers: list[Any] = [np.broadcast_to(np.arange(end.count).reshape(end.shape), shape) for end in ends]
        masks = None if mask is None else np.broadcast_to(np.asarray(mask), shape)
        for begin in range(0, count, _RAYS_AT_ONCE):
            part = slice(begin, min(count, begin + _RAYS_AT_ONCE))
            here, there = (number.flat[part] for number in numbers)
            ways = ends[1].positions.take(there, axis=0) - ends[0].positions.take(here, axis=0)
            is_same = (ways == 0).all(axis=1)
            leaving, arriving = ends[0].leave(here, ways), ends[1].leave(there, -ways)
            # Along one plane both ends are on one side of it, also where its faces are turned.
            is_flat = leaving.is_flat & arriving.is_flat
            is_alike = np.einsum("ij,ij->i", leaving.normals, arriving.normals) >= 0
            starts = leaving.lift(leaving.is_front)
            stops = arriving.lift(np.where(is_flat, is_alike, arriving.is_front))
            ways = np.where(is_same[:, None], 1.0, stops - starts)
            blocked = self.any_hit(starts, ways, t_max=1.0, mask=None if masks is None else masks.flat[part])
            seen[part] = is_same | (~blocked & leaving.sees(side) & arriving.sees(side))
            if not sees_along:
                seen[part] &= ~is_flat
            if progress is not None:
                progress(part.stop, count)
        return seen.reshape(shape)

    def visible_prims(
        self, eye: ArrayLike | Camera, samples: int = 16, *, width: int | None = None, height: int | None = None,
        side: str | None = None,
    ) -> Hits:  # fmt: skip
        """Return the faces that an eye or a camera sees, as hits, each where it is seen.

        `Hits.prim_id`, and in scenes `Hits.instance_id`, name the faces, instance after instance, in their order. Faces
        smaller than a pixel are found by their samples, and those that a camera sees also by its pixels.

        Parameters
        ----------
        eye : (3,) float or Camera
        samples : int, optional
            Points of a face, spread evenly, the centroid first: a face of which none is visible is missing.
        width, height : int, optional
            The picture of a camera; one without a lens needs both, see `Camera.rays`.
        side : str, optional
            ``"front"`` or ``"back"`` of faces alone.

        Raises
        ------
        QueryError
            The eye is no point, or the tracer has spheres.
        ConfigError
            The samples are out of range, or there is no such side.
        SceneError
            The camera has no picture of this size.

        Examples
        --------
        >>> import clbvh
        >>> with clbvh.Tracer(clbvh.make_shape("cube", triangles=12)) as tracer:
        ...     len(tracer.visible_prims([9, 8, 7], side="front").prim_id)
        6
        """
        if isinstance(samples, bool) or not (isinstance(samples, Integral) and 1 <= samples <= _MOST_SAMPLES):
            raise ConfigError(f"samples must be an integer from 1 to {_MOST_SAMPLES}, not {samples}")
        place = None if isinstance(eye, Camera) else read_vectors(eye, "eye")
        if place is not None and place.shape != (3,):
            raise QueryError(f"eye must be a point (3,) or a camera, not {place.shape}")
        surface = Surface.of_world(self._caster.world)
        instances, prims = surface.list_faces()
        # Faces without area are never seen, nor are those that a mask of 0 removes.
        normals = np.asarray(place_points(surface, prims, (1 / 3, 1 / 3), instances).normals)
        is_left = np.isfinite(normals).all(axis=-1) & (self._caster.world.state.masks[instances] != 0)
        places = np.full((len(prims), 2), np.nan)
        if isinstance(eye, Camera):
            # Of a large face all samples may be outside of the picture.
            hits = self._hit_pixels(eye, width, height, side)
            owners = np.zeros(1, np.int64) if hits.instance_id is None else hits.instance_id
            places[np.searchsorted(instances, owners) + hits.prim_id] = np.column_stack((hits.u, hits.v))
        left, sample = np.flatnonzero(is_left & np.isnan(places[:, 0])), 0
        while len(left) and sample < samples:
            # Few faces are asked about several samples at once.
            chosen = np.array([_spread(each) for each in range(sample, min(samples, sample + 1 + _FEW // len(left)))])
            points = place_points(surface, prims[left, None], chosen, instances[left, None])
            if isinstance(eye, Camera):
                is_visible = self._is_in_picture(points, eye, width, height, side)
            else:
                is_visible = self._look(points, eye, side, sees_along=False)
            is_found = is_visible.any(axis=1)
            places[left[is_found]] = chosen[is_visible[is_found].argmax(axis=1)]
            left, sample = left[~is_found], sample + len(chosen)
        is_seen = np.isfinite(places[:, 0])
        return place_points(surface, prims[is_seen], places[is_seen], instances[is_seen])

    def _hit_pixels(self, camera: Camera, width: int | None, height: int | None, side: str | None) -> Hits:
        """Return a hit for each face that a pixel of a camera shows."""
        hits = self.closest_hit(*camera.rays(width, height))
        is_shown = hits.is_hit & camera.sees(width, height)
        if side is not None and hits.is_front is not None:
            is_shown &= hits.is_front == (side == "front")
        hits = hits[is_shown]
        keys = hits.prim_id if hits.instance_id is None else np.stack((hits.instance_id, hits.prim_id), axis=-1)
        return hits[np.unique(keys, axis=0, return_index=True)[1]]

    def _is_in_picture(
        self, points: Hits, camera: Camera, width: int | None, height: int | None, side: str | None
    ) -> NDArray[np.bool_]:
        """Return which points a camera sees."""
        columns, rows = camera.size_for(width, height)
        pixels, _ = camera.project(points.locations, columns, rows)
        is_inside = np.asarray((pixels >= 0).all(axis=-1) & (pixels <= (columns, rows)).all(axis=-1))  # NaN is not
        starts, _ = camera.rays_at(pixels[is_inside], columns, rows)
        is_inside[is_inside] = self._look(points[is_inside], starts, side, sees_along=False)
        return is_inside


def as_hits(points: Any) -> Hits | None:
    """Return hits or closest points as hits; None for coordinates."""
    if isinstance(points, ClosestPoints):
        return points.as_hits()
    return points if isinstance(points, Hits) else None


class _Leaving(NamedTuple):
    """Lines that begin at some points: the normals there, and the places beside the surface on either side.

    `is_front` says to which side a line leads, and `is_flat` that it leads along the surface, as far as float64 can
    tell; in free space both are true, and normals are zero.
    """

    normals: NDArray[np.float64]
    front: NDArray[np.float64]
    back: NDArray[np.float64]
    is_front: NDArray[np.bool_]
    is_flat: NDArray[np.bool_]

    def lift(self, is_front: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return where the lines begin."""
        return self.front if self.front is self.back else np.where(is_front[:, None], self.front, self.back)

    def sees(self, side: str | None) -> NDArray[np.bool_]:
        """Return which lines a side lets through."""
        if side is None:
            return np.ones(len(self.is_flat), np.bool_)
        return self.is_flat | (self.is_front if side == "front" else ~self.is_front)


class _End:
    """Points at one end of lines of sight; `rounding` is of a height over the surface, for lines of length 1."""

    def __init__(self, positions: NDArray[Any], hits: Hits | None) -> None:
        self.shape = positions.shape[:-1]
        self.count = math.prod(self.shape)
        self.positions = np.asarray(positions, np.float64).reshape(-1, 3)
        self._is_free = hits is None
        if hits is None:
            return
        normals = np.asarray(hits.normals).reshape(-1, 3)
        # A face without area hides nothing.
        has_normal = np.isfinite(normals).all(axis=1)
        self._normals = np.where(has_normal[:, None], normals, 0.0)
        towards = np.where(has_normal[:, None], normals, 1.0).reshape(*self.shape, 3)
        self._front, self._back = (
            np.where(has_normal[:, None], hits.offset_origins(towards=sign * towards).reshape(-1, 3), self.positions)
            for sign in (1.0, -1.0)
        )
        self._rounding = _bound_rounding(hits)

    @classmethod
    def read(cls, points: Any, name: str) -> _End:
        """Read points of space, or of a surface."""
        hits = as_hits(points)
        positions = read_vectors(points, name) if hits is None else hits.locations
        if not np.isfinite(positions).all():
            raise QueryError(f"{name} must be finite{'' if hits is None else ': some rays have hit nothing'}")
        return cls(positions, hits)

    def leave(self, numbers: NDArray[np.int64], ways: NDArray[np.float64]) -> _Leaving:
        """Return lines from points, which lead along `ways`."""
        positions = self.positions.take(numbers, axis=0)
        if self._is_free:
            everywhere = np.ones(len(numbers), np.bool_)
            return _Leaving(np.zeros((len(numbers), 3)), positions, positions, everywhere, everywhere)
        normals, front, back = (each.take(numbers, axis=0) for each in (self._normals, self._front, self._back))
        heights = np.einsum("ij,ij->i", normals, ways)
        lengths = np.abs(ways).max(axis=1)
        room = _ROUNDING * (np.abs(positions).max(axis=1) + lengths) + self._rounding[numbers] * lengths
        return _Leaving(normals, front, back, heights >= -room, np.abs(heights) <= room)


def _bound_rounding(hits: Hits) -> NDArray[np.float64]:
    """Return (n,) float64: how far the normals of faces may be off, by the rounding of their corners."""
    surface = hits._known_surface()
    if not all(isinstance(shape, Mesh) for shape in surface.shapes):
        return np.zeros(math.prod(hits.shape))
    prims, instances = hits.prim_id.reshape(-1, 1), hits.instance_id.reshape(-1, 1).astype(np.int64)
    corners = place_points(surface, prims, np.eye(3), instances).locations
    edges = corners - np.roll(corners, 1, axis=1)
    longest = np.sqrt(np.einsum("nij,nij->ni", edges, edges).max(axis=1))
    doubled = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    # The rounding of coordinates over the smallest height.
    return np.asarray(
        _ROUNDING * np.abs(corners).max(axis=(1, 2)) * longest / np.maximum(doubled, np.finfo(float).tiny)
    )


def _spread(sample: int) -> tuple[float, float]:
    """Return u and v of a sample of a triangle; of the first one, the centroid."""
    if sample == 0:
        return 1 / 3, 1 / 3
    u, v = sample * _STEP_U % 1.0, sample * _STEP_V % 1.0
    return (u, v) if u + v <= 1 else (1.0 - u, 1.0 - v)
