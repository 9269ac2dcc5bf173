"""The sky and the sun as points see them, and their horizon: by any hit of rays in directions that all points share."""

from __future__ import annotations

import math
from collections.abc import Iterator
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ConfigError, QueryError
from ..scene.handles import shorten
from ..trace.hits.hits import Hits
from ..trace.points.ambient_occlusion import check_sampling
from ..trace.points.refine import ClosestPoints
from ..trace.rays.batch import read_vectors
from ..trace.rays.pieces import Progress
from ..trace.sight_queries import as_hits
from ..trace.tracer import Tracer

# Rays in memory at a time: about 130 MB with their weights.
_RAYS_AT_ONCE = 1 << 22

# Rows of Tregenza's patches ("Subdivision of the sky hemisphere for luminance measurements", Lighting Research and
# Technology 19, 1987): how many, from the horizon up; the rows are 12 degrees high, and the last patch is a cap.
_TREGENZA_ROWS = (30, 30, 24, 24, 18, 12, 6, 1)
_TREGENZA_HEIGHT = 12.0

_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))

_ZENITH = 90.0
# Degrees, and the sine between two directions that are not the same.
_LEAST_ANGLE, _LEAST_SINE = 1e-6, 1e-9
_ELEVATIONS_AT_ONCE = 64

Points = ArrayLike | Hits | ClosestPoints


