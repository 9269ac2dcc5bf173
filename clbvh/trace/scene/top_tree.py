"""The tree over the instances of a scene, and its leaves: instances, or merged meshes in place of several."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...geometry.box_mesh import box_mesh
from ...layouts.bvh2 import make_bvh2_nodes
from ...scene.state import SceneState
from ...structs import ALL_PRIM_BITS
from ..hits.scene_arrays import SceneArrays, make_frames, move_instances
from .merging import BuildTree, Merging
from .placed import LocalFrame, RecordFields, find_boxes, make_records


@dataclass(frozen=True, eq=False)
class TopItems:
    """What the tree over the instances is built over: the instances that are not merged, then the merged meshes.

    Attributes
    ----------
    merging : Merging
    instance_ids : (m,) int32
        Of the items; of a merged mesh the first one.
    prim_bits : (m,) int32
        See `structs.INSTANCE`.
    frames : SceneArrays
        Of the items, without vertices. The merged meshes follow the scene's geometries.
    masks : (m,) uint32
    """

    merging: Merging
    instance_ids: NDArray[np.int32]
    prim_bits: NDArray[np.int32]
    frames: SceneArrays
    masks: NDArray[np.uint32]

    @classmethod
    def of(cls, state: SceneState, arrays: SceneArrays, merging: Merging) -> TopItems:
        """Return the items of a scene, whose `SceneArrays` are given."""
        single = np.setdiff1d(np.arange(state.instance_count), merging.instance_ids)
        meshes = merging.meshes
        instance_ids = np.array([*single, *(merged.first_id for merged in meshes)], np.int32)
        prim_bits = np.array([*(ALL_PRIM_BITS for _ in single), *(merged.prim_bits for merged in meshes)], np.int32)
        frames = arrays
        if meshes:
            of_merged = state.geometry_count + np.arange(len(meshes))
            frames = make_frames(
                [*state.shapes, *(merged.mesh for merged in meshes)],
                np.concatenate((state.geometry_ids[single], of_merged)),
                _find_transforms(state, instance_ids, merging),
            )
        return cls(merging, instance_ids, prim_bits, frames, state.masks[instance_ids])

    def records(self, parts: NDArray[np.int32], top: Bvh) -> NDArray[np.void]:
        """Return their records, `structs.INSTANCE`, in the order of the leaves of the tree over them.

        Parameters
        ----------
        parts : (n, 4) int32
            See `list_parts`.
        top : Bvh

        Raises
        ------
        SceneError
            An instance is too small beside the scene.
        """
        fields = RecordFields(np.ascontiguousarray(self.masks).view(np.int32), self.instance_ids, self.prim_bits)
        return make_records(
            self.frames, parts, fields, top.prim_ids, LocalFrame(top.mesh.origin, float(top.mesh.scale))
        )

    def moved(self, state: SceneState, arrays: SceneArrays) -> TopItems:
        """Return the items after instances have moved that are not merged."""
        if self.merging.meshes:
            arrays = move_instances(self.frames, _find_transforms(state, self.instance_ids, self.merging))
        return dataclasses.replace(self, frames=arrays)


def _find_transforms(state: SceneState, instance_ids: NDArray[np.int32], merging: Merging) -> NDArray[np.float64]:
    """Return (m, 4, 4) float64: the map of each item from object to world."""
    transforms = state.transforms[instance_ids]
    first = len(transforms) - len(merging.meshes)
    for index, merged in enumerate(merging.meshes, first):
        transforms[index] = merged.transform
    return transforms


@dataclass(frozen=True, eq=False)
class TopTree:
    """The tree over the instances, as the device takes it.

    Attributes
    ----------
    nodes : (m,) `structs.BVH2_NODE`
    instances : (n,) `structs.INSTANCE`
        In the order of the leaves.
    bvh : Bvh
        Its primitives are the instances, or, where some are merged, the `TopItems`.
    """

    nodes: NDArray[np.void]
    instances: NDArray[np.void]
    bvh: Bvh

    @classmethod
    def build(cls, items: TopItems, parts: NDArray[np.int32], build_tree: BuildTree) -> TopTree:
        """Build the tree over the instances of a scene.

        Raises
        ------
        SceneError
            An instance is too small beside the scene.
        """
        bvh = build_tree(box_mesh(*find_boxes(items.frames), "the instances"))
        return cls(make_bvh2_nodes(bvh), items.records(parts, bvh), bvh)
