"""The sky and the sun as points see them, and their horizon: by any hit of rays in directions that all points share."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ConfigError, QueryError
from ..trace.hits.hits import Hits
from ..trace.points.ambient_occlusion import check_sampling
from ..trace.points.refine import ClosestPoints
from ..trace.rays.batch import read_vectors
from ..trace.rays.pieces import Progress
from ..trace.tracer import Tracer

# Rays in memory at a time, with their weights: 40 MB.
_RAYS_AT_ONCE = 1 << 22

# Rows of Tregenza's patches ("Subdivision of the sky hemisphere for luminance measurements", Lighting Research and
# Technology 19, 1987): how many, from the horizon up; the rows are 12 degrees high, and the last patch is a cap.
_TREGENZA_ROWS = (30, 30, 24, 24, 18, 12, 6, 1)
_TREGENZA_HEIGHT = 12.0

_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))

_ZENITH = 90.0

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
        Points on a surface, as of `Tracer.points_on`, are left on the side of their normals without meeting it.
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
    zenith = _unit(read_vectors(up, "up").reshape(-1))
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
    for name, value, most in (("step", step, _ZENITH), ("tolerance", tolerance, step)):
        if not 0 < value <= most:
            raise ConfigError(f"{name} must be above 0 and at most {most:g} degrees, not {value}")
    zenith = _unit(read_vectors(up, "up").reshape(-1))
    ahead = read_vectors(north, "north").reshape(-1)
    ahead = ahead - (ahead @ zenith) * zenith
    if not np.linalg.norm(ahead) > 0:
        raise QueryError("north must not be along up")
    ahead = _unit(ahead)
    angles = np.radians(np.asarray(azimuths, np.float64).reshape(-1))
    if not np.isfinite(angles).all():
        raise QueryError("azimuths must be finite")
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

    for begin, end in _cut(len(origins), len(level) * len(elevations)):
        seen = is_blocked(begin, end, np.broadcast_to(elevations[:, None, None], (len(elevations), 1, len(level))))
        # The highest that is blocked; the next one is free.
        is_any, highest = seen.any(axis=0), len(elevations) - 1 - seen[::-1].argmax(axis=0)
        low = elevations[highest]
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
    is_on_surface = hasattr(points, "offset_origins")
    if normals is None and is_on_surface:
        normals = np.asarray(points.normals)
    shape = points.shape if is_on_surface else read_vectors(points, "points").shape[:-1]
    facing = default if normals is None else read_vectors(normals, "normals")
    if facing is not None:
        try:
            facing = _unit(np.broadcast_to(facing, (*shape, 3)).reshape(-1, 3))
        except ValueError:
            raise QueryError(f"normals of shape {facing.shape} do not fit points of shape {shape}") from None
    if is_on_surface:
        assert facing is not None
        origins = points.offset_origins(towards=facing.reshape(*shape, 3))
    else:
        origins = read_vectors(points, "points")
    return np.asarray(origins, np.float64).reshape(-1, 3), facing, shape


def _read_directions(directions: ArrayLike) -> NDArray[np.float64]:
    vectors = read_vectors(directions, "directions")
    if vectors.ndim != 2:
        raise QueryError(f"directions must be (d, 3), not {vectors.shape}")
    return _unit(vectors)


def _read_weights(weights: ArrayLike, count: int, name: str) -> NDArray[np.float64]:
    try:
        values = np.broadcast_to(np.asarray(weights, np.float64), (count,))
    except ValueError:
        raise QueryError(f"{name} must be a number for each of the {count} directions") from None
    if not np.isfinite(values).all():
        raise QueryError(f"{name} must be finite")
    return np.ascontiguousarray(values)


def _unit(vectors: NDArray[Any]) -> NDArray[np.float64]:
    """Return vectors at length 1."""
    given = np.asarray(vectors, np.float64)
    lengths = np.linalg.norm(given, axis=-1, keepdims=True)
    if not (np.isfinite(lengths) & (lengths > 0)).all():
        raise QueryError("directions and normals must be finite, and have a length above 0")
    return np.asarray(given / lengths)


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
