"""The queries of a tracer about pairs of instances: their arguments, results and errors.

How the nearest triangles are found is in `clearance/`.
"""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError, QueryError
from ..geometry import Mesh
from ..scene.handles import Instances
from ..structs import NO_PRIM
from .clearance.triangles import TOUCH
from .clearance.walk import PAIR_BYTES, HostTrees, PairSearch, find_overlaps
from .launch import HasCaster
from .rays.batch import check_room
from .world.top_tree import find_boxes
from .world.world import World


@dataclass(frozen=True, eq=False)
class ClosestPair:
    """Where two instances are nearest to each other.

    Attributes
    ----------
    distance : float
        The scene's units; 0 where triangles touch or cross, infinite where nothing is near enough.
    points : (2, 3) float64, the scene's coordinates
        A closest point of either; equal where they touch. NaN where nothing is near enough.
    prim_ids : (2,) int32
        The triangles that the points are on, -1 where there are none.
    instance_ids : (2,) int32
        Whose triangles they are.

    Examples
    --------
    >>> import clbvh
    >>> import trimesh
    >>> scene = clbvh.Scene()
    >>> box = scene.add(trimesh.creation.box())
    >>> left, right = scene.place(box), scene.place(box, clbvh.Transform(translate=(3, 0, 0)))
    >>> pair = clbvh.Tracer(scene).closest_pair(left, right)
    >>> pair.distance, pair.points[:, 0]
    (2.0, array([0.5, 2.5]))
    """

    distance: float
    points: NDArray[np.float64]
    prim_ids: NDArray[np.int32]
    instance_ids: NDArray[np.int32]


