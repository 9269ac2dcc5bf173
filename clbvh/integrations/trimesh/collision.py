"""Collisions and distances of meshes of trimesh: `trimesh.collision.CollisionManager` without python-fcl.

How the nearest triangles are found is in clbvh/trace/clearance.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from types import SimpleNamespace
from typing import Any, NamedTuple
from weakref import WeakValueDictionary

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from trimesh.collision import ContactData, DistanceData

from ...geometry import Mesh
from ...scene.transforms import check_transform
from ...structs import NO_PRIM
from ...support.forks import make_lock
from ...support.host_threads import HostThreads
from ...trace.clearance.depth import measure_overlap
from ...trace.clearance.triangles import TOUCH
from ...trace.clearance.walk import HostTrees, PairSearch, find_overlaps
from ...trace.world.surface_arrays import SurfaceArrays, make_surface_arrays, move_instances
from ...trace.world.top_tree import find_boxes
from .tracers import read_mesh

# The name of a mesh that no manager has, as trimesh calls it.
_EXTERNAL = "__external"

_NO_PRIMS = np.full(2, NO_PRIM, np.int32)


class _Form:
    """A mesh as it was when it was read: objects that are alike share it."""

    def __init__(self, mesh: Any) -> None:
        self.mesh = Mesh.from_arrays(mesh.vertices, mesh.faces)
        # `mesh.is_convex` needs scipy or networkx to count the pieces. Each convex one adds 2 to the Euler number.
        self.is_solid = bool(
            mesh.is_watertight
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
        """A vertex of each piece, (n, 3): pieces have no vertex in common."""
        lowest = np.arange(len(self.mesh.vertices))
        while True:
            before = lowest.copy()
            np.minimum.at(lowest, self.faces, lowest[self.faces].min(axis=1, keepdims=True))
            lowest = lowest[lowest]
            if (lowest == before).all():
                return self.mesh.vertices[np.unique(lowest[self.faces])]

    def is_around(self, point: NDArray[np.float64]) -> bool:
        """Return whether a solid is around a point: by the angle that it fills there, which slivers do not change."""
        a, b, c = (self.mesh.vertices[self.faces] - point).swapaxes(0, 1)
        ab, bc, ca = ((one * other).sum(axis=1) for one, other in ((a, b), (b, c), (c, a)))
        la, lb, lc = (np.linalg.norm(each, axis=1) for each in (a, b, c))
        # Half the angle of each face (van Oosterom and Strackee, "The solid angle of a plane triangle", 1983).
        halves = np.arctan2((a * np.cross(b, c)).sum(axis=1), la * lb * lc + ab * lc + bc * la + ca * lb)
        return bool(abs(halves.sum()) > np.pi)


# By trimesh's hash of vertices and faces.
_forms: WeakValueDictionary[int, _Form] = WeakValueDictionary()


class _Body(NamedTuple):
    """An object: its form, and the transform that places it in the world."""

    form: _Form
    transform: NDArray[np.float64]

    @classmethod
    def read(cls, mesh: Any, transform: ArrayLike | None) -> _Body:
        mesh, matrix = read_mesh(mesh), check_transform(transform)
        key = hash(mesh)
        form = _forms.get(key)
        if form is None:
            form = _forms[key] = _Form(mesh)
        return cls(form, matrix)

    def place(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points of the form in the world."""
        return points @ self.transform[:3, :3].T + self.transform[:3, 3]

    def find_inside(self, other: _Body) -> NDArray[np.float64] | None:
        """Return a point of another body inside of this solid one, if there is one; their surfaces do not touch."""
        placed = other.place(other.form.pieces)
        points = np.linalg.solve(self.transform[:3, :3], (placed - self.transform[:3, 3]).T).T
        lower, upper = self.form.corners.min(axis=0), self.form.corners.max(axis=0)
        for number in np.flatnonzero(((points >= lower) & (points <= upper)).all(axis=1)):
            if self.form.is_around(points[number]):
                return placed[number]
        return None


class _Contact(NamedTuple):
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


class _Collision(NamedTuple):
    """A pair that collides: its search, its number there, and the faces that touch, `NO_PRIM` if none do."""

    search: PairSearch
    pair: int
    prim_ids: NDArray[np.int32]

    @property
    def bodies(self) -> NDArray[np.int64]:
        """The numbers of the bodies, (2,)."""
        return self.search.pairs[self.pair]


