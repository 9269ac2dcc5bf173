"""Collisions and distances of meshes of trimesh: `trimesh.collision.CollisionManager` without python-fcl."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...scene.transforms import check_transform
from ...support.forks import make_lock
from ...trace.clearance.walk import HostTrees
from ...trace.world.surface_arrays import SurfaceArrays, make_surface_arrays, move_instances
from .bodies import Body, CollisionGeometry, Group

# The name of a mesh that no manager has, as trimesh calls it.
_EXTERNAL = "__external"


class CollisionManager:
    """Meshes with names that are tested for collisions: the methods and results of `trimesh.collision`.

    A mesh that is closed, of one piece and convex is solid, any other is its surface, as in trimesh: bodies collide
    where surfaces have a common point, and where a solid is around a piece of another body. Touching counts, exactly,
    and no tolerance is added.

    Meshes are read when they are added: one that changes later is added again. Any number of threads may ask; changes
    come before or after.

    Notes
    -----
    The host builds and walks a tree for each mesh that comes near another one; identical meshes share it. See
    `Tracer.collisions`. Depths are those of solids that overlap, by a hull of their differences (van den Bergen,
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
        self._bodies: dict[Any, Body] = {}
        # By geometry id: those of the bodies of the last query, and of others before it; their arrays and trees.
        self._geometries: list[CollisionGeometry] = []
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
        body = Body.read(mesh, transform)
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
        group = self._gather({_EXTERNAL: Body.read(mesh, transform)})
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
        group = self._gather({_EXTERNAL: Body.read(mesh, transform)})
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

    def _find(self, name: Any) -> Body:
        try:
            return self._bodies[name]
        except KeyError:
            raise ValueError(f"{name} not in collision manager!") from None

    def _gather(self, others: dict[Any, Body] | None = None, without: tuple[Any, ...] = ()) -> Group:
        """Return the bodies of a query."""
        placed = [each for each in list(self._bodies.items()) if each[0] not in without]
        tested = list((others or {}).items())
        names, bodies = [name for name, _ in placed + tested], [body for _, body in placed + tested]
        with self._lock:
            arrays = self._find_arrays([body.geometry for body in bodies])
            shapes = tuple(geometry.mesh for geometry in self._geometries)
        moved = move_instances(arrays, np.array([body.transform for body in bodies]).reshape(-1, 4, 4))
        return Group(names, bodies, len(placed), others is None, shapes, moved, self._trees)

    def _find_arrays(self, geometries: list[CollisionGeometry]) -> SurfaceArrays:
        """Return the arrays of bodies, not yet placed; a new geometry takes the id of one that is not asked for."""
        numbers, wanted = (
            {geometry: number for number, geometry in enumerate(self._geometries)},
            dict.fromkeys(geometries),
        )
        free = [number for geometry, number in numbers.items() if geometry not in wanted]
        for geometry in wanted:
            if geometry not in numbers:
                self._arrays = None
                number = numbers[geometry] = free.pop() if free else len(self._geometries)
                self._geometries[number : number + 1] = [geometry]
        if self._arrays is None:
            shapes, own = (
                [geometry.mesh for geometry in self._geometries],
                np.arange(len(self._geometries), dtype=np.int32),
            )
            self._arrays = make_surface_arrays(shapes, own, np.tile(np.eye(4), (len(own), 1, 1)))
        return self._arrays._replace(geometry_id=np.array([numbers[geometry] for geometry in geometries], np.int32))


def _first(names: list[Any]) -> Any:
    return names[0]


def _sort(names: list[Any]) -> tuple[Any, ...]:
    return tuple(sorted(names))


def _tell_collisions(group: Group, name: Callable[[list[Any]], Any], return_names: bool, return_data: bool) -> Any:
    """Return what a method of `CollisionManager` returns, by its name of the names of a pair."""
    collisions = group.find_collisions(needs_all=return_names or return_data)
    answer: list[Any] = [bool(collisions)]
    if return_names:
        answer.append({name(group.names_of(collision.bodies)) for collision in collisions})
    if return_data:
        contacts = filter(None, map(group.measure, collisions))
        answer.append([contact.as_contact(group.names_of(contact.bodies)) for contact in contacts])
    return tuple(answer) if len(answer) > 1 else answer[0]


def _tell_distance(group: Group, name: Callable[[list[Any]], Any], return_names: bool, return_data: bool) -> Any:
    """Return what a method of `CollisionManager` returns, by its name of the names of a pair."""
    nearest = group.find_nearest()
    answer: list[Any] = [np.inf if nearest is None else nearest.distance]
    if return_names:
        answer.append(None if nearest is None else name(group.names_of(nearest.bodies)))
    if return_data:
        answer.append(None if nearest is None else nearest.as_distance(group.names_of(nearest.bodies)))
    return tuple(answer) if len(answer) > 1 else answer[0]
