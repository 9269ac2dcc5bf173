"""View factors with obstruction, by rays from faces: where they end is counted while they are cast.

The view factor from one surface to another is the share of the radiation that leaves the first diffusely and arrives
at the second (Howell, "A catalog of radiation heat transfer configuration factors"). Rays leave a source at points that
are spread evenly over its area, in directions whose density is the cosine to the normal; so each carries the same
power, and the share of those that end at a target is the factor (Walker, Xue and Barton, "Numerical determination of
radiative view factors using ray tracing", Journal of Heat Transfer 132, 2010).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..device.host.loops import Loops
from ..errors import ConfigError, QueryError
from ..scene.handles import shorten
from ..support.host_threads import HostThreads
from ..trace.hits.points_on import place_points
from ..trace.hits.surface import Surface
from ..trace.points.ambient_occlusion import check_sampling
from ..trace.rays.pieces import Progress
from ..trace.tracer import Tracer
from .sky import check_tracer

_LOOPS = Loops("radiation/rays")

SIDES = ("front", "back", "both")

# Rays in memory at a time: about 75 MB with their ends.
_RAYS_AT_ONCE = 1 << 20
# Rays that are worth a thread.
_RAYS_OF_THREAD = 1 << 13


@dataclass(frozen=True, eq=False)
class ViewFactors:
    """View factors between faces, or groups of faces; see `view_factors`.

    Those that are 0 are left out. The factors of a source, `sky` and `ungrouped` add up to 1.

    Attributes
    ----------
    source, target : (m,) int32
        Of each factor, sorted by source.
    factor : (m,) float64
        The share of the radiation that leaves the source and arrives at the target, above 0, 1 at most.
    sky : (n,) float64
        The share that leaves the scene; NaN for a source without area.
    ungrouped : (n,) float64
        The share that arrives at faces of no group; NaN for a source without area.
    area : (n,) float64
        Of each source, both sides counted if both emit; world units squared. 0 for a number that no group has.
    rays : int
        From each source.
    """

    source: NDArray[np.int32]
    target: NDArray[np.int32]
    factor: NDArray[np.float64]
    sky: NDArray[np.float64]
    ungrouped: NDArray[np.float64]
    area: NDArray[np.float64]
    rays: int

    @property
    def standard_error(self) -> NDArray[np.float64]:
        """(m,) float64: a bound on the standard error of each factor, that of rays drawn independently."""
        return np.sqrt(self.factor * (1.0 - self.factor) / self.rays)

    def to_sparse(self) -> Any:
        """Return the factors as a `scipy.sparse.csr_array` (n, n), rows are sources.

        Raises
        ------
        ConfigError
            SciPy is not installed.
        """
        try:
            from scipy.sparse import csr_array  # type: ignore[import-untyped]
        except ImportError as error:
            raise ConfigError("a sparse matrix needs SciPy: run 'pip install scipy', or take to_dense()") from error
        return csr_array((self.factor, (self.source, self.target)), shape=(len(self.area),) * 2)

    def to_dense(self) -> NDArray[np.float64]:
        """Return the factors as (n, n) float64, rows are sources."""
        matrix = np.zeros((len(self.area),) * 2)
        matrix[self.source, self.target] = self.factor
        return matrix

    @property
    def reciprocity_error(self) -> float:
        """How far ``area[i] F[i, j]`` and ``area[j] F[j, i]`` differ: root mean square over that of their means.

        They are equal for exact factors between flat or convex surfaces that emit on the sides that others see; the
        error falls with the number of rays.
        """
        count = len(self.area)
        sums = self.area[self.source] * self.factor
        ids = self.source * np.int64(count) + self.target
        back = self.target * np.int64(count) + self.source
        every, place = np.unique(np.concatenate((ids, back)), return_inverse=True)
        there, here = (np.zeros(len(every)) for _ in range(2))
        here[place[: len(ids)]], there[place[len(ids) :]] = sums, sums
        size = np.linalg.norm(here + there) / 2
        return float(np.linalg.norm(here - there) / size) if size else 0.0


def view_factors(
    tracer: Tracer,
    rays: int = 1024,
    groups: ArrayLike | None = None,
    *,
    sides: str = "front",
    seed: int = 0,
    progress: Progress | None = None,
) -> ViewFactors:
    """Return the view factors from every face, or group of faces, to every other and to the sky, with obstruction.

    Parameters
    ----------
    tracer : Tracer
        Of a mesh, or of a scene of meshes, whose faces are numbered instance after instance.
    rays : int, optional
        From each source, 1 to 1,048,576; a power of two is spread best.
    groups : (face_count,) int, optional
        The group of each face, such as a wall or a room, counted from 0; -1 for faces that only obstruct. Without it,
        each face is a group.
    sides : str, optional
        From which faces emit: ``"front"``, where their normals are, ``"back"`` or ``"both"``. All sides receive.
    seed : int, optional
    progress : function, optional
        Called with the number of rays that are done, and of all.

    Returns
    -------
    ViewFactors

    Raises
    ------
    QueryError
        The tracer has spheres, or groups have another shape.
    ConfigError
        A number or a side is out of range.

    Notes
    -----
    Places and directions are spread together, by Owen-scrambled Sobol points of four dimensions (Burley, 2020): errors
    fall faster than those of independent rays, and are less than half of theirs at 16,384 rays.
    The same seed gives the same factors on every device. Besides the result, memory does not grow with the number of
    rays. Instances with a mask of 0 neither emit nor obstruct.

    Faces that lie on each other see past each other, as the two sides of a sheet do: see docs/radiation.md.

    Rays begin above their face, by what float32 rounds (see `Hits.offset_origins`): at most 1e-5 of the largest side of
    the box around everything. A narrower gap between faces is not seen.

    Examples
    --------
    Parallel unit squares at distance 1: a fifth of what leaves one arrives at the other.

    >>> import clbvh, clbvh.radiation
    >>> corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1], [1, 1, 1], [1, 0, 1]]
    >>> faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    >>> with clbvh.Tracer(clbvh.Mesh.from_arrays(corners, faces)) as tracer:
    ...     factors = clbvh.radiation.view_factors(tracer, 65536, groups=[0, 0, 1, 1])
    >>> factors.factor.round(2), factors.sky.round(2)
    (array([0.2, 0.2]), array([0.8, 0.8]))
    """
    check_tracer(tracer)
    rays, seed, _ = check_sampling(rays, seed, 0, most_rays=_RAYS_AT_ONCE)
    if not isinstance(sides, str) or sides not in SIDES:
        raise ConfigError(f"sides must be one of {', '.join(SIDES)}, not {sides!r}")
    faces = _Faces.of_tracer(tracer, sides)
    labels = _read_groups(groups, faces.face_count)
    sources = _Sources.make(faces, labels)
    return _count_rays(tracer, faces, sources, labels, rays, seed, progress)


class _Faces(NamedTuple):
    """The faces of a tracer, instance after instance, and each once more if both sides emit.

    Attributes
    ----------
    face_count : int
    firsts : (instance_count,) int64
        The number of the first face of each instance.
    corners : (k * face_count, 3, 3) float64
        So far above the emitting side that rays do not meet the face; from there, they run anticlockwise.
    areas : (k * face_count,) float64
    """

    face_count: int
    firsts: NDArray[np.int64]
    corners: NDArray[np.float64]
    areas: NDArray[np.float64]

    @classmethod
    def of_tracer(cls, tracer: Tracer, sides: str) -> _Faces:
        """Read the faces where they are now."""
        world = tracer._caster.world
        surface = Surface.of_world(world)
        instances, prims = surface.list_faces()
        count, firsts = len(prims), np.searchsorted(instances, np.arange(len(surface.arrays.geometry_id)))
        hits = place_points(surface, prims[:, None], np.eye(3), instances[:, None])
        corners, normals = hits.locations, np.asarray(hits.normals)[:, :1]
        doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        # A face without area emits nothing, and has no normal; nor does one that nothing sees.
        has_normal = np.isfinite(normals).all(axis=(1, 2))
        is_visible = world.state.masks[instances] != 0
        areas = np.where(has_normal & is_visible, np.linalg.norm(doubled, axis=1) / 2, 0.0)
        normals = np.where(has_normal[:, None, None], normals, (0.0, 0.0, 1.0))
        # A mirror turns the corners, and takes the outer side along.
        is_turned = np.einsum("ij,ij->i", doubled, normals[:, 0]) < 0
        lifted = []
        for sign in [1.0] * (sides != "back") + [-1.0] * (sides != "front"):
            above = hits.offset_origins(towards=sign * normals)
            turned = is_turned if sign > 0 else ~is_turned
            lifted.append(np.where(turned[:, None, None], above[:, ::-1], above))
        return cls(count, firsts, np.concatenate(lifted), np.tile(areas, len(lifted)))


class _Sources(NamedTuple):
    """Faces by sources.

    Attributes
    ----------
    numbers : (s,) int32
        Of the sources that have an area.
    begins : (s + 1,) int64
        Where the faces of each begin.
    corners : (f, 3, 3) float64
    sums : (f,) float64
        Areas up to and with each face, of that of the source.
    areas : (n,) float64
        Of all sources.
    """

    numbers: NDArray[np.int32]
    begins: NDArray[np.int64]
    corners: NDArray[np.float64]
    sums: NDArray[np.float64]
    areas: NDArray[np.float64]

    @classmethod
    def make(cls, faces: _Faces, labels: NDArray[np.int32] | None) -> _Sources:
        """Sort the faces that emit."""
        own = np.arange(faces.face_count, dtype=np.int32) if labels is None else labels
        source_of = np.tile(own, len(faces.areas) // max(faces.face_count, 1))
        source_count = int(own.max(initial=-1)) + 1
        emits = (source_of >= 0) & (faces.areas > 0)
        areas = np.asarray(np.bincount(source_of[emits], faces.areas[emits], source_count), np.float64)
        order = np.flatnonzero(emits)
        order = order[np.argsort(source_of[order], kind="stable")]
        numbers, firsts, counts = np.unique(source_of[order], return_index=True, return_counts=True)
        # Shares, not areas: a large source would take the digits of the next ones.
        sums = np.cumsum(faces.areas[order] / np.repeat(areas[numbers], counts))
        shares = np.asarray(sums - np.repeat(np.concatenate(([0.0], sums))[firsts], counts))
        shares[firsts + counts - 1] = 1.0
        begins = np.append(firsts, len(order)).astype(np.int64)
        return cls(numbers.astype(np.int32), begins, np.ascontiguousarray(faces.corners[order]), shares, areas)


def _count_rays(
    tracer: Tracer, faces: _Faces, sources: _Sources, labels: NDArray[np.int32] | None, rays: int, seed: int,
    progress: Progress | None,
) -> ViewFactors:  # fmt: skip
    """Cast all rays, a part of the sources at a time, and count where they end."""
    count, at_once = len(sources.numbers), max(1, _RAYS_AT_ONCE // rays)
    is_lone = tracer._caster.world.is_lone
    origins, directions = (np.empty((min(count, at_once), rays, 3)) for _ in range(2))
    counts = np.zeros(len(sources.areas), np.int32)
    found, missed = [], np.zeros(count, np.int32)

    def draw(batch: int, begin: int, end: int) -> None:
        _LOOPS.draw_rays(
            sources.corners, sources.begins, sources.sums, batch, batch + begin, batch + end, rays, seed, origins,
            directions,
        )  # fmt: skip

    with HostThreads() as threads:
        for begin in range(0, count, at_once):
            end = min(count, begin + at_once)
            threads.for_ranges(end - begin, partial(draw, begin), least_items=max(1, _RAYS_OF_THREAD // rays))
            given = origins[: end - begin], directions[: end - begin]
            if is_lone:
                ends = tracer.closest_prim(*given)
            else:
                hits = tracer.closest_hit(*given)
                ends = np.where(hits.is_hit, faces.firsts[hits.instance_id] + hits.prim_id, -1).astype(np.int32)
            targets, tallies = np.empty(ends.shape, np.int32), np.empty(ends.shape, np.int32)
            distinct = np.empty(end - begin, np.int32)
            _LOOPS.count_ends(ends, labels, rays, counts, targets, tallies, distinct, missed[begin:end])
            is_found = np.arange(rays) < distinct[:, None]
            found.append((np.repeat(sources.numbers[begin:end], distinct), targets[is_found], tallies[is_found]))
            if progress is not None:
                progress(end * rays, count * rays)
    found = found or [(np.empty(0, np.int32),) * 3]
    source, target, tally = (np.concatenate(each) for each in zip(*found, strict=True))
    sky, ungrouped = np.full(len(sources.areas), np.nan), np.full(len(sources.areas), np.nan)
    sky[sources.numbers] = missed / rays
    grouped = np.bincount(source, tally, len(sources.areas))[sources.numbers]
    ungrouped[sources.numbers] = (rays - grouped - missed) / rays
    return ViewFactors(source, target, tally / rays, sky, ungrouped, sources.areas, rays)


def _read_groups(groups: ArrayLike | None, count: int) -> NDArray[np.int32] | None:
    """Return the group of each face."""
    if groups is None:
        return None
    try:
        labels = np.asarray(groups)
    except ValueError:  # lists of different lengths
        labels = np.empty(0)
    if labels.shape != (count,) or (count and labels.dtype.kind not in "iu"):
        given = f"{labels.dtype} of shape {labels.shape}, {shorten(groups)}"
        raise QueryError(f"groups must be an integer for each of the {count} faces, not {given}")
    if count and not -1 <= labels.min() <= labels.max() < count:
        raise QueryError(f"groups must be numbers from -1 to {count - 1}, not {labels.min()} to {labels.max()}")
    return np.ascontiguousarray(labels, np.int32)
