"""What a manager of collisions asks about: bodies, which pairs of them collide, how deep, and which are nearest.

How the nearest triangles are found is in clbvh/trace/clearance.
"""

from __future__ import annotations

from functools import cached_property
from types import SimpleNamespace
from typing import Any, NamedTuple
from weakref import WeakValueDictionary

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from trimesh.collision import ContactData, DistanceData

from ...geometry import Mesh
from ...geometry.topology import find_points
from ...scene.transforms import check_transform
from ...structs import NO_PRIM
from ...support.host_threads import HostThreads
from ...trace.clearance.depth import measure_overlap
from ...trace.clearance.triangles import TOUCH
from ...trace.clearance.walk import HostTrees, PairSearch, find_overlaps
from ...trace.world.surface_arrays import SurfaceArrays
from ...trace.world.top_tree import find_boxes
from .tracers import read_mesh

_NO_PRIMS = np.full(2, NO_PRIM, np.int32)


class CollisionGeometry:
    """A mesh as it was when it was read, which the bodies of identical meshes share."""

    def __init__(self, mesh: Any) -> None:
        self.mesh = Mesh.from_arrays(mesh.vertices, mesh.faces)
        # `mesh.is_convex` needs scipy or networkx to count the pieces. Each convex one adds 2 to the Euler number.
        self.is_solid = bool(
            len(self.faces)
            and mesh.is_watertight
            and mesh.euler_number == 2
            and mesh.face_adjacency_projections.max(initial=-np.inf) < trimesh.tol.planar * mesh.scale
        )

    @cached_property
    def faces(self) -> NDArray[np.int32]:
        """The faces that have an area, (n, 3): others count for nothing."""
        return self.mesh.faces[self.mesh.face_normals.any(axis=1)]

    @cached_property
    def corners(self) -> NDArray[np.float64]:
        """The vertices of the faces, (n, 3)."""
        return self.mesh.vertices[np.unique(self.faces)]

    @cached_property
    def pieces(self) -> NDArray[np.float64]:
        """A vertex of each connected component, (n, 3): of faces with equal vertices, shared or not."""
        points = find_points(self.mesh.vertices)
        faces, lowest = points.ids[self.faces], np.arange(len(points.first))
        while True:
            before, labels = lowest.copy(), lowest[faces]
            # Of the labels as well as of the points: else a label goes one face in a round.
            for numbers in (labels, faces):
                np.minimum.at(lowest, numbers, labels.min(axis=1, keepdims=True))
            lowest = lowest[lowest]
            if (lowest == before).all():
                return self.mesh.vertices[points.first[np.unique(lowest[faces])]]

    def is_around(self, point: NDArray[np.float64]) -> bool:
        """Return whether a solid is around a point: by the angle that it fills there, which slivers do not change."""
        a, b, c = (self.mesh.vertices[self.faces] - point).swapaxes(0, 1)
        ab, bc, ca = ((one * other).sum(axis=1) for one, other in ((a, b), (b, c), (c, a)))
        la, lb, lc = (np.linalg.norm(each, axis=1) for each in (a, b, c))
        # Half the angle of each face (van Oosterom and Strackee, "The solid angle of a plane triangle", 1983).
        halves = np.arctan2((a * np.cross(b, c)).sum(axis=1), la * lb * lc + ab * lc + bc * la + ca * lb)
        return bool(abs(halves.sum()) > np.pi)


# By trimesh's hash of vertices and faces.
_geometries: WeakValueDictionary[int, CollisionGeometry] = WeakValueDictionary()