class _Group(NamedTuple):
    """The bodies of one query: those of a manager, and behind them the others that they are tested against.

    Attributes
    ----------
    names : list
    bodies : list of _Body
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
    bodies: list[_Body]
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

    def find_collisions(self, *, needs_all: bool = True) -> list[_Collision]:
        """Return the pairs that collide, or only the first one that is found."""
        lower, upper = self.boxes
        search = self.open_search(find_overlaps(lower, upper))
        if search is None:
            return []
        if not needs_all and (first := search.find_one(TOUCH)) is not None:
            return [_Collision(search, *first)]
        with HostThreads() as threads:
            prim_ids = search.find_touches(threads).prim_ids
        is_colliding = prim_ids[:, 0] != NO_PRIM
        # What does not touch collides where a solid body is around a piece of the other.
        for pair in np.flatnonzero(~is_colliding):
            is_colliding[pair] = self.find_inside(search.pairs[pair]) is not None
        return [_Collision(search, int(pair), prim_ids[pair]) for pair in np.flatnonzero(is_colliding)]

    def find_inside(self, pair: NDArray[np.int64]) -> NDArray[np.float64] | None:
        """Return a point of a body inside of the other one of a pair, if that is solid and there is one."""
        one, other = (self.bodies[number] for number in pair)
        point = one.find_inside(other) if one.form.is_solid else None
        return other.find_inside(one) if point is None and other.form.is_solid else point

    def measure(self, collision: _Collision, least: float = -1.0) -> _Contact | None:
        """Return how deep two bodies are in each other, or where they touch; None unless deeper than the least."""
        search, pair, prim_ids = collision
        bodies = search.pairs[pair]
        one, other = (self.bodies[number] for number in bodies)
        if one.form.is_solid and other.form.is_solid:
            overlap = measure_overlap(one.place(one.form.corners), other.place(other.form.corners), least)
            if overlap is None:
                return None
            return _Contact(bodies, 0.0 - overlap.depth, overlap.points, normal=overlap.normal)
        if least >= 0:
            return None
        if prim_ids[0] != NO_PRIM:
            return _Contact(bodies, 0.0, search.measure_pair(pair, prim_ids).points, prim_ids)
        return _Contact(bodies, 0.0, np.array([self.find_inside(bodies)] * 2))

    def find_nearest(self) -> _Contact | None:
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

    def measure_nearest(self, pairs: NDArray[np.int64]) -> _Contact | None:
        """Return where the nearest of some pairs are nearest, of those that the query is about."""
        search = self.open_search(pairs)
        found = None if search is None else search.find_nearest(np.inf)
        if search is None or found is None:
            return None
        return _Contact(search.pairs[found.pair], found.distance, found.points, found.prim_ids)


class CollisionManager:
    """Meshes with names that are tested for collisions: the methods and results of `trimesh.collision`.

    A mesh that is closed, of one piece and convex is solid, any other is its surface, as in trimesh: bodies collide
    where surfaces have a common point, and where a solid is around a piece of another body. Touching counts, exactly,
    and no tolerance is added.

    Meshes are read when they are added: one that changes later is added again. Any number of threads may ask; changes
    come before or after.

    Notes
    -----
    The host builds a tree for each mesh that comes near another one, once for meshes that are alike, and walks them;
    see `Tracer.collisions`. Depths are those of solids that overlap, by a hull of their differences (van den Bergen,
    "Proximity queries and penetration depth computation on 3D game objects", 2001), and need SciPy.

    Unlike trimesh with python-fcl: solids whose faces just touch collide; each pair has one contact; where it has no
    depth, the surfaces crossing, `depth` and `normal` are NaN; transforms may scale and mirror.

    Examples
    --------
    >>> import trimesh
    >>> from clbvh.integrations.trimesh import CollisionManager
    >>> manager, box = CollisionManager(), trimesh.creation.box()
    >>> for x in (0, 0.75, 3):
    ...     manager.add_object(f"box at {x}", box, trimesh.transformations.translation_matrix([x, 0, 0]))
    >>> manager.in_collision_internal(return_names=True)
    (True, {('box at 0', 'box at 0.75')})
    >>> manager.remove_object("box at 0")
    >>> manager.min_distance_internal(return_names=True)
    (1.25, ('box at 0.75', 'box at 3'))
    """

    def __init__(self) -> None:
        self._lock = make_lock()
        self._bodies: dict[Any, _Body] = {}
        # By geometry id: those of the bodies of the last query, and of others before it; their arrays and trees.
        self._forms: list[_Form] = []
        self._arrays: SurfaceArrays | None = None
        self._trees = HostTrees()

    def add_object(self, name: Any, mesh: Any, transform: ArrayLike | None = None) -> None:
        """Add a mesh, or put it in the place of the one with this name.

        Parameters
        ----------
        name : any
            Hashable; pairs of names are sorted.
        mesh : trimesh.Trimesh, or what `clbvh.build` takes
        transform : (4, 4) float, optional
            Where it is; in its own place without one.

        Raises
        ------
        MeshError, SceneError
            The mesh has no faces or the matrix no inverse; both are a `ValueError`.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import CollisionManager
        >>> manager = CollisionManager()
        >>> manager.add_object("crate", trimesh.creation.box())
        >>> manager.in_collision_single(trimesh.creation.icosphere())
        True
        """
        body = _Body.read(mesh, transform)
        with self._lock:
            self._bodies[name] = body

    def remove_object(self, name: Any) -> None:
        """Remove a mesh by its name; `ValueError` if there is none.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import CollisionManager
        >>> manager = CollisionManager()
        >>> manager.add_object("crate", trimesh.creation.box())
        >>> manager.remove_object("crate")
        >>> manager.in_collision_single(trimesh.creation.icosphere())
        False
        """
        with self._lock:
            self._find(name)
            del self._bodies[name]

    def set_transform(self, name: Any, transform: ArrayLike) -> None:
        """Move a mesh; arguments and errors are those of `add_object`, and `ValueError` for an unknown name.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import CollisionManager
        >>> manager = CollisionManager()
        >>> manager.add_object("crate", trimesh.creation.box())
        >>> manager.set_transform("crate", trimesh.transformations.translation_matrix([2, 0, 0]))
        >>> manager.min_distance_single(trimesh.creation.box())
        1.0
        """
        matrix = check_transform(transform)
        with self._lock:
            self._bodies[name] = self._find(name)._replace(transform=matrix)

    def in_collision_single(
        self, mesh: Any, transform: ArrayLike | None = None, return_names: bool = False, return_data: bool = False
    ) -> Any:
        """Test one mesh against all of the manager.

        Parameters
        ----------
        mesh : trimesh.Trimesh, or what `clbvh.build` takes
        transform : (4, 4) float, optional
        return_names, return_data : bool

        Returns
        -------
        is_collision : bool
        names : set
            Of the meshes that the one collides with; if asked for.
        contacts : list of trimesh.collision.ContactData
            One for each of them, if asked for; the mesh is ``"__external"``.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import CollisionManager
        >>> manager = CollisionManager()
        >>> manager.add_object("crate", trimesh.creation.box())
        >>> move = trimesh.transformations.translation_matrix([0.75, 0, 0])
        >>> _, names, contacts = manager.in_collision_single(trimesh.creation.box(), move, True, True)
        >>> names, contacts[0].depth, contacts[0].normal
        ({'crate'}, 0.25, array([1., 0., 0.]))
        """
        group = self._gather({_EXTERNAL: _Body.read(mesh, transform)})
        return _tell_collisions(group, _first, return_names, return_data)

    def in_collision_internal(self, return_names: bool = False, return_data: bool = False) -> Any:
        """Test the meshes of the manager against each other; see `in_collision_single`. Names are sorted pairs.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import CollisionManager
        >>> manager = CollisionManager()
        >>> for name in ("left", "right"):
        ...     manager.add_object(name, trimesh.creation.torus(1.0, 0.3))
        >>> manager.in_collision_internal(return_names=True)
        (True, {('left', 'right')})
        """
        return _tell_collisions(self._gather(), _sort, return_names, return_data)

    def in_collision_other(
        self, other_manager: CollisionManager, return_names: bool = False, return_data: bool = False
    ) -> Any:
        """Test the meshes of two managers; see `in_collision_single`. Names are pairs, this manager's first.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import CollisionManager
        >>> robot, room = CollisionManager(), CollisionManager()
        >>> robot.add_object("hand", trimesh.creation.icosphere())
        >>> room.add_object("table", trimesh.creation.box())
        >>> robot.in_collision_other(room, return_names=True)
        (True, {('hand', 'table')})
        """
        return _tell_collisions(self._gather(other_manager._bodies), tuple, return_names, return_data)

    def min_distance_single(
        self, mesh: Any, transform: ArrayLike | None = None, return_name: bool = False, return_data: bool = False
    ) -> Any:
        """Return the distance from one mesh to the nearest of the manager.

        Parameters
        ----------
        mesh : trimesh.Trimesh, or what `clbvh.build` takes
        transform : (4, 4) float, optional
        return_name, return_data : bool

        Returns
        -------
        distance : float
            Minus the greatest depth, where solids overlap; else 0 where anything collides; infinite without a pair.
        name : any
            Of the nearest mesh, if asked for.
        data : trimesh.collision.DistanceData
            If asked for; the mesh is ``"__external"``. None without a pair, as is the name.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import CollisionManager
        >>> manager = CollisionManager()
        >>> manager.add_object("crate", trimesh.creation.box())
        >>> move = trimesh.transformations.translation_matrix([3, 0, 0])
        >>> manager.min_distance_single(trimesh.creation.box(), move, return_name=True)
        (2.0, 'crate')
        """
        group = self._gather({_EXTERNAL: _Body.read(mesh, transform)})
        return _tell_distance(group, _first, return_name, return_data)

    def min_distance_internal(self, name: Any = None, return_names: bool = False, return_data: bool = False) -> Any:
        """Return the least distance of two meshes of the manager, or of one of them, by its name, from the others.

        See `min_distance_single`; names are a sorted pair, and an unknown one is a `ValueError`.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import CollisionManager
        >>> manager = CollisionManager()
        >>> for x in (0, 2, 5):
        ...     move = trimesh.transformations.translation_matrix([x, 0, 0])
        ...     manager.add_object(f"at {x}", trimesh.creation.box(), move)
        >>> manager.min_distance_internal(), manager.min_distance_internal("at 5", return_names=True)
        (1.0, (2.0, ('at 2', 'at 5')))
        """
        group = self._gather() if name is None else self._gather({name: self._find(name)}, without=(name,))
        return _tell_distance(group, _sort, return_names, return_data)

    def min_distance_other(
        self, other_manager: CollisionManager, return_names: bool = False, return_data: bool = False
    ) -> Any:
        """Return the least distance of a mesh of this manager and one of another; names are a pair, this one's first.

        See `min_distance_single`.

        Examples
        --------
        >>> import trimesh
        >>> from clbvh.integrations.trimesh import CollisionManager
        >>> robot, room = CollisionManager(), CollisionManager()
        >>> robot.add_object("hand", trimesh.creation.box())
        >>> room.add_object("table", trimesh.creation.box(), trimesh.transformations.translation_matrix([3, 0, 0]))
        >>> robot.min_distance_other(room)
        2.0
        """
        return _tell_distance(self._gather(other_manager._bodies), tuple, return_names, return_data)

    def _find(self, name: Any) -> _Body:
        try:
            return self._bodies[name]
        except KeyError:
            raise ValueError(f"{name} not in collision manager!") from None

    def _gather(self, others: dict[Any, _Body] | None = None, without: tuple[Any, ...] = ()) -> _Group:
        """Return the bodies of a query."""
        placed = [each for each in list(self._bodies.items()) if each[0] not in without]
        tested = list((others or {}).items())
        names, bodies = [name for name, _ in placed + tested], [body for _, body in placed + tested]
        with self._lock:
            arrays = self._find_arrays([body.form for body in bodies])
            shapes = tuple(form.mesh for form in self._forms)
        moved = move_instances(arrays, np.array([body.transform for body in bodies]).reshape(-1, 4, 4))
        return _Group(names, bodies, len(placed), others is None, shapes, moved, self._trees)

    def _find_arrays(self, forms: list[_Form]) -> SurfaceArrays:
        """Return the arrays of bodies, not yet placed; a new form takes the id of one that is not asked for."""
        numbers, wanted = {form: number for number, form in enumerate(self._forms)}, dict.fromkeys(forms)
        free = [number for form, number in numbers.items() if form not in wanted]
        for form in wanted:
            if form not in numbers:
                self._arrays = None
                if not free:
                    free.append(len(self._forms))
                    self._forms.append(form)
                numbers[form] = free.pop()
                self._forms[numbers[form]] = form
        if self._arrays is None:
            shapes, own = [form.mesh for form in self._forms], np.arange(len(self._forms), dtype=np.int32)
            self._arrays = make_surface_arrays(shapes, own, np.tile(np.eye(4), (len(own), 1, 1)))
        return self._arrays._replace(geometry_id=np.array([numbers[form] for form in forms], np.int32))


def _first(names: list[Any]) -> Any:
    return names[0]


def _sort(names: list[Any]) -> tuple[Any, ...]:
    return tuple(sorted(names))


def _tell_collisions(group: _Group, name: Callable[[list[Any]], Any], return_names: bool, return_data: bool) -> Any:
    """Return what a method of `CollisionManager` returns, by its name of the names of a pair."""
    collisions = group.find_collisions(needs_all=return_names or return_data)
    answer: list[Any] = [bool(collisions)]
    if return_names:
        answer.append({name(group.names_of(collision.bodies)) for collision in collisions})
    if return_data:
        contacts = filter(None, map(group.measure, collisions))
        answer.append([contact.as_contact(group.names_of(contact.bodies)) for contact in contacts])
    return tuple(answer) if len(answer) > 1 else answer[0]


def _tell_distance(group: _Group, name: Callable[[list[Any]], Any], return_names: bool, return_data: bool) -> Any:
    """Return what a method of `CollisionManager` returns, by its name of the names of a pair."""
    nearest = group.find_nearest()
    answer: list[Any] = [np.inf if nearest is None else nearest.distance]
    if return_names:
        answer.append(None if nearest is None else name(group.names_of(nearest.bodies)))
    if return_data:
        answer.append(None if nearest is None else nearest.as_distance(group.names_of(nearest.bodies)))
    return tuple(answer) if len(answer) > 1 else answer[0]
