"""A scene in a device's memory, ready for the kernels of scenes: two levels of trees, and the records of instances.

A scene that is nothing but spheres in their place is one tree without instances for rays, a `LoneSpheres`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...device.session import DeviceSession
from ...errors import SceneError
from ...geometry import Mesh
from ...geometry.spheres import Shape, Spheres
from ...layouts.device_arrays import DeviceArrays, list_prims, make_device_arrays
from ...scene.state import SceneState
from ...structs import ENTRY_POINT_LAYOUTS, FAR_RADII, PRIM_KINDS, WORLD_HIT
from ..device_tree import BRUTE, make_defines, pad_stack, resolve_layout
from ..hits.surface import Surface
from ..rays.batch import TreeBox
from ..rays.pack import NEAR_SHARE
from ..world.metrics import LazyMetrics
from ..world.surface_arrays import SurfaceArrays, make_surface_arrays, move_instances
from .top_tree import BuildTree, TopTree

# No builder's tree is deeper, so that all scenes share one compiled kernel.
_TOP_STACK_SIZE = 64

# Room for the rounding of the distance that is compared with the radius.
_ROUNDING_ROOM = 1 - 2.0**-10


def make_scene_defines(layout: str, stack_size: int, *, has_spheres: bool) -> dict[str, int]:
    """Return the macros of every traversal kernel of a scene."""
    return make_defines(layout, stack_size) | {
        "LONE": 0,
        "HAS_SPHERES": int(has_spheres),
        "TOP_STACK_SIZE": _TOP_STACK_SIZE,
    }


class DeviceScene:
    """The buffers and the compile-time constants of one scene; in place of a `DeviceTree`.

    Parameters
    ----------
    session : DeviceSession
        Owns the buffers.
    state : SceneState
        At least one instance.
    trees : sequence of Bvh or None
        One for each geometry; None: no tree but the one over the instances.
    build_top : function
        Builds the tree over the instances.
    layout : str
        Of the geometries' trees. The one over the instances is `bvh2` in any case. Without trees the layout is
        ``"brute"``, whatever is asked: each primitive of an instance is tested against each ray that meets its box.
    surface : SurfaceArrays, optional
        Of the state, if they are there already.

    Raises
    ------
    SceneError
        The scene is empty, or an instance is too small beside the scene.
    ConfigError
        An unknown layout, or a tree that is too deep.
    DeviceError
        The scene does not fit the device.

    Attributes
    ----------
    state : SceneState
    surface : SurfaceArrays
        What hits are refined on.
    trees : tuple of Bvh
        Empty in the layout ``"brute"``.
    built_shapes : tuple of Mesh or Spheres
        What the trees are around; `state` has the shapes as they are now.
    top : TopTree
    metrics : LazyMetrics
    layout, arguments, defines, has_entry_points, node_bytes
        As in `DeviceTree`.
    ray_tree : LoneSpheres or None
    """

    has_instances = True
    hit_dtype = WORLD_HIT
    mesh = None

    def __init__(
        self,
        session: DeviceSession,
        state: SceneState,
        trees: Sequence[Bvh] | None,
        build_top: BuildTree,
        layout: str = "auto",
        *,
        surface: SurfaceArrays | None = None,
    ) -> None:
        if len(state.transforms) == 0:
            raise SceneError("the scene has no instance: place a geometry, as in scene.place(scene.add(mesh))")
        self.layout = BRUTE if trees is None else resolve_layout(layout, session)
        self.has_entry_points = self.layout in ENTRY_POINT_LAYOUTS
        self.state, self.trees = state, tuple(trees or ())
        self.built_shapes = state.shapes
        self._build_top = build_top
        arrays = arrange_geometries(state, trees, self.layout)
        self._ranges = list_ranges(state, arrays)
        self.arguments: dict[str, Any] = {"block_count": np.int32(0)}
        self._byte_counts: dict[str, int] = {}
        depth = max((bvh.depth for bvh in self.trees), default=0)
        stack_size = pad_stack(self.layout, max(each.stack_size for each in arrays), depth)
        has_spheres = bool((self._ranges[:, 3] == PRIM_KINDS["spheres"]).any())
        self.defines = make_scene_defines(self.layout, stack_size, has_spheres=has_spheres)
        self.node_bytes = arrays[0].nodes.itemsize
        self._node_counts = [len(each.nodes) for each in arrays]
        blocks = blocks_by_kind(self._ranges, arrays)
        joined = {"nodes": [each.nodes for each in arrays], "blocks": blocks["triangles"], "spheres": blocks["spheres"]}
        self._dtypes = {name: pieces[0].dtype for name, pieces in joined.items() if pieces}
        self.surface = surface or make_surface_arrays(state.shapes, state.geometry_ids, state.transforms)
        for name, pieces in joined.items():
            self._upload(session, name, pieces)
        self._put_top(session, session)

    def moved(self, owner: DeviceSession, session: DeviceSession, state: SceneState) -> Self:
        """Return the scene with other transforms; this one does not change.

        Parameters
        ----------
        owner : DeviceSession
            Owns the buffers.
        session : DeviceSession
            A branch of it, for this thread.
        state : SceneState
        """
        moved = self._copy(state)
        moved.surface = move_instances(self.surface, state.transforms)
        moved._put_top(owner, session)
        return moved

    def with_geometry(
        self,
        owner: DeviceSession,
        session: DeviceSession,
        state: SceneState,
        geometry_id: int,
        write: Callable[[Shape, NDArray[np.void], NDArray[np.void]], None],
    ) -> Self:
        """Return the scene with a geometry whose vertices or spheres have moved, given what writes its arrays anew."""
        moved = self._copy(state)
        moved._refit(self, owner, session, geometry_id, write)
        moved.surface = make_surface_arrays(state.shapes, state.geometry_ids, state.transforms)
        moved._put_top(owner, session)
        return moved

    @contextmanager
    def mapped(
        self, session: DeviceSession, geometry_id: int, *, write: bool
    ) -> Iterator[tuple[NDArray[np.void], NDArray[np.void]]]:
        """Map the nodes and the blocks of a geometry into the host's memory; see `DeviceSession.mapped`."""
        nodes, blocks = (
            session.mapped(self.arguments[name], count, dtype, write=write, first=first)
            for name, first, count, dtype in self._list_arrays(geometry_id)
        )
        with nodes as node_array, blocks as block_array:
            yield node_array, block_array

    def _copy(self, state: SceneState) -> Self:
        """Return a scene of another state, which shares all buffers."""
        made = copy(self)
        made.state = state
        made.arguments, made._byte_counts = dict(self.arguments), dict(self._byte_counts)
        return made

    def _refit(
        self,
        other: DeviceScene,
        owner: DeviceSession,
        session: DeviceSession,
        geometry_id: int,
        write: Callable[[Shape, NDArray[np.void], NDArray[np.void]], None],
    ) -> None:
        """Put the arrays of all geometries into new buffers: one refitted, the rest from another scene."""
        for name, begin, count, dtype in self._list_arrays(geometry_id):
            byte_count = self._byte_counts[name]
            source, target = other.arguments[name], owner.allocate(byte_count, writable=False)
            self.arguments[name] = target
            first, end = begin * dtype.itemsize, (begin + count) * dtype.itemsize
            session.copy(source, target, first)
            session.copy(source, target, byte_count - end, source_begin=end, target_begin=end)
        with self.mapped(session, geometry_id, write=True) as arrays:
            write(self.state.shapes[geometry_id], *arrays)
        # Queries have queues of their own, which do not wait for this one.
        session.finish()

    def _put_top(self, owner: DeviceSession, session: DeviceSession) -> None:
        """Build the tree over the instances, and put it into new buffers."""
        self.top = TopTree.build(self.surface, self._ranges, self.state.masks, self._build_top)
        self.metrics = LazyMetrics(self.surface, float(self.top.bvh.shape.scale))
        for name, array in (("top_nodes", self.top.nodes), ("instances", self.top.instances)):
            self.arguments[name] = owner.allocate(array.nbytes, writable=False)
            self._byte_counts[name] = array.nbytes
            session.write(self.arguments[name], array)

    def _list_arrays(self, geometry_id: int) -> list[tuple[str, int, int, np.dtype]]:
        """Return the buffer of a geometry's nodes and that of its blocks, where they begin, their number and dtype."""
        first_node, first_block, block_count, kind = self._ranges[geometry_id].tolist()
        blocks = "spheres" if kind == PRIM_KINDS["spheres"] else "blocks"
        return [
            ("nodes", first_node, self._node_counts[geometry_id], self._dtypes["nodes"]),
            (blocks, first_block, block_count, self._dtypes[blocks]),
        ]

    @property
    def ray_tree(self) -> LoneSpheres | None:
        """The tree for rays, where they need not know of instances."""
        ranges = self._ranges[self.state.geometry_ids[0]]
        if not isinstance(self.state.lone_shape, Spheres) or ranges[:2].any():
            return None
        return LoneSpheres(self, int(ranges[2]))

    @property
    def scene_surface(self) -> Surface:
        """What hits keep of the scene."""
        return Surface(self.surface, self.state.shapes, self.state.names)

    def shapes_of(self, instance_ids: NDArray[np.integer] | None) -> list[Shape]:
        """Return the shapes that some instances place, or all of them for None."""
        geometry_ids = self.state.geometry_ids if instance_ids is None else self.state.geometry_ids[instance_ids]
        return [self.state.shapes[geometry_id] for geometry_id in np.unique(geometry_ids)]

    @property
    def advances_rays(self) -> bool:
        """Whether a ray may begin so far from an instance that it is advanced, see cl/instances/instance.cl."""
        # The centre of an instance lies in the box, and no packed ray begins farther from that along an axis.
        farthest = (NEAR_SHARE + 1) * float(self.box.half.max())
        return float(self.top.instances["radius"].min()) * FAR_RADII * _ROUNDING_ROOM < farthest

    @property
    def box(self) -> TreeBox:
        """The box around the scene."""
        return TreeBox.around(self.top.bvh)

    @property
    def prim_count(self) -> int:
        """Primitives of all instances."""
        counts = np.array([shape.prim_count for shape in self.state.shapes], np.int64)
        return int(counts[self.state.geometry_ids].sum())

    @property
    def most_crossings(self) -> int:
        """Most crossings that a ray can have: one for each triangle, two for each sphere."""
        return 2 * self.prim_count

    def on_host(self) -> None:
        """Return None: the host casts at meshes alone."""

    @property
    def memory_bytes(self) -> int:
        """Bytes of all buffers."""
        return sum(self._byte_counts.values())

    def _upload(self, session: DeviceSession, name: str, pieces: Sequence[NDArray[np.void]]) -> None:
        """Put arrays into one buffer, one after the other."""
        joined = pieces[0] if len(pieces) == 1 else np.concatenate(pieces) if pieces else np.empty(0, np.float32)
        self.arguments[name] = session.upload(joined)
        self._byte_counts[name] = joined.nbytes


