"""Two trees at once: the nearest pair of triangles of two instances, for a list of pairs of instances.

The host walks the binary trees of the builders, in float64. The boxes of two nodes are compared along the axes of both
instances, so that those of one are always upright; see van den Bergen, "Efficient collision detection of complex
deformable models using AABB trees", 1997.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...errors import QueryError
from ...geometry import Mesh
from ...scene.state import SceneState
from ...structs import NO_PRIM
from ...support.compiled import compiled
from ...support.forks import make_lock
from ..rays.batch import check_room
from ..world.surface_arrays import SurfaceArrays, place_point
from ..world.top_tree import find_boxes
from ..world.world import World
from .boxes import Poses, bound_distance, fit_boxes, size_of, take_poses
from .triangles import APART, measure_exactly, measure_triangles

# The numbers of a search that may go on: the pair, the entries on the stack, the tests done of the leaves on top; and
# the pair of triangles that float64 cannot decide.
_PAIR, _SIZE, _TESTED, _PRIM_A, _PRIM_B = range(5)
_NOT_BEGUN = -1

# The most memory that the search of a pair of instances takes, among many.
PAIR_BYTES = 128


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

    def join(self, state: SceneState, geometry_ids: NDArray[np.integer]) -> JoinedTrees:
        """Return the trees of some geometries, and maybe of others; one whose shape is new is built anew."""
        # Imported here: few tracers need it.
        from ...builders.build import build_shapes

        with self._lock:
            new = [
                geometry_id
                for geometry_id in np.unique(geometry_ids).tolist()
                if (tree := self._trees.get(geometry_id)) is None or tree.shape is not state.shapes[geometry_id]
            ]
            trees = build_shapes([state.shapes[geometry_id] for geometry_id in new], "default")
            for geometry_id, tree in zip(new, trees, strict=True):
                self._joined, self._boxes[geometry_id], self._trees[geometry_id] = None, fit_boxes(tree), tree
            if self._joined is None:
                self._joined = self._join(state.geometry_count)
            return self._joined

    def _join(self, geometry_count: int) -> JoinedTrees:
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
    def open(cls, world: World, trees: HostTrees, pairs: NDArray[np.int64]) -> PairSearch:
        """Return a search of the world as it is.

        Raises
        ------
        QueryError
            An instance is of spheres.
        """
        ids = check_meshes(world, np.unique(pairs))
        # All read-only, as those of a lone mesh are: numba would compile another version of the loops for others.
        vertices, faces = world.arrays.vertices.view(), world.arrays.faces.view()
        vertices.flags.writeable = faces.flags.writeable = False
        arrays = world.arrays._replace(vertices=vertices, faces=faces)
        lower, upper = find_boxes(arrays)
        unit = 2.0 ** -int(np.frexp(max(np.abs(lower[ids]).max(), np.abs(upper[ids]).max()))[1])
        one, other = pairs.T
        ways = np.maximum(np.maximum(lower[one] - upper[other], lower[other] - upper[one]), 0.0) * unit
        joined = trees.join(world.state, world.state.geometry_ids[ids])
        return cls(joined, arrays, pairs, unit, (ways * ways).sum(axis=1))

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
        chosen = self._replace(pairs=self.pairs[which], gaps=self.gaps[which])
        pairs, stack_size = chosen.pairs, self.trees.stack_size
        found = Nearest(np.full(len(pairs), limit), np.full((len(pairs), 2), NO_PRIM, np.int32))
        state = np.array([0, _NOT_BEGUN, 0, 0, 0], np.int64)
        stack, bounds, corners = np.empty((stack_size, 2), np.int64), np.empty(stack_size), np.empty((6, 3))
        while not _walk(chosen, is_chained, state, stack, bounds, found):
            pair, prims = state[_PAIR], state[_PRIM_A : _PRIM_B + 1].astype(np.int32)
            place_pair(self.arrays, pairs[pair], prims, corners)
            distance, _ = measure_exactly(corners)
            squared = max((distance * self.unit) ** 2, APART) if distance > 0.0 else 0.0
            if squared < found.squared[pair]:
                found.squared[pair], found.prim_ids[pair] = squared, prims
        return found


def check_meshes(world: World, instance_ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return ids of instances; raise `QueryError` unless all are of meshes."""
    for instance_id in instance_ids.tolist():
        if not isinstance(world.state.shapes[world.state.geometry_ids[instance_id]], Mesh):
            name = world.state.instance_names[instance_id]
            raise QueryError(
                f"the instance {name!r} is of spheres, and pairs are measured between meshes: leave it out"
            )
    return instance_ids


