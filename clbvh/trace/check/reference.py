"""The oracle: every primitive of every visible instance against every ray, in float64, on the host.

It shares no code with the device. Slow on purpose; `--validate` and the tests compare with it. It says whether an
answer is right, because a ray that passes an edge closer than float32 resolves has no single right answer; and where
there is one, it has the answer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...geometry.mesh import Mesh
from ...scene.state import SceneState
from ...structs import NO_PRIM
from .instances import Instance, Tolerance, find_instances, world_radius
from .intersections import ORACLE, Intersections, Rays, find_intersections

# Of u + v, in float64 and in float32.
_MOST_UV = 1.0 + 2.0**-20

# Of the point where a ray crosses a plane, as a share of its distance, for a ray at right angles to it: even float64
# cannot tell where a ray crosses a plane that it lies in.
_FLOAT64_SLACK = 2.0**-44


class ReferenceHits(NamedTuple):
    """The nearest intersection of each ray.

    Attributes
    ----------
    t : (n,) float64
        Infinite on a miss.
    instance_id, geometry_id, prim_id : (n,) int64
        -1 on a miss.
    is_decided : (n,) bool
        Whether no other answer can be right.
    """

    t: NDArray[np.float64]
    instance_id: NDArray[np.int64]
    geometry_id: NDArray[np.int64]
    prim_id: NDArray[np.int64]
    is_decided: NDArray[np.bool_]


@dataclass(frozen=True)
class Difference:
    """A ray whose answer is wrong.

    Attributes
    ----------
    ray : int
    reason : str
    obtained, expected : tuple of float, int, int
        t, instance and primitive of the traversal, and of the nearest intersection that is sure; infinite, -1 and -1 if
        there is none.
    """

    ray: int
    reason: str
    obtained: tuple[float, int, int]
    expected: tuple[float, int, int]

    def __str__(self) -> str:
        obtained, expected = (
            f"t = {t:.9g} on primitive {prim_id} of instance {instance_id}"
            for t, instance_id, prim_id in (self.obtained, self.expected)
        )
        return f"ray {self.ray}: obtained {obtained}, expected {expected}: {self.reason}"


# Why an answer is wrong, by the numbers of cl/host/check/oracle.cl.
_RIGHT, _MISSED, _NOT_THERE, _BEHIND, _TWIN, _MISS_WITH_T, _BESIDE, _GEOMETRY = range(8)
_REASONS = {
    _MISSED: "a primitive is surely hit",
    _NOT_THERE: "the ray does not cross this primitive at this t",
    _BEHIND: "another primitive is surely hit before it",
    _TWIN: "an equal primitive in the same place has smaller ids",
    _MISS_WITH_T: "a miss has no t and no ids",
    _BESIDE: "u and v name a point that is not on the ray, or not in the primitive",
    _GEOMETRY: "this is not the geometry of the instance",
}


class Reference:
    """Answers about one world, by every primitive.

    Parameters
    ----------
    world : SceneState
    tolerance : Tolerance, optional
        How far the device may be off.
    """

    def __init__(self, world: SceneState, tolerance: Tolerance | None = None) -> None:
        self._world = world
        self._tolerance = tolerance or Tolerance()
        self._instances = find_instances(world)

    def intersections(self, rays: Rays) -> Intersections:
        """Return every intersection that there can be."""
        return find_intersections(self._world, rays, self._tolerance, self._instances)

    def closest_hit(self, rays: Rays, intersections: Intersections | None = None) -> ReferenceHits:
        """Return the nearest sure intersection of each ray; at equal t that of the smaller (instance, primitive).

        Parameters
        ----------
        rays : Rays
        intersections : Intersections, optional
            Of these rays, if they are known already.
        """
        known = self.intersections(rays) if intersections is None else intersections
        first, is_decided = np.empty(len(rays.t_min), np.int64), np.empty(len(rays.t_min), np.bool_)
        ORACLE.find_closest(known.words, first, is_decided, known.offsets)
        ids = np.full((3, len(first)), NO_PRIM, np.int64)
        hits = ReferenceHits._make((np.full(len(first), np.inf), *ids, is_decided))
        for name in hits._fields[:-1]:
            getattr(hits, name)[first >= 0] = known.found[name][first[first >= 0]]
        return hits

    def count_range(self, rays: Rays) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the least and the greatest number of hits that each ray can have, (n,) int64 each.

        A query for any hit is right if it is true where the least is above 0, and false where the greatest is 0.
        """
        known = self.intersections(rays)
        return known.sure_counts, np.diff(known.offsets)

    def find_differences(self, rays: Rays, hits: Any, intersections: Intersections | None = None) -> list[Difference]:
        """Return the rays whose closest hit cannot be right.

        Parameters
        ----------
        rays : Rays
        hits : Hits
            The answers of a traversal for these rays, with their ids.
        intersections : Intersections, optional
            Of these rays, if they are known already.

        Returns
        -------
        list of Difference
            A hit is right when its primitive is hit, or too close to call, at that t; u and v name a point of it on the
            ray; and no primitive is surely hit before it, nor a twin of it has smaller ids. A miss is right when no
            primitive is surely hit.
        """
        known = self.intersections(rays) if intersections is None else intersections
        t, instance, prim = read_ids(hits)
        reasons, meant = np.empty(len(t), np.int64), np.full(len(t), -1, np.int64)
        ORACLE.check_hits(known.words, rays.t_min, rays.t_max, t, instance, prim, reasons, meant, known.offsets)
        is_hit = np.flatnonzero((reasons == _RIGHT) & (prim != NO_PRIM))
        reasons[is_hit] = self.check_points(rays, hits, known, is_hit, meant[is_hit])
        miss_ids = np.stack([np.asarray(ids).reshape(-1) for ids in (hits.instance_id, hits.geometry_id)])
        reasons[(prim == NO_PRIM) & (miss_ids != NO_PRIM).any(axis=0)] = _MISS_WITH_T
        expected = self.closest_hit(rays, known)
        return [
            Difference(
                int(ray), _REASONS[int(reasons[ray])], (float(t[ray]), int(instance[ray]), int(prim[ray])),
                (float(expected.t[ray]), int(expected.instance_id[ray]), int(expected.prim_id[ray])),
            )
            for ray in np.flatnonzero(reasons != _RIGHT)
        ]  # fmt: skip

    def check_points(
        self, rays: Rays, hits: Any, known: Intersections, indices: NDArray[np.int64], meant: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Return what is wrong with u and v of hits by their indices, whose ids and t are right; 0 is nothing.

        They must name the point of the primitive that is nearest to the ray, about where the intersection is that is
        meant.
        """
        reasons = np.full(len(indices), _RIGHT, np.int64)
        geometry_ids, u, v = (np.asarray(values).reshape(-1)[indices] for values in (hits.geometry_id, hits.u, hits.v))
        is_refined, size = np.asarray(hits.t).dtype == np.float64, world_radius(self._instances)
        instance_ids = known.found["instance_id"][meant]
        for instance_id in np.unique(instance_ids).tolist():
            instance, mine = self._instances[instance_id], np.flatnonzero(instance_ids == instance_id)
            chosen = known.found[meant[mine]]
            ray_ids, prims = chosen["ray"], chosen["prim_id"]
            origins = instance.to_unit(rays.origins[ray_ids])
            directions = rays.directions[ray_ids] / rays.lengths[ray_ids, None]
            distances = np.linalg.norm(origins, axis=1)
            blurs = np.empty(len(distances))
            ORACLE.find_blurs(instance.view(self._tolerance, size), distances, blurs)
            points, is_inside = _find_points(instance, prims, u[mine].astype(np.float64), v[mine].astype(np.float64))
            slack = 2.0 * blurs
            if isinstance(instance.shape, Mesh):
                growth, angle = _see_triangles(instance, prims, origins, directions)
                # In its plane, a triangle has any slack.
                with np.errstate(over="ignore"):
                    slack = (slack + _FLOAT64_SLACK * distances / angle) * (1.0 if is_refined else growth)
            else:
                slack = slack * np.linalg.norm(instance.to_world, 2) * instance.local_growth
            ways = points - origins
            along = _dot(ways, directions)
            beside = np.linalg.norm(ways - along[:, None] * directions, axis=1)
            low, high = (chosen[name] * (rays.lengths[ray_ids] / instance.unit) for name in ("t_low", "t_high"))
            is_right = is_inside & (beside <= slack) & (along >= low - slack) & (along <= high + slack)
            reasons[mine[~is_right]] = _BESIDE
            reasons[mine[geometry_ids[mine] != instance.geometry_id]] = _GEOMETRY
        return reasons


def read_ids(hits: Any) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Return t, the instances and the primitives of hits, (n,) each."""
    return (
        np.ascontiguousarray(hits.t, np.float64).reshape(-1),
        np.ascontiguousarray(hits.instance_id, np.int64).reshape(-1),
        np.ascontiguousarray(hits.prim_id, np.int64).reshape(-1),
    )


def _find_corners(instance: Instance, prims: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return (n, 3, 3) float64: the corners of triangles, in the instance's unit."""
    assert isinstance(instance.shape, Mesh)
    return (instance.shape.local_vertices.astype(np.float64) @ instance.to_world.T)[instance.shape.faces[prims]]


def _find_points(
    instance: Instance, prims: NDArray[np.int64], u: NDArray[np.float64], v: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the points (u, v) of primitives in the instance's unit, and whether they are in the primitives."""
    shape = instance.shape
    if isinstance(shape, Mesh):
        weights = np.stack((1.0 - u - v, u, v), axis=1)
        points = np.einsum("ni,nij->nj", weights, _find_corners(instance, prims))
        return points, (u >= 0.0) & (v >= 0.0) & (u + v <= _MOST_UV)
    # u is the azimuth in turns, v the angle from the z axis in half turns.
    azimuth, polar = 2.0 * np.pi * u, np.pi * v
    normals = np.stack((np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)), axis=1)
    radii = shape.local_radii.astype(np.float64)[prims, None]
    points = (shape.local_centres.astype(np.float64)[prims] + radii * normals) @ instance.to_world.T
    return points, (u >= 0.0) & (u < 1.0) & (v >= 0.0) & (v <= 1.0)


def _see_triangles(
    instance: Instance, prims: NDArray[np.int64], origins: NDArray[np.float64], directions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how the device's own u and v magnify the blur, and the sine of the angle between ray and triangle.

    A blurred corner changes the area opposite it by the blur times an edge, and so the weight of another corner.
    """
    corners = _find_corners(instance, prims)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.maximum(np.abs(_dot(normals, directions)), np.finfo(np.float64).tiny)
    ways = corners - origins[:, None]
    across = ways - np.einsum("nij,nj->ni", ways, directions)[..., None] * directions[:, None]
    reaches = np.linalg.norm(across, axis=2).sum(axis=1)
    longest = np.linalg.norm(across - np.roll(across, 1, axis=1), axis=2).max(axis=1)
    return 1.0 + longest * reaches / areas, areas / np.linalg.norm(normals, axis=1)


def _dot(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.einsum("ni,ni->n", one, other)