# The boxes of spheres reach farther than the spheres by less than this, in local units of at most 1.
_MARGIN = 2.0**-17


class LoneSpheres:
    """In place of a `DeviceTree`, for rays alone.

    Parameters
    ----------
    scene : DeviceScene
        One group of spheres, whose arrays are the first ones in its buffers.
    block_count : int

    Attributes
    ----------
    box : TreeBox
        Around the spheres.
    layout, arguments, defines, has_entry_points, node_bytes, memory_bytes
        As in `DeviceTree`.
    scene_surface, surface, most_crossings
        As in `DeviceScene`.
    """

    has_instances = False
    advances_rays = False
    hit_dtype = WORLD_HIT
    mesh = None
    ray_tree = None

    def __init__(self, scene: DeviceScene, block_count: int) -> None:
        # Its buffers are given back when nobody holds it.
        self._scene = scene
        self.layout, self.node_bytes, self.memory_bytes = scene.layout, scene.node_bytes, scene.memory_bytes
        self.surface, self.most_crossings = scene.surface, scene.most_crossings
        self.arguments: dict[str, Any] = {
            "nodes": scene.arguments["nodes"],
            "blocks": scene.arguments["spheres"],
            "block_count": np.int32(block_count),
            **dict.fromkeys(("top_nodes", "instances", "spheres")),
        }
        self.defines = {name: scene.defines[name] for name in ("LAYOUT", "STACK_SIZE", "LONE", "HAS_SPHERES")}
        self.defines["LONE"] = 1
        self.has_entry_points = self.layout in ENTRY_POINT_LAYOUTS
        spheres = scene.state.shapes[scene.state.geometry_ids[0]]
        half = np.abs(spheres.local_box).max(axis=0).astype(np.float64) + _MARGIN
        self.box = TreeBox(spheres.origin, spheres.scale, half)

    def on_host(self) -> None:
        """Return None: the host casts at meshes alone."""

    @property
    def scene_surface(self) -> Any:
        """What hits keep of the scene."""
        return self._scene.scene_surface


