"""The upper level of a scene as arrays: the tree over the instances, their records, and where each geometry begins."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...errors import SceneError
from ...geometry import Mesh
from ...geometry.box_mesh import box_mesh
from ...layouts.bvh2 import make_bvh2_nodes
from ...layouts.device_arrays import DeviceArrays
from ...scene.state import SceneState
from ...structs import PRIM_KINDS
from ..hits.scene_arrays import SceneArrays
from .placed import find_boxes, make_records

BuildTree = Callable[[Mesh], Bvh]


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


def list_parts(state: SceneState, arrays: Sequence[DeviceArrays]) -> NDArray[np.int32]:
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