class Body(NamedTuple):
    """An object: its geometry, and the transform that places it in the world."""

    geometry: CollisionGeometry
    transform: NDArray[np.float64]

    @classmethod
    def read(cls, mesh: Any, transform: ArrayLike | None) -> Body:
        """Read a mesh as it is now; arguments and errors are those of `CollisionManager.add_object`."""
        mesh, matrix = read_mesh(mesh), check_transform(transform)
        key = hash(mesh)
        geometry = _geometries.get(key)
        if geometry is None:
            geometry = _geometries[key] = CollisionGeometry(mesh)
        return cls(geometry, matrix)

    def place(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points of the geometry in the world."""
        return points @ self.transform[:3, :3].T + self.transform[:3, 3]

    def find_inside(self, other: Body) -> NDArray[np.float64] | None:
        """Return a point of another body inside of this solid one, if there is one; their surfaces do not touch."""
        placed = other.place(other.geometry.pieces)
        points = np.linalg.solve(self.transform[:3, :3], (placed - self.transform[:3, 3]).T).T
        corners = self.geometry.corners
        is_boxed = ((points >= corners.min(axis=0)) & (points <= corners.max(axis=0))).all(axis=1)
        inside = (placed[number] for number in np.flatnonzero(is_boxed) if self.geometry.is_around(points[number]))
        return next(inside, None)


class Contact(NamedTuple):
    """Where two bodies collide, or are nearest to each other.

    Attributes
    ----------
    bodies : (2,) int64
        Their numbers.
    distance : float
        Minus the depth of solid bodies that overlap; 0 of others that collide.
    points : (2, 3) float64
        One of either body.
    prim_ids : (2,) int32
        The faces that the points are on; `NO_PRIM` where no face was looked for.
    normal : (3,) float64
        From the first body to the second, along which these part; NaN where no depth is known.
    """

    bodies: NDArray[np.int64]
    distance: float
    points: NDArray[np.float64]
    prim_ids: NDArray[np.int32] = _NO_PRIMS
    normal: NDArray[np.float64] = np.full(3, np.nan)

    def as_contact(self, names: list[Any]) -> ContactData:
        """Return the contact as trimesh has it, with the names of the two bodies."""
        contact = SimpleNamespace(
            pos=self.points.mean(axis=0), normal=self.normal,
            # Of surfaces that cross none is known.
            penetration_depth=float("nan") if np.isnan(self.normal).any() else abs(self.distance),
            b1=int(self.prim_ids[0]), b2=int(self.prim_ids[1]),
        )  # fmt: skip
        return ContactData(names, contact)

    def as_distance(self, names: list[Any]) -> DistanceData:
        """Return the distance as trimesh has it, with the names of the two bodies."""
        distance = SimpleNamespace(
            min_distance=self.distance, nearest_points=self.points, b1=int(self.prim_ids[0]), b2=int(self.prim_ids[1])
        )
        return DistanceData(names, distance)


class Collision(NamedTuple):
    """A pair that collides: its search, its number there, and the faces that touch, `NO_PRIM` if none do."""

    search: PairSearch
    pair: int
    prim_ids: NDArray[np.int32]

    @property
    def bodies(self) -> NDArray[np.int64]:
        """The numbers of the bodies, (2,)."""
        return self.search.pairs[self.pair]


class Group(NamedTuple):
    """The bodies of one query: those of a manager, and behind them the others that they are tested against.

    Attributes
    ----------
    names : list
    bodies : list of Body
    own_count : int
        Of the manager's bodies.
    is_internal : bool
        Whether these are tested against each other.
    shapes : tuple of Mesh
        By geometry id.
    arrays : SurfaceArrays
    trees : HostTrees
        Of the shapes.
    """

    names: list[Any]
    bodies: list[Body]
    own_count: int
    is_internal: bool
    shapes: tuple[Mesh, ...]
    arrays: SurfaceArrays
    trees: HostTrees

    @property
    def boxes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The lower and the upper corners of the bodies' boxes, each (n, 3)."""
        return find_boxes(self.arrays) if self.bodies else (np.empty((0, 3)), np.empty((0, 3)))

    def names_of(self, bodies: NDArray[np.int64]) -> list[Any]:
        """Return the names of some bodies."""
        return [self.names[number] for number in bodies]

    def open_search(self, pairs: NDArray[np.int64]) -> PairSearch | None:
        """Return the search of those of some pairs that the query is about; None if there are none."""
        if not self.is_internal:
            pairs = pairs[(pairs[:, 0] < self.own_count) & (pairs[:, 1] >= self.own_count)]
        return PairSearch.open(self.shapes, self.arrays, self.trees, pairs) if len(pairs) else None

    def find_collisions(self, *, needs_all: bool = True) -> list[Collision]:
        """Return the pairs that collide, or only the first one that is found."""
        lower, upper = self.boxes
        search = self.open_search(find_overlaps(lower, upper))
        if search is None:
            return []
        if not needs_all and (first := search.find_one(TOUCH)) is not None:
            return [Collision(search, *first)]
        with HostThreads() as threads:
            prim_ids = search.find_touches(threads)
        is_colliding = prim_ids[:, 0] != NO_PRIM
        # What does not touch collides where a solid body is around a piece of the other.
        for pair in np.flatnonzero(~is_colliding):
            is_colliding[pair] = self.find_inside(search.pairs[pair]) is not None
        return [Collision(search, int(pair), prim_ids[pair]) for pair in np.flatnonzero(is_colliding)]

    def find_inside(self, pair: NDArray[np.int64]) -> NDArray[np.float64] | None:
        """Return a point of a body inside of the other one of a pair, if that is solid and there is one."""
        one, other = (self.bodies[number] for number in pair)
        point = one.find_inside(other) if one.geometry.is_solid else None
        return other.find_inside(one) if point is None and other.geometry.is_solid else point

    def measure(self, collision: Collision, least: float = -1.0) -> Contact | None:
        """Return how deep two bodies are in each other, or where they touch; None unless deeper than the least."""
        search, pair, prim_ids = collision
        bodies = search.pairs[pair]
        one, other = (self.bodies[number] for number in bodies)
        if one.geometry.is_solid and other.geometry.is_solid:
            overlap = measure_overlap(one.place(one.geometry.corners), other.place(other.geometry.corners), least)
            if overlap is None:
                return None
            return Contact(bodies, 0.0 - overlap.depth, overlap.points, normal=overlap.normal)
        if least >= 0:
            return None
        if prim_ids[0] != NO_PRIM:
            return Contact(bodies, 0.0, search.measure_pair(pair, prim_ids).points, prim_ids)
        return Contact(bodies, 0.0, np.array([self.find_inside(bodies)] * 2))

    def find_nearest(self) -> Contact | None:
        """Return where two bodies are nearest, or deepest in each other; None without a pair."""
        collisions = self.find_collisions()
        if collisions:
            deepest = None
            for collision in collisions:
                deepest = self.measure(collision, -1.0 if deepest is None else -deepest.distance) or deepest
            return deepest
        # Neighbours along an axis are near enough that few others can be nearer.
        lower, upper = self.boxes
        order = np.argsort(lower + upper, axis=0)
        near = self.measure_nearest(np.sort(np.stack((order[:-1], order[1:]), axis=-1).reshape(-1, 2), axis=1))
        reach = np.inf if near is None else near.distance
        # Of two groups, the others reach that far alone.
        grown = slice(0 if self.is_internal else self.own_count, None)
        lower[grown] -= reach / 2.0 if self.is_internal else reach
        upper[grown] += reach / 2.0 if self.is_internal else reach
        return self.measure_nearest(find_overlaps(lower, upper)) or near

    def measure_nearest(self, pairs: NDArray[np.int64]) -> Contact | None:
        """Return where the nearest of some pairs are nearest, of those that the query is about."""
        search = self.open_search(pairs)
        found = None if search is None else search.find_nearest(np.inf)
        if search is None or found is None:
            return None
        return Contact(search.pairs[found.pair], found.distance, found.points, found.prim_ids)
