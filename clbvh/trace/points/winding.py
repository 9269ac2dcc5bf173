"""Generalized winding numbers, by a tree of moments over the triangles of each instance where it is in the world.

See Barill, Dickson, Schmidt, Levin and Jacobson, "Fast winding numbers for soups and clouds", 2018. The host fits the
moments (cl/host/points/winding.cl), and the device walks the tree (cl/kernels/winding.cl).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...device.host.loops import Loops
from ...device.host.variants import WINDING_LANES
from ...errors import ConfigError, QueryError
from ...geometry import Mesh
from ...support.forks import make_lock
from ..clearance.walk import HostTrees
from ..hits.points_on import place_points
from ..hits.surface import Surface
from ..launch import Call, Caster
from ..rays.batch import check_room
from ..rays.pieces import Progress
from .batch import SeenPoints, take_points
from .pack import cut_points_of, find_point_order
from .queries import find_closest

_LOOPS = Loops("points/winding")

# Of a point and its answer on the device.
_POINT = np.dtype([("point", "f4", 3), ("winding", "f4")])
_NODE_NUMBERS = 26

# Local coordinates of points on the device are at most so large: from there, nothing goes around a point.
_FARTHEST = 1e12

# A point is inside where triangles go around it by more than this, in either sense.
INSIDE = 0.5

# Where a node is expanded from the distance of `a` radii on, errors are at most this times a^-4: measured at points in
# and around 40 shapes, scans and sets of triangles in no order. The largest was 0.14, around the bunny.
_ERROR_OF_ONE_RADIUS = 0.15
# Nearer by than this, expansions diverge.
_LEAST_RADII = 1.25

# Two radii, as libigl takes them.
DEFAULT_ERROR = 0.01

# By which points are inside: by the hits of one ray, or by what goes around them.
PARITY, WINDING = "parity", "winding"


def check_rule(rule: str) -> str:
    """Return the rule, or raise `ConfigError` for what is none."""
    if not isinstance(rule, str) or rule not in (PARITY, WINDING):
        raise ConfigError(f"rule must be '{PARITY}' or '{WINDING}', not {rule!r}")
    return rule


class WindingTree(NamedTuple):
    """The triangles of an instance as the device sees them, and the frame of their coordinates.

    Attributes
    ----------
    nodes : (n, 26) float32
        See cl/kernels/winding.cl.
    links : (n, 2) int32
    corners : (f, 3, 3) float32
    centre : (3,) float64
    scale : float
        A power of two: local coordinates are ``(position - centre) * scale``.
    """

    nodes: NDArray[np.float32]
    links: NDArray[np.int32]
    corners: NDArray[np.float32]
    centre: NDArray[np.float64]
    scale: float

    def to_local(self, points: NDArray[Any]) -> NDArray[np.float32]:
        """Return local coordinates; those of points that are very far away are cut off."""
        local = (points - self.centre) * self.scale
        return np.clip(local, -_FARTHEST, _FARTHEST).astype(np.float32)


class _PutTree(NamedTuple):
    """A tree, the mesh and the transform that it is of, and its arrays on the device."""

    mesh: Mesh
    transform: bytes
    tree: WindingTree
    buffers: dict[str, Any]


class WindingTrees:
    """The trees of a tracer's instances, fitted when they are first asked for and after a move; from any thread.

    Parameters
    ----------
    host_trees : HostTrees
        Of the tracer: moments are those of their nodes.
    """

    def __init__(self, host_trees: HostTrees) -> None:
        self._lock = make_lock()
        self._host_trees = host_trees
        self._put: dict[int, _PutTree] = {}

    def find(self, caster: Caster, instance: int) -> tuple[WindingTree, dict[str, Any]]:
        """Return the tree of an instance where it is now, and its arrays on the device."""
        surface, upload = Surface.of_world(caster.world), caster.session.upload
        arrays = surface.arrays
        geometry_id = int(arrays.geometry_id[instance])
        mesh = surface.shapes[geometry_id]
        if not isinstance(mesh, Mesh):
            raise QueryError("winding numbers are those of triangles: an instance is of spheres")
        transform = arrays.linear[instance].tobytes() + arrays.offset[instance].tobytes()
        with self._lock:
            put = self._put.get(instance)
            if put is None or put.mesh is not mesh or put.transform != transform:
                tree = _fit(surface, self._host_trees.find(caster.world.state.shapes, geometry_id), instance)
                buffers = {"nodes": upload(tree.nodes), "links": upload(tree.links), "corners": upload(tree.corners)}
                self._put[instance] = put = _PutTree(mesh, transform, tree, buffers)
            return put.tree, put.buffers


def _fit(surface: Surface, tree: Bvh, instance: int) -> WindingTree:
    corners = place_points(surface, tree.prim_ids[:, None], np.eye(3), np.array([instance])).locations
    if np.linalg.det(surface.arrays.linear[instance]) < 0:
        corners = corners[:, ::-1]  # a mirror takes the outside along
    lower, upper = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    size = np.max(upper - lower)
    centre, scale = lower / 2 + upper / 2, float(2.0 ** -np.ceil(np.log2(size))) if size > 0 else 1.0
    local = np.ascontiguousarray((corners - centre) * scale)
    links = np.stack((tree.nodes["first"], tree.nodes["count"]), axis=1).astype(np.int32)
    nodes = np.empty((len(links), _NODE_NUMBERS), np.float32)
    _LOOPS.fit_moments(links, local.reshape(-1), nodes)
    return WindingTree(nodes, links, local.astype(np.float32), centre, scale)


def find_windings(
    caster: Caster, trees: WindingTrees, seen: SeenPoints, max_error: float, progress: Progress | None = None
) -> NDArray[np.float64]:
    """Return the winding number of each point, of all that it sees; see `Tracer.winding_number`."""
    check_room(seen.count, 8, "points")
    sums = np.empty(seen.count)

    def add(begin: int, end: int, found: _Found) -> None:
        sums[begin:end] = 0.0
        for _, windings in found:
            sums[begin:end] += windings

    _wind(caster, trees, seen, max_error, add, progress)
    return sums.reshape(seen.shape)


def find_wound(
    caster: Caster, trees: WindingTrees, seen: SeenPoints, progress: Progress | None = None
) -> NDArray[np.bool_]:
    """Return whether triangles go around each point; see `Tracer.contains`."""
    check_room(seen.count, 1, "points")
    is_inside = np.empty(seen.count, np.bool_)

    def join(begin: int, end: int, found: _Found) -> None:
        is_inside[begin:end] = False
        for _, windings in found:
            is_inside[begin:end] |= np.abs(windings) > INSIDE

    _wind(caster, trees, seen, DEFAULT_ERROR, join, progress)
    return is_inside.reshape(seen.shape)


def find_wound_distances(
    caster: Caster, trees: WindingTrees, seen: SeenPoints, progress: Progress | None = None
) -> NDArray[np.float64]:
    """Return distances, positive inside of the deepest instance; see `Tracer.signed_distance`."""
    distances = -find_closest(caster, seen).distance.reshape(-1)

    def measure(begin: int, end: int, found: _Found) -> None:
        for instance, windings in found:
            ids = begin + np.flatnonzero(np.abs(windings) > INSIDE)
            own = SeenPoints(seen.take(ids).points, instance_ids=np.array([instance]))
            distances[ids] = np.maximum(distances[ids], find_closest(caster, own).distance)

    _wind(caster, trees, seen, DEFAULT_ERROR, measure, progress)
    return distances.reshape(seen.shape)


# Instances, and the winding numbers of points around each: 0 of points that do not see it.
_Found = Iterator[tuple[int, NDArray[np.float32]]]


def _wind(
    caster: Caster, trees: WindingTrees, seen: SeenPoints, max_error: float, use: Callable[[int, int, _Found], None],
    progress: Progress | None,
) -> None:  # fmt: skip
    """Call a function with parts of the points and what is found of them; again with smaller ones if memory lacks."""
    masks = caster.world.state.masks
    accuracy = max((_ERROR_OF_ONE_RADIUS / max_error) ** 0.25, _LEAST_RADII) if max_error > 0 else np.inf
    chosen = np.arange(len(masks)) if seen.instance_ids is None else np.unique(seen.instance_ids)

    def wind(call: Call, begin: int, end: int) -> _Found:
        points = take_points(seen.rows, begin, end, call.world.box)
        order = find_point_order(points, call.world.box, call.order_by_keys)
        sees = seen.mask_rows.part(begin, end, seen.mask_rows.items.dtype)
        for instance in chosen.tolist():
            is_seen = np.broadcast_to(sees if call.world.is_lone else sees & masks[instance], (end - begin,)) != 0
            if is_seen.any():
                tree, buffers = trees.find(caster, instance)
                windings = np.empty(end - begin, np.float32)
                windings[order] = _ask(call, buffers, tree.to_local(points.take(order, axis=0)), accuracy)
                yield instance, np.where(is_seen, windings, np.float32(0))

    def work(call: Call) -> None:
        for begin, end in cut_points_of(call, _POINT, seen.count, progress):
            use(begin, end, wind(call, begin, end))

    caster.run(work)


def _ask(call: Call, buffers: dict[str, Any], points: NDArray[np.float32], accuracy: float) -> NDArray[np.float32]:
    """Return the winding numbers of points in local coordinates, as the device computes them."""
    windings, session = np.empty(len(points), np.float32), call.session
    written = call.take("windings", windings.nbytes)
    lanes = 1 if session.info.kind == "gpu" else WINDING_LANES
    items, group = -(-len(points) // lanes), session.settings.work_group_size
    session.run(
        session.kernel("winding", {"LANES": lanes}), (items,), (group,), **buffers,
        points=call.put("points", points), point_count=np.int32(len(points)), accuracy=np.float32(accuracy),
        windings=written,
    )  # fmt: skip
    session.download(written, windings)
    return windings
