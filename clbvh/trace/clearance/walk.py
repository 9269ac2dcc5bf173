"""Two trees at once: the nearest pair of triangles of two instances, for a list of pairs of instances.

The host walks the binary trees of the builders, in float64. The boxes of two nodes are compared along the axes of both
instances, so that those of one are always upright; see van den Bergen, "Efficient collision detection of complex
deformable models using AABB trees", 1997.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...bvh import Bvh
from ...device.host.loops import Loops
from ...geometry import Shape
from ...structs import NO_PRIM
from ...support.forks import make_lock
from ...support.host_threads import HostThreads, cut_range
from ..rays.batch import check_room
from ..world.surface_arrays import SurfaceArrays
from ..world.top_tree import find_boxes
from .boxes import fit_boxes
from .triangles import APART, TOUCH, measure_exactly

_LOOPS = Loops("clearance/walk")

# Where a search may go on: the pair, the entries on the stack, -1 before it has begun, the tests done of the leaves on
# top, and the triangles that float64 cannot decide. An entry is three words. See cl/host/clearance/walk.cl.
_BEGIN = 0, -1, 0, NO_PRIM, NO_PRIM
_ENTRY_WORDS = 3

# The most memory that the search of a pair of instances takes, among many.
PAIR_BYTES = 128

# Pairs that a thread tests at a time; after Ctrl-C it tests no more of them.
_PAIRS = 32

# No instances are that far apart in the unit of a search; and squared limits have room for rounding.
_FAR, _ROOM = 2.0**500, 1.0 + 2.0**-50


class JoinedTrees(NamedTuple):
    """The trees of some geometries, one behind the other, in local coordinates.

    Attributes
    ----------
    links : (N, 2) int32
        The fields `first` and `count` of `structs.NODE`.
    boxes : (N, 15) float32
        Around the triangles of a node: the centre, half the sides, and the three axes.
    prim_ids : (F,) int32
        `NO_PRIM` for degenerate triangles: they count for nothing, as in all other queries.
    first_node, first_prim : (G,) int64
        Where the rows of a geometry begin; -1 where it has no tree.
    stack_size : int
    """

    links: NDArray[np.int32]
    boxes: NDArray[np.float32]
    prim_ids: NDArray[np.int32]
    first_node: NDArray[np.int64]
    first_prim: NDArray[np.int64]
    stack_size: int


class HostTrees:
    """The trees of a tracer's geometries on the host, built when they are first asked for; from any thread."""

    def __init__(self) -> None:
        self._lock = make_lock()
        self._trees: dict[int, Bvh] = {}
        self._boxes: dict[int, NDArray[np.float32]] = {}
        self._joined: JoinedTrees | None = None

    def find(self, shapes: Sequence[Shape], geometry_id: int) -> Bvh:
        """Return the tree of a geometry; one whose shape is new is built anew."""
        with self._lock:
            self._renew(shapes, [geometry_id])
            return self._trees[geometry_id]

    def join(self, shapes: Sequence[Shape], geometry_ids: NDArray[np.integer]) -> JoinedTrees:
        """Return the trees of some geometries, and maybe of others; one whose shape is new is built anew."""
        with self._lock:
            self._renew(shapes, np.unique(geometry_ids).tolist())
            if self._joined is None or len(self._joined.first_node) < len(shapes):
                # Another thread may know of more geometries.
                self._joined = self._join(max(len(shapes), *self._trees, 0) + 1)
            return self._joined

    def _renew(self, shapes: Sequence[Shape], geometry_ids: list[int]) -> None:
        # Imported here: few tracers need it.
        from ...builders.build import build_shapes

        new = [
            geometry_id
            for geometry_id in geometry_ids
            if (tree := self._trees.get(geometry_id)) is None or tree.shape is not shapes[geometry_id]
        ]
        trees = build_shapes([shapes[geometry_id] for geometry_id in new], "default")
        for geometry_id, tree in zip(new, trees, strict=True):
            self._joined, self._trees[geometry_id] = None, tree
            self._boxes.pop(geometry_id, None)

    def _join(self, geometry_count: int) -> JoinedTrees:
        for geometry_id, tree in self._trees.items():
            if geometry_id not in self._boxes:
                self._boxes[geometry_id] = fit_boxes(tree)
        first_node, first_prim = (np.full(geometry_count, -1, np.int64) for _ in range(2))
        node_count = prim_count = 0
        for geometry_id, tree in self._trees.items():
            first_node[geometry_id], first_prim[geometry_id] = node_count, prim_count
            node_count, prim_count = node_count + tree.node_count, prim_count + len(tree.prim_ids)
        trees = self._trees.values()
        links = [np.stack((tree.nodes["first"], tree.nodes["count"]), axis=1) for tree in trees]
        return JoinedTrees(
            np.concatenate(links), np.concatenate([self._boxes[each] for each in self._trees]),
            np.concatenate([_find_prims(tree) for tree in trees]), first_node, first_prim,
            # A step takes one entry and puts two.
            max(tree.depth for tree in trees) * 2 + 2,
        )  # fmt: skip