def tregenza_patches() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the middles of Tregenza's 145 patches of the sky, and their solid angles.

    Returns
    -------
    directions : (145, 3) float64
        Unit vectors: x to the east, y to the north, z up. Row by row from the horizon, each clockwise from the north.
    solid_angles : (145,) float64
        Of sum 2 pi.

    Examples
    --------
    >>> import clbvh.radiation
    >>> directions, solid_angles = clbvh.radiation.tregenza_patches()
    >>> directions.shape, solid_angles.sum().round(4).item()
    ((145, 3), 6.2832)
    """
    directions, solid_angles = [], []
    for row, count in enumerate(_TREGENZA_ROWS):
        lower = math.radians(_TREGENZA_HEIGHT * row)
        is_cap = count == 1
        upper = math.pi / 2 if is_cap else math.radians(_TREGENZA_HEIGHT * (row + 1))
        middle = math.pi / 2 if is_cap else (lower + upper) / 2
        azimuths = 2.0 * math.pi * np.arange(count) / count
        row_of = np.full(count, math.cos(middle))
        directions.append(
            np.column_stack((row_of * np.sin(azimuths), row_of * np.cos(azimuths), np.full(count, math.sin(middle))))
        )
        solid_angles.append(np.full(count, 2.0 * math.pi * (math.sin(upper) - math.sin(lower)) / count))
    return np.concatenate(directions), np.concatenate(solid_angles)


def sky_view(
    tracer: Tracer,
    points: Points,
    normals: ArrayLike | None = None,
    *,
    rays: int = 1024,
    directions: ArrayLike | None = None,
    solid_angles: ArrayLike | None = None,
    up: ArrayLike = (0.0, 0.0, 1.0),
    progress: Progress | None = None,
) -> NDArray[np.float64]:
    """Return the sky-view factor of each point: the share of a uniform sky's radiation that arrives there.

    1 for a horizontal surface with nothing above it, 0.5 for a wall, 0 where no sky is seen.

    Parameters
    ----------
    tracer : Tracer
    points : (..., 3) float, Hits or ClosestPoints
        Points on a surface, as of `Tracer.points_on`, are left on the side of their normals without meeting it. Bare
        coordinates are points in the air: on a surface, they would be hidden by it.
    normals : (..., 3) float, optional
        Of the surface at each point, broadcast. Those of the hits or closest points, or `up`, without them.
    rays : int, optional
        From each point, evenly into the hemisphere around `up`.
    directions : (d, 3) float, optional
        In place of those, such as the patches of `tregenza_patches`.
    solid_angles : (d,) float, optional
        Of these directions; equal ones without it.
    up : (3,) float, optional
    progress : function, optional
        Called with the number of rays that are done, and of all.

    Returns
    -------
    (...,) float64

    Raises
    ------
    QueryError
        Arrays do not fit each other, or a vector is not finite.
    ConfigError
        The rays are out of range.

    Notes
    -----
    The memory besides the result does not grow with the number of rays.

    Examples
    --------
    In the middle of a round yard, two radii deep, a fifth of the sky:

    >>> import clbvh, clbvh.radiation, trimesh
    >>> yard = trimesh.creation.annulus(r_min=1, r_max=1.1, height=4, sections=256)
    >>> with clbvh.Tracer(yard) as tracer:
    ...     clbvh.radiation.sky_view(tracer, [[0, 0, 0]]).round(2)
    array([0.2])
    """
    check_tracer(tracer)
    zenith = _read_axis(up, "up")
    if directions is None:
        directions = _spread_around(zenith, check_sampling(rays, 0, 0, most_rays=_RAYS_AT_ONCE)[0])
    patches = _read_directions(directions)
    weights = _read_weights(1.0 if solid_angles is None else solid_angles, len(patches), "solid_angles")
    open_sky = float(weights @ np.maximum(patches @ zenith, 0.0))
    if not open_sky > 0:
        raise QueryError("directions must be of a sky: none with a solid angle is above the horizon")
    origins, facing, shape = _read_points(points, normals, zenith)
    totals = _sum_seen(tracer, origins, facing, patches, weights, progress, by_cosine=True)
    return (totals / open_sky).reshape(shape)


def sun_hours(
    tracer: Tracer,
    points: Points,
    directions: ArrayLike,
    weights: ArrayLike = 1.0,
    normals: ArrayLike | None = None,
    *,
    by_cosine: bool = False,
    progress: Progress | None = None,
) -> NDArray[np.float64]:
    """Return the sum of the weights of those directions in which each point sees the sky: hours of sun.

    Parameters
    ----------
    tracer : Tracer
    points : (..., 3) float, Hits or ClosestPoints
        See `sky_view`.
    directions : (d, 3) float
        Towards the sun, as from pvlib, of any length.
    weights : (d,) float, optional
        Of each direction: hours that the sun is there, or its irradiance times them.
    normals : (..., 3) float, optional
        Of the surface, broadcast: a direction behind it does not count. Those of the hits or closest points without it;
        of points without a surface, every direction counts.
    by_cosine : bool, optional
        Multiply with the cosine to the normal: irradiance becomes what arrives on the surface.
    progress : function, optional
        Called with the number of rays that are done, and of all.

    Returns
    -------
    (...,) float64

    Raises
    ------
    QueryError
        Arrays do not fit each other, a vector is not finite or has length zero, or `by_cosine` has no normals.

    Examples
    --------
    A wall that faces south, and the sun from four sides:

    >>> import clbvh, clbvh.radiation
    >>> wall = clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], [[0, 1, 2], [0, 2, 3]])
    >>> suns = [[0, -1, 1], [1, -1, 1], [0, 1, 1], [-1, 1, 1]]
    >>> with clbvh.Tracer(wall) as tracer:
    ...     clbvh.radiation.sun_hours(tracer, tracer.points_on([0, 1]), suns, weights=[3, 2, 1, 1])
    array([5., 5.])
    """
    check_tracer(tracer)
    suns = _read_directions(directions)
    hours = _read_weights(weights, len(suns), "weights")
    origins, facing, shape = _read_points(points, normals, None)
    if by_cosine and facing is None:
        raise QueryError("by_cosine needs normals, or points on a surface")
    return _sum_seen(tracer, origins, facing, suns, hours, progress, by_cosine=by_cosine).reshape(shape)


def horizon(
    tracer: Tracer,
    points: Points,
    azimuths: ArrayLike,
    *,
    step: float = 1.0,
    tolerance: float = 0.01,
    north: ArrayLike = (0.0, 1.0, 0.0),
    up: ArrayLike = (0.0, 0.0, 1.0),
    progress: Progress | None = None,
) -> NDArray[np.float64]:
    """Return the horizon angle of each point in each azimuth: the elevation above which the sky is free.

    Parameters
    ----------
    tracer : Tracer
    points : (..., 3) float, Hits or ClosestPoints
        See `sky_view`.
    azimuths : (a,) float, degrees
        Clockwise from the north, as seen from above.
    step : float, optional, degrees
        Elevations that are looked at first. What is less high and has free sky below may be missed.
    tolerance : float, optional, degrees
        To which the highest is narrowed down.
    north, up : (3,) float, optional
    progress : function, optional
        Called with the number of rays that are done, and of all.

    Returns
    -------
    (..., a) float64, degrees
        From 0, where nothing is in the way, to 90.

    Raises
    ------
    QueryError
        Points or azimuths are not finite, or `north` is along `up`.
    ConfigError
        A step or a tolerance is out of range.

    Examples
    --------
    A wall of height 1 at distance 1, to the north:

    >>> import clbvh, clbvh.radiation
    >>> corners = [[-9, 1, 0], [9, 1, 0], [9, 1, 1], [-9, 1, 1]]
    >>> with clbvh.Tracer(clbvh.Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3]])) as tracer:
    ...     clbvh.radiation.horizon(tracer, [0, 0, 0], [0, 60, 180]).round(1)
    array([45. , 26.6,  0. ])
    """
    check_tracer(tracer)
    for name, value, most in (("step", step, _ZENITH), ("tolerance", tolerance, step)):
        if not (isinstance(value, Real) and _LEAST_ANGLE <= value <= most):
            raise ConfigError(f"{name} must be from {_LEAST_ANGLE:g} to {most:g} degrees, not {value!r}")
    zenith, ahead = _read_axis(up, "up"), _read_axis(north, "north")
    ahead = ahead - (ahead @ zenith) * zenith
    if not np.linalg.norm(ahead) > _LEAST_SINE:
        raise QueryError("north must not be along up")
    ahead = _unit(ahead, "north")
    angles = np.radians(_read_numbers(azimuths, "azimuths").reshape(-1))
    level = np.cos(angles)[:, None] * ahead + np.sin(angles)[:, None] * np.cross(ahead, zenith)

    origins, _, shape = _read_points(points, None, zenith)
    elevations = np.append(np.arange(0.0, _ZENITH, step), _ZENITH)
    halvings = max(0, math.ceil(math.log2(step / tolerance)))
    whole = len(origins) * len(level) * (len(elevations) + halvings)
    answers, done = np.empty((len(origins), len(level))), 0

    def is_blocked(begin: int, end: int, degrees: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Cast a ray of each point and azimuth at elevations, (..., p, a) or broadcast."""
        radians = np.radians(degrees)[..., None]
        return tracer.any_hit(origins[begin:end, None], np.cos(radians) * level + np.sin(radians) * zenith)

    for begin, end in _cut(len(origins), len(level) * _ELEVATIONS_AT_ONCE):
        # The highest that is blocked; the next one is free.
        highest = np.full((end - begin, len(level)), -1)
        for first in range(0, len(elevations), _ELEVATIONS_AT_ONCE):
            some = elevations[first : first + _ELEVATIONS_AT_ONCE, None, None]
            seen = is_blocked(begin, end, np.broadcast_to(some, (len(some), 1, len(level))))
            last = first + len(some) - 1 - seen[::-1].argmax(axis=0)
            highest = np.where(seen.any(axis=0), last, highest)
        is_any = highest >= 0
        low = elevations[np.maximum(highest, 0)]
        high = elevations[np.minimum(highest + 1, len(elevations) - 1)]
        for _ in range(halvings):
            middle = (low + high) / 2
            blocked = is_blocked(begin, end, middle)
            low, high = np.where(blocked, middle, low), np.where(blocked, high, middle)
        answers[begin:end] = np.where(is_any, (low + high) / 2, 0.0)
        done += (end - begin) * len(level) * (len(elevations) + halvings)
        if progress is not None:
            progress(done, whole)
    return answers.reshape(*shape, len(level))


