"""A scene in a device's memory, ready for the kernels of scenes: two levels of trees, and the records of instances."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...device.session import DeviceSession
from ...errors import SceneError
from ...geometry import Mesh
from ...geometry.box_mesh import box_mesh
from ...layouts.bvh2 import make_bvh2_nodes
from ...layouts.device_arrays import DeviceArrays, make_device_arrays
from ...scene.state import SceneState
from ...structs import BVH2_NODE, INSTANCE, LAYOUTS, PRIM_KINDS, SCENE_HIT, SCENE_RAY
from ..device_tree import pad_stack, resolve_layout
from ..hits.scene_arrays import SceneArrays, make_scene_arrays, move_instances
from ..hits.surface import SceneSurface
from ..rays.batch import TreeBox
from .placed import find_boxes, make_records

BuildTree = Callable[[Mesh], Bvh]

# No builder's tree is deeper, so that all scenes share one compiled kernel.
_TOP_STACK_SIZE = 64


@dataclass(frozen=True, eq=False)
class TopTree:
    """The tree over the instances, as the device takes it.

    Attributes
    ----------
    nodes : (m,) `structs.BVH2_NODE`
    instances : (n,) `structs.INSTANCE`
        In the order of the leaves.
    bvh : Bvh
        Its primitives are the instances.
    """

    nodes: NDArray[np.void]
    instances: NDArray[np.void]
    bvh: Bvh

    @classmethod
    def build(
        cls, arrays: SceneArrays, parts: NDArray[np.int32], masks: NDArray[np.uint32], build_tree: BuildTree
    ) -> TopTree:
        """Build the tree over the instances of a scene.

        Raises
        ------
        SceneError
            An instance is too small beside the scene.
        """
        bvh = build_tree(box_mesh(*find_boxes(arrays), "the instances"))
        records = make_records(arrays, parts, masks, bvh.prim_ids, bvh.mesh.origin, bvh.mesh.scale)
        return cls(make_bvh2_nodes(bvh), records, bvh)


class DeviceScene:
    """The buffers and the compile-time constants of one scene; in place of a `DeviceTree`.

    Parameters
    ----------
    session : DeviceSession
        Owns the buffers.
    state : SceneState
        At least one instance.
    trees : sequence of Bvh
        One for each geometry.
    build_top : function
        Builds the tree over the instances.
    layout : str
        Of the geometries' trees. The one over the instances is `bvh2` in any case.

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
    surface : SceneArrays
        What hits are refined on.
    trees : tuple of Bvh
    top : TopTree
    layout, arguments, defines, has_entry_points, node_bytes
        As in `DeviceTree`.
    """

    has_entry_points = False
    has_instances = True
    ray_dtype = SCENE_RAY
    hit_dtype = SCENE_HIT
    mesh = None

    def __init__(
        self, session: DeviceSession, state: SceneState, trees: Sequence[Bvh], build_top: BuildTree, layout: str = "auto"
    ) -> None:
        if len(state.transforms) == 0:
            raise SceneError("the scene has no instance: place a geometry, as in scene.place(scene.add(mesh))")
        self.layout = resolve_layout(layout, session)
        self.state, self.trees = state, tuple(trees)
        self._build_top = build_top
        arrays = [make_device_arrays(bvh, self.layout) for bvh in trees]
        self._parts = _list_parts(state, arrays)
        self.arguments: dict[str, Any] = {}
        self._byte_counts: dict[str, int] = {}
        stack_size = pad_stack(self.layout, max(part.stack_size for part in arrays), max(bvh.depth for bvh in trees))
        has_spheres = bool((self._parts[:, 3] == PRIM_KINDS["spheres"]).any())
        self.defines = {
            "LAYOUT": LAYOUTS[self.layout], "STACK_SIZE": stack_size, "HAS_INSTANCES": 1,
            "HAS_SPHERES": int(has_spheres), "TOP_STACK_SIZE": _TOP_STACK_SIZE,
        }  # fmt: skip
        self.node_bytes = arrays[0].nodes.itemsize
        triangle_blocks = [part.blocks for part, kind in self._by_kind(arrays) if kind == PRIM_KINDS["triangles"]]
        sphere_blocks = [part.blocks for part, kind in self._by_kind(arrays) if kind == PRIM_KINDS["spheres"]]
        for name, parts in (
            ("nodes", [part.nodes for part in arrays]), ("blocks", triangle_blocks), ("spheres", sphere_blocks)
        ):  # fmt: skip
            self._upload(session, name, parts)
        self.surface = make_scene_arrays(state.shapes, state.geometry_ids, state.transforms)
        self.top = TopTree.build(self.surface, self._parts, state.masks, build_top)
        self._upload(session, "top_nodes", [self.top.nodes])
        self._upload(session, "instances", [self.top.instances])

    def moved(self, session: DeviceSession, state: SceneState) -> Self:
        """Return the scene with other transforms or masks of the same instances; this one does not change."""
        moved = copy(self)
        moved.state = state
        moved.surface = move_instances(self.surface, state.transforms)
        moved.top = TopTree.build(moved.surface, self._parts, state.masks, self._build_top)
        moved.arguments, moved._byte_counts = dict(self.arguments), dict(self._byte_counts)
        moved._upload(session, "top_nodes", [moved.top.nodes])
        moved._upload(session, "instances", [moved.top.instances])
        return moved

    def release_top(self, session: DeviceSession) -> None:
        """Give back the buffers that `moved` replaces."""
        for name in ("top_nodes", "instances"):
            session.release(self.arguments[name])

    @property
    def scene_surface(self) -> SceneSurface:
        """What hits keep of the scene."""
        return SceneSurface(self.surface, self.state.shapes, self.state.names)

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

    @property
    def memory_bytes(self) -> int:
        """Bytes of all buffers."""
        return sum(self._byte_counts.values())

    def _by_kind(self, arrays: Sequence[DeviceArrays]) -> list[tuple[DeviceArrays, int]]:
        return list(zip(arrays, self._parts[:, 3].tolist(), strict=True))

    def _upload(self, session: DeviceSession, name: str, parts: Sequence[NDArray[np.void]]) -> None:
        """Put arrays into one buffer, one after the other."""
        joined = parts[0] if len(parts) == 1 else np.concatenate(parts) if parts else np.empty(0, np.float32)
        self.arguments[name] = session.upload(joined)
        self._byte_counts[name] = joined.nbytes


def _list_parts(state: SceneState, arrays: Sequence[DeviceArrays]) -> NDArray[np.int32]:
    """Return where the arrays of each geometry are in the joined ones, (geometries, 4), see `make_records`."""
    rows = []
    first_node, first_blocks = 0, [0] * len(PRIM_KINDS)
    for shape, part in zip(state.shapes, arrays, strict=True):
        kind = PRIM_KINDS["triangles" if isinstance(shape, Mesh) else "spheres"]
        rows.append((first_node, first_blocks[kind], len(part.blocks), kind))
        first_node += len(part.nodes)
        first_blocks[kind] += len(part.blocks)
    most = np.iinfo(np.int32).max
    if max(first_node, *first_blocks) > most:
        raise SceneError(f"the scene has {first_node:,} nodes, and the device counts up to {most:,}")
    return np.array(rows, np.int32)