def _find_prims(tree: Bvh) -> NDArray[np.int32]:
    """Return the triangles of a tree; `NO_PRIM` for those that have no area in float64 either."""
    mesh = tree.mesh
    if not mesh.degenerate_faces.any():
        return tree.prim_ids
    is_degenerate = mesh.degenerate_faces & ~mesh.face_normals.any(axis=1)
    return np.where(is_degenerate[tree.prim_ids], np.int32(NO_PRIM), tree.prim_ids)


class Nearest(NamedTuple):
    """What is found of pairs of instances.

    Attributes
    ----------
    squared : (n,) float64, squared units of the search
    prim_ids : (n, 2) int32
        `NO_PRIM` where a pair has nothing below the limit.
    """

    squared: NDArray[np.float64]
    prim_ids: NDArray[np.int32]


class Closest(NamedTuple):
    """Where the instances of a pair are nearest to each other.

    Attributes
    ----------
    pair : int
        Its number in the search.
    prim_ids : (2,) int32
    distance : float, the scene's units
    points : (2, 3) float64
        One of either instance.
    """

    pair: int
    prim_ids: NDArray[np.int32]
    distance: float
    points: NDArray[np.float64]


class PairSearch(NamedTuple):
    """Pairs of instances, and what finds their nearest triangles.

    Attributes
    ----------
    trees : JoinedTrees
    arrays : SurfaceArrays
    pairs : (n, 2) int64
        Ids of instances, the smaller one first: float64 need not tell the same of a pair the other way round.
    unit : float
        A power of two, which brings coordinates and distances to about 1: distances of the search are in this unit.
    gaps : (n,) float64
        Squared distances of the instances' boxes.
    """

    trees: JoinedTrees
    arrays: SurfaceArrays
    pairs: NDArray[np.int64]
    unit: float
    gaps: NDArray[np.float64]

    @classmethod
    def open(
        cls, shapes: Sequence[Shape], arrays: SurfaceArrays, trees: HostTrees, pairs: NDArray[np.int64]
    ) -> PairSearch:
        """Return a search of instances, all of meshes, as they are."""
        ids = np.unique(pairs)
        lower, upper = find_boxes(arrays)
        unit = 2.0 ** -int(np.frexp(max(np.abs(lower[ids]).max(), np.abs(upper[ids]).max()))[1])
        one, other = pairs.T
        ways = np.maximum(np.maximum(lower[one] - upper[other], lower[other] - upper[one]), 0.0) * unit
        joined = trees.join(shapes, arrays.geometry_id[ids])
        return cls(joined, arrays, pairs, unit, (ways * ways).sum(axis=1))

    def find_nearest(self, limit: float) -> Closest | None:
        """Return where two instances of a pair are nearest, of all pairs; None if all are farther apart than a limit.

        Parameters
        ----------
        limit : float, the scene's units
        """
        squared = min(limit * self.unit, _FAR) ** 2 * _ROOM + TOUCH
        # To find a touch takes a tenth of the time: not of parts whose boxes are apart.
        found = self.find_one(TOUCH) or self.find_one(squared)
        if found is None:
            return None
        closest = self.measure_pair(*found)
        return closest if closest.distance <= limit else None

    def find_touches(self, threads: HostThreads) -> NDArray[np.int32]:
        """Return the first triangles of each pair that are found to touch, (n, 2); `NO_PRIM` where none do."""
        prim_ids = np.empty((len(self.pairs), 2), np.int32)

        def test(begin: int, end: int) -> None:
            prim_ids[begin:end] = self.measure(np.arange(begin, end), TOUCH, is_chained=False).prim_ids

        threads.run(test, cut_range(0, len(self.pairs), -(-len(self.pairs) // _PAIRS)))
        return prim_ids

    def measure_pair(self, pair: int, prim_ids: NDArray[np.int32]) -> Closest:
        """Return the distance of two triangles of a pair, exactly."""
        corners = np.empty((6, 3))
        place_pair(self.arrays, self.pairs[pair], prim_ids, corners)
        return Closest(pair, prim_ids, *measure_exactly(corners))

    def find_one(self, limit: float) -> tuple[int, NDArray[np.int32]] | None:
        """Return the pair of the nearest triangles, and them; None if all are beyond the limit of `measure`."""
        near = np.flatnonzero(self.gaps < limit)
        order = near[np.lexsort((*self.pairs[near].T[::-1], self.gaps[near]))]
        prim_ids = self.measure(order, limit, is_chained=True).prim_ids
        found = np.flatnonzero(prim_ids[:, 0] != NO_PRIM)
        return (int(order[found[-1]]), prim_ids[found[-1]]) if len(found) else None

    def measure(self, which: NDArray[np.intp], limit: float, *, is_chained: bool) -> Nearest:
        """Return the nearest triangles of some pairs; without the GIL, but for what float64 cannot decide.

        Parameters
        ----------
        which : (m,) int
            Of the pairs.
        limit : float
            Squared distance that a pair must be below; `TOUCH` for those that touch.
        is_chained : bool
            Whether each pair must be nearer than all before it.
        """
        trees, pairs = self.trees, self.pairs[which]
        found = Nearest(np.full(len(pairs), limit), np.full((len(pairs), 2), NO_PRIM, np.int32))
        state, corners = np.array(_BEGIN, np.int64), np.empty((6, 3))
        stack = np.empty((trees.stack_size, _ENTRY_WORDS), np.int64)
        while not _LOOPS.walk(
            self.arrays.addresses, *trees[:-1], pairs, self.gaps[which], self.unit,
            is_chained, state, stack, *found,
        ):  # fmt: skip
            pair, _, _, *prims = state.tolist()
            place_pair(self.arrays, pairs[pair], prims, corners)
            distance, _ = measure_exactly(corners)
            squared = max((distance * self.unit) ** 2, APART) if distance > 0.0 else 0.0
            if squared < found.squared[pair]:
                found.squared[pair], found.prim_ids[pair] = squared, prims
        return found


def find_overlaps(lower: NDArray[np.float64], upper: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the pairs of boxes that overlap, (n, 2), the smaller number first, in ascending order."""
    order = np.argsort(lower[:, 0], kind="stable")
    count = _LOOPS.sweep(lower, upper, order, np.empty((0, 2), np.int64))
    check_room(count, PAIR_BYTES, "pairs")
    pairs = np.empty((count, 2), np.int64)
    _LOOPS.sweep(lower, upper, order, pairs)
    return pairs[np.lexsort(pairs.T[::-1])]


def place_pair(
    arrays: SurfaceArrays, instances: NDArray[np.int64], prims: ArrayLike, corners: NDArray[np.float64]
) -> None:
    """Write the corners of two triangles of two instances in the world, (6, 3)."""
    _LOOPS.place_pair(arrays.addresses, instances, np.asarray(prims, np.int32), corners)