def check_tracer(tracer: Any) -> None:
    """Raise `QueryError` unless this casts rays: a mesh does not."""
    if not hasattr(tracer, "any_hit"):
        raise QueryError(f"tracer must be a clbvh.Tracer, not {type(tracer).__name__}: open one, clbvh.Tracer(mesh)")


def _sum_seen(
    tracer: Tracer, origins: NDArray[np.float64], normals: NDArray[np.float64] | None, directions: NDArray[np.float64],
    weights: NDArray[np.float64], progress: Progress | None, *, by_cosine: bool,
) -> NDArray[np.float64]:  # fmt: skip
    """Return (p,) float64: the sum of the weights of the directions in which nothing is met."""
    sums = np.empty(len(origins))
    for begin, end in _cut(len(origins), len(directions)):
        cosines = None if normals is None else directions @ normals[begin:end].T
        # Rays below the surface have no length. Neighbours in memory have one direction, and take similar ways.
        t_max = np.inf if cosines is None else np.where(cosines > 0, np.inf, 0.0)
        seen = ~tracer.any_hit(origins[begin:end], directions[:, None], t_max=t_max)
        if cosines is None:
            sums[begin:end] = weights @ seen
        else:
            gains = np.maximum(cosines, 0.0) if by_cosine else cosines > 0
            sums[begin:end] = weights @ (seen * gains)
        if progress is not None:
            progress(end * len(directions), len(origins) * len(directions))
    return sums