class PairQueries(HasCaster):
    """The queries of a `Tracer` whose arguments are instances."""

    # The trees that these queries walk; of a twin, its own.
    _host_trees: HostTrees

    def closest_pair(
        self,
        a: Instances,
        b: Instances | None = None,
        *,
        max_distance: float = np.inf,
    ) -> ClosestPair:
        """Return where the surfaces of two instances are nearest to each other.

        Parameters
        ----------
        a : Instance, int or str, or several
            Of the tracer's scene, each with a mesh; by handle, id or name.
        b : Instance, int or str, or several, optional
            All other instances if left out, but for those that a mask of 0 removes. Of several, the nearest pair of one
            of `a` and another one of `b` is found.
        max_distance : float, the scene's units
            What is farther apart is not looked for, which takes less time.

        Returns
        -------
        ClosestPair
            The first point is on an instance of `a`.

        Raises
        ------
        SceneError
            One is no instance of the scene.
        QueryError
            There are not two different instances, one is of spheres, or the tracer is closed.
        ConfigError
            max_distance is no number from 0.

        Notes
        -----
        Corners are placed in the scene in float64. Of these triangles the distance is exact, rounded once, and it is 0
        only if they have a common point: touching counts, and no tolerance is added. The pair is the nearest one as far
        as float64 can tell, and the same each time. Degenerate triangles count for nothing, as in all other queries.

        The distance is that of surfaces: a part inside a closed one, not touching it, is some way from its wall;
        `contains` tells. Poses are those of the last `set_transforms`.

        The host walks trees of its own, with one thread. They are built on first use and when vertices have moved, in
        about 100 ms for 100,000 triangles, and take about 200 bytes per triangle.

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> scene = clbvh.Scene()
        >>> ball = scene.add(trimesh.creation.icosphere(radius=1))
        >>> left, right = scene.place(ball), scene.place(ball, clbvh.Transform(translate=(5, 0, 0)))
        >>> with clbvh.Tracer(scene) as tracer:
        ...     tracer.closest_pair(left, right).distance
        ...     tracer.set_transforms(right, clbvh.Transform(translate=(2, 0, 0)).matrix)
        ...     tracer.closest_pair(left).distance, tracer.is_colliding(left, right)
        3.0
        (0.0, True)
        """
        if not (isinstance(max_distance, Real) and max_distance >= 0):
            raise ConfigError(f"max_distance must be a number from 0, not {max_distance!r}")
        nothing = np.full(2, NO_PRIM, np.int32)
        apart = ClosestPair(np.inf, np.full((2, 3), np.nan), nothing, nothing.copy())
        with self._caster.open_call() as call:
            pairs = self._pair_up(call.world, a, b)
            found = self._search(call.world, np.sort(pairs)).find_nearest(float(max_distance)) if len(pairs) else None
            if found is None:
                return apart
            # A search has the smaller id first.
            way = slice(None, None, 1 if pairs[found.pair, 0] < pairs[found.pair, 1] else -1)
            instances = pairs[found.pair].astype(np.int32)
            return ClosestPair(found.distance, found.points[way], found.prim_ids[way], instances)

    def is_colliding(
        self,
        a: Instances,
        b: Instances | None = None,
    ) -> bool:
        """Return whether the surfaces of two instances have a common point: they touch or cross.

        Parameters and errors are those of `closest_pair`, and its distance is 0 for the same instances. The first touch
        that is found ends the search. A part inside a closed one, not touching it, does not collide.

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> scene = clbvh.Scene()
        >>> box = scene.add(trimesh.creation.box())
        >>> for x in (0, 1, 2.5):
        ...     _ = scene.place(box, clbvh.Transform(translate=(x, 0, 0)))
        >>> tracer = clbvh.Tracer(scene)
        >>> tracer.is_colliding(0, 1), tracer.is_colliding(1, 2)
        (True, False)
        """
        with self._caster.open_call() as call:
            pairs = self._pair_up(call.world, a, b)
            return len(pairs) > 0 and self._search(call.world, np.sort(pairs)).find_one(TOUCH) is not None

    def collisions(self, instances: Instances | None = None) -> NDArray[np.int32]:
        """Return all pairs of instances whose surfaces have a common point.

        Parameters
        ----------
        instances : several instances, ids or names, optional
            Those that are tested against each other; if left out, all of the scene whose mask is not 0.

        Returns
        -------
        (n, 2) int32
            Ids of instances, the smaller one first, in ascending order.

        Raises
        ------
        SceneError, QueryError
            As in `closest_pair`.

        Notes
        -----
        Pairs whose boxes overlap are tested by all cores.

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> scene = clbvh.Scene()
        >>> box = scene.add(trimesh.creation.box())
        >>> for x in (0, 0.5, 1.25, 3):
        ...     _ = scene.place(box, clbvh.Transform(translate=(x, 0, 0)))
        >>> clbvh.Tracer(scene).collisions()
        array([[0, 1],
               [1, 2]], dtype=int32)
        """
        chosen = np.unique(self._changes.choose_instances(None, instances))
        with self._caster.open_call() as call:
            if instances is None:
                chosen = np.flatnonzero(call.world.state.masks)
            _check_meshes(call.world, chosen)
            lower, upper = find_boxes(call.world.arrays)
            pairs = chosen[find_overlaps(lower[chosen], upper[chosen])]
            if len(pairs) == 0:
                return np.empty((0, 2), np.int32)
            prim_ids = self._search(call.world, pairs).find_touches(call.threads)
            return pairs[prim_ids[:, 0] != NO_PRIM].astype(np.int32)

    def _search(self, world: World, pairs: NDArray[np.int64]) -> PairSearch:
        """Return a search of pairs, the smaller id first."""
        _check_meshes(world, np.unique(pairs))
        return PairSearch.open(world.state.shapes, world.arrays, self._host_trees, pairs)

    def _pair_up(self, world: World, a: Any, b: Any) -> NDArray[np.int64]:
        """Return the pairs of different instances of two lists, once each, (n, 2); see `closest_pair`."""
        ones, others = (self._changes.choose_instances(None, each) for each in (a, b))
        if b is None:
            others = np.setdiff1d(others, ones)
        check_room(len(ones) * len(others), PAIR_BYTES, "pairs")
        pairs = np.stack(np.meshgrid(ones, others, indexing="ij"), axis=-1).reshape(-1, 2)
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
        # By one number of a pair, in a fifth of the time.
        _, first = np.unique(np.sort(pairs) @ [1 << 32, 1], return_index=True)
        pairs = pairs[np.sort(first)]
        if len(pairs) == 0:
            raise QueryError("a distance needs two different instances")
        return pairs if b is not None else pairs[world.state.masks[pairs[:, 1]] > 0]


def _check_meshes(world: World, instance_ids: NDArray[np.int64]) -> None:
    """Raise `QueryError` unless all instances are of meshes."""
    for instance_id in instance_ids.tolist():
        shape = world.state.shapes[world.state.geometry_ids[instance_id]]
        if not isinstance(shape, Mesh):
            name = world.state.instance_names[instance_id]
            raise QueryError(
                f"the instance {name!r} is of {shape.kind.name}, and pairs are measured between meshes: leave it out"
            )