def find_overlaps(lower: NDArray[np.float64], upper: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the pairs of boxes that overlap, (n, 2), the smaller number first, in ascending order."""
    order = np.argsort(lower[:, 0], kind="stable")
    count = _sweep(lower, upper, order, np.empty((0, 2), np.int64))
    check_room(count, PAIR_BYTES, "pairs")
    pairs = np.empty((count, 2), np.int64)
    _sweep(lower, upper, order, pairs)
    return pairs[np.lexsort(pairs.T[::-1])]


@compiled
def _sweep(lower, upper, order, pairs):
    """Write the pairs of boxes that overlap, as far as there is room; return their number."""
    count = 0
    for index in range(len(order)):
        one = order[index]
        for later in range(index + 1, len(order)):
            other = order[later]
            if lower[other, 0] > upper[one, 0]:
                break
            if (
                lower[other, 1] <= upper[one, 1] and lower[one, 1] <= upper[other, 1]
                and lower[other, 2] <= upper[one, 2] and lower[one, 2] <= upper[other, 2]
            ):  # fmt: skip
                if count < len(pairs):
                    pairs[count, 0], pairs[count, 1] = min(one, other), max(one, other)
                count += 1
    return count


@compiled
def place_pair(arrays, instances, prims, corners):
    """Write the corners of two triangles of two instances in the world, (6, 3)."""
    for which in range(2):
        triangle = _place(arrays, instances[which], prims[which], 1.0)
        for corner in range(3):
            for axis in range(3):
                corners[3 * which + corner, axis] = triangle[corner][axis]


@compiled
def _place(arrays, instance, prim, unit):
    geometry = arrays.geometry_id[instance]
    face, base = arrays.first_face[geometry] + prim, arrays.first_vertex[geometry]
    return (
        _place_corner(arrays, instance, base + arrays.faces[face, 0], unit),
        _place_corner(arrays, instance, base + arrays.faces[face, 1], unit),
        _place_corner(arrays, instance, base + arrays.faces[face, 2], unit),
    )


@compiled
def _place_corner(arrays, instance, vertex, unit):
    x, y, z = arrays.vertices[vertex, 0], arrays.vertices[vertex, 1], arrays.vertices[vertex, 2]
    x, y, z = place_point(arrays, instance, x, y, z)
    return x * unit, y * unit, z * unit


@compiled
def _walk(search, is_chained, state, stack, bounds, found):
    """Go on with a search; return False where a pair of triangles is to be decided by others."""
    trees, arrays, pairs, unit, gaps = search.trees, search.arrays, search.pairs, search.unit, search.gaps
    poses = Poses(np.empty((2, 3, 3)), np.empty(2), np.empty(3), np.empty(1))
    while state[_PAIR] < len(pairs):
        pair = state[_PAIR]
        if state[_SIZE] == _NOT_BEGUN:
            state[_SIZE] = 0
            if is_chained and pair > 0:
                found.squared[pair] = found.squared[pair - 1]
            if gaps[pair] < found.squared[pair]:
                for which in range(2):
                    stack[0, which] = trees.first_node[arrays.geometry_id[pairs[pair, which]]]
                bounds[0] = gaps[pair]
                state[_SIZE] = 1
        if state[_SIZE] > 0:
            take_poses(arrays, pairs[pair], unit, poses)
            if not _walk_pair(trees, arrays, pairs[pair], unit, poses, state, stack, bounds, found):
                return False
        state[_PAIR] += 1
        state[_SIZE] = _NOT_BEGUN
    return True


@compiled
def _walk_pair(trees, arrays, instances, unit, poses, state, stack, bounds, found):
    """Walk the trees of a pair of instances, the nearer boxes first."""
    pair, links = state[_PAIR], trees.links
    first_a, first_b = (
        trees.first_node[arrays.geometry_id[instances[0]]],
        trees.first_node[arrays.geometry_id[instances[1]]],
    )
    while state[_SIZE] > 0:
        state[_SIZE] -= 1
        size = state[_SIZE]
        if bounds[size] >= found.squared[pair]:
            state[_TESTED] = 0  # also of leaves whose tests were not done
            continue
        a, b = stack[size, 0], stack[size, 1]
        is_leaf_a, is_leaf_b = links[a, 1] > 0, links[b, 1] > 0
        if is_leaf_a and is_leaf_b:
            if not _test_leaves(trees, arrays, instances, unit, a, b, state, found):
                state[_SIZE] += 1
                return False
            continue
        if not is_leaf_a and (
            is_leaf_b
            or size_of(trees.boxes, a) * abs(poses.stretch[0]) > size_of(trees.boxes, b) * abs(poses.stretch[1])
        ):
            left_a = first_a + links[a, 0]
            right_a, left_b, right_b = left_a + 1, b, b
        else:
            left_b = first_b + links[b, 0]
            right_b, left_a, right_a = left_b + 1, a, a
        (left, near_left), (right, near_right) = (
            bound_distance(trees.boxes, left_a, left_b, poses),
            bound_distance(trees.boxes, right_a, right_b, poses),
        )
        if near_left < near_right:
            left_a, right_a, left_b, right_b, left, right = right_a, left_a, right_b, left_b, right, left
        # The nearer one on top.
        stack[size, 0], stack[size, 1], bounds[size] = left_a, left_b, left
        stack[size + 1, 0], stack[size + 1, 1], bounds[size + 1] = right_a, right_b, right
        state[_SIZE] += 2
    return True


@compiled
def _test_leaves(trees, arrays, instances, unit, a, b, state, found):
    """Test the triangles of two leaves; return False where a pair of them is to be decided by others."""
    pair, links = state[_PAIR], trees.links
    first_a = trees.first_prim[arrays.geometry_id[instances[0]]] + links[a, 0]
    first_b = trees.first_prim[arrays.geometry_id[instances[1]]] + links[b, 0]
    tested, number = state[_TESTED], 0
    state[_TESTED] = 0
    for slot_a in range(first_a, first_a + links[a, 1]):
        prim_a = trees.prim_ids[slot_a]
        if prim_a == NO_PRIM:
            number += links[b, 1]
            continue
        one = _place(arrays, instances[0], prim_a, unit)
        for slot_b in range(first_b, first_b + links[b, 1]):
            number += 1
            prim_b = trees.prim_ids[slot_b]
            if number <= tested or prim_b == NO_PRIM:
                continue
            squared, is_open = measure_triangles(one, _place(arrays, instances[1], prim_b, unit), found.squared[pair])
            if is_open:
                state[_TESTED], state[_PRIM_A], state[_PRIM_B] = number, prim_a, prim_b
                return False
            if squared < found.squared[pair]:
                found.squared[pair], found.prim_ids[pair, 0], found.prim_ids[pair, 1] = squared, prim_a, prim_b
    return True