def _cut(point_count: int, rays_of_point: int) -> Iterator[tuple[int, int]]:
    """Yield the ranges of points whose rays are in memory together."""
    at_once = max(1, _RAYS_AT_ONCE // max(rays_of_point, 1))
    for begin in range(0, point_count, at_once):
        yield begin, min(point_count, begin + at_once)


def _read_points(
    points: Any, normals: ArrayLike | None, default: NDArray[np.float64] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, tuple[int, ...]]:
    """Return start points (p, 3), unit normals or None, and the points' shape."""
    hits = as_hits(points)
    if hits is not None and normals is None:
        normals = np.asarray(hits.normals)
    positions = read_vectors(points, "points") if hits is None else hits.locations
    shape = positions.shape[:-1]
    facing = default if normals is None else read_vectors(normals, "normals")
    if facing is not None:
        try:
            facing = np.broadcast_to(facing, (*shape, 3))
        except ValueError:
            raise QueryError(f"normals of shape {facing.shape} do not fit points of shape {shape}") from None
        facing = _unit(facing, "normals").reshape(-1, 3)
        if hits is not None:
            positions = hits.offset_origins(towards=facing.reshape(*shape, 3))
    return np.asarray(positions, np.float64).reshape(-1, 3), facing, shape


def _read_directions(directions: ArrayLike) -> NDArray[np.float64]:
    vectors = read_vectors(directions, "directions")
    if vectors.ndim != 2:
        raise QueryError(f"directions must be (d, 3), not {vectors.shape}")
    return _unit(vectors, "directions")


def _read_axis(values: ArrayLike, name: str) -> NDArray[np.float64]:
    vector = read_vectors(values, name)
    if vector.shape != (3,):
        raise QueryError(f"{name} must be one direction, (3,), not {vector.shape}")
    return _unit(vector, name)


def _read_numbers(values: ArrayLike, name: str) -> NDArray[np.float64]:
    try:
        numbers = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        raise QueryError(f"{name} must be numbers, not {shorten(values)}") from None
    if not np.isfinite(numbers).all():
        raise QueryError(f"{name} must be finite")
    return numbers


def _read_weights(weights: ArrayLike, count: int, name: str) -> NDArray[np.float64]:
    numbers = _read_numbers(weights, name)
    try:
        return np.ascontiguousarray(np.broadcast_to(numbers, (count,)))
    except ValueError:
        raise QueryError(f"{name} must be a number for each of the {count} directions") from None


def _unit(vectors: NDArray[Any], name: str) -> NDArray[np.float64]:
    """Return vectors at length 1."""
    given = np.asarray(vectors, np.float64)
    sizes = np.abs(given).max(axis=-1, keepdims=True, initial=0.0)
    if not (np.isfinite(sizes) & (sizes > 0)).all():
        raise QueryError(f"{name} must be finite, with a length above 0; misses and faces without area have no normals")
    given = given / sizes
    return np.asarray(given / np.linalg.norm(given, axis=-1, keepdims=True))


def _spread_around(zenith: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return directions of equal solid angles around the zenith, on a spiral.

    See Vogel, "A better way to construct the sunflower head", Mathematical Biosciences 44, 1979.
    """
    heights = (np.arange(count) + 0.5) / count
    turns = _GOLDEN_ANGLE * np.arange(count)
    aside = np.cross(zenith, np.eye(3)[np.abs(zenith).argmin()])
    aside /= np.linalg.norm(aside)
    level = np.cos(turns)[:, None] * aside + np.sin(turns)[:, None] * np.cross(zenith, aside)
    return np.sqrt(1.0 - heights**2)[:, None] * level + heights[:, None] * zenith