def arrange_geometries(state: SceneState, trees: Sequence[Bvh] | None, layout: str) -> list[DeviceArrays]:
    """Return the arrays of each geometry; without trees, those have none, whatever the layout."""
    if trees is None:
        return [list_prims(shape) for shape in state.shapes]
    return [make_device_arrays(bvh, layout) for bvh in trees]


def list_ranges(state: SceneState, arrays: Sequence[DeviceArrays]) -> NDArray[np.int32]:
    """Return where the arrays of `arrange_geometries` are in the joined ones, (n, 4), see `make_records`.

    Raises
    ------
    SceneError
        More nodes or blocks than int32 counts.
    """
    rows = []
    first_node, first_blocks = 0, [0] * len(PRIM_KINDS)
    for shape, own in zip(state.shapes, arrays, strict=True):
        kind = PRIM_KINDS["triangles" if isinstance(shape, Mesh) else "spheres"]
        rows.append((first_node, first_blocks[kind], len(own.blocks), kind))
        first_node += len(own.nodes)
        first_blocks[kind] += len(own.blocks)
    most = np.iinfo(np.int32).max
    if max(first_node, *first_blocks) > most:
        raise SceneError(f"the scene has {first_node:,} nodes, and the device counts up to {most:,}")
    return np.array(rows, np.int32)


def blocks_by_kind(ranges: NDArray[np.int32], arrays: Sequence[DeviceArrays]) -> dict[str, list[NDArray[np.void]]]:
    """Return the blocks of all arrays by the kind of their primitives, see `structs.PRIM_KINDS`."""
    blocks: dict[str, list[NDArray[np.void]]] = {name: [] for name in PRIM_KINDS}
    names = list(PRIM_KINDS)
    for own, kind in zip(arrays, ranges[:, 3].tolist(), strict=True):
        blocks[names[kind]].append(own.blocks)
    return blocks
