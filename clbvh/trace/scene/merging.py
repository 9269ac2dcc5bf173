"""Instances merged on the device: meshes that are placed once become one mesh, with one tree, where the scene has them.

Owns what is merged, and the numbers that tell the merged primitives apart. They are in the order of (instance_id,
prim_id), so the tree decides between equally near primitives as the instances would. `merge_rule.py` chooses what is
merged. Must not know of OpenCL.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...geometry import Mesh
from ...layouts.leaf_blocks import FaceNumbers
from ...scene.state import SceneState
from ..hits.scene_arrays import SceneArrays
from .merge_rule import find_groups
from .place_parts import place_parts

BuildTree = Callable[[Mesh], Bvh]

# A tree from which more than this share of the triangles has left is built anew.
_MOST_LEFT = 0.5

# Changes by which instances leave a merged mesh before the rest does, too: each of them uploads the scene anew. Of 100
# meshes of 5,000 triangles that are moved one by one, each took 118 ms, and the move of all at once 134 ms (CPU time on
# a 2-core x86-64 server, PoCL).
_MOST_DEPARTURES = 4


@dataclass(frozen=True, eq=False)
class MergedMesh:
    """The meshes of some instances as one, with its tree.

    Attributes
    ----------
    instance_ids : (n,) int64, ascending
        At least two.
    face_counts : (n,) int64
        Of each instance.
    bvh : Bvh
        Its mesh has the faces of one instance after the other.
    transform : (4, 4) float64
        From the coordinates of that mesh to the scene's, see `place_parts`.
    is_degenerate : (F,) bool
        Triangles that no ray hits, in their own mesh or in the merged one.
    has_left : (n,) bool
        Instances that have changed since, and are traced by themselves.
    departures : int
        Changes by which they have left, also a tree from which this one was built anew.
    """

    instance_ids: NDArray[np.int64]
    face_counts: NDArray[np.int64]
    bvh: Bvh
    transform: NDArray[np.float64]
    is_degenerate: NDArray[np.bool_]
    has_left: NDArray[np.bool_]
    departures: int = 0

    @classmethod
    def build(
        cls, state: SceneState, arrays: SceneArrays, instance_ids: NDArray[np.int64], build_tree: BuildTree
    ) -> MergedMesh | None:
        """Merge instances, without those that would lose triangles; None if fewer than two are left."""
        while len(instance_ids) > 1:
            face_counts = np.array([state.shapes[geometry].prim_count for geometry in state.geometry_ids[instance_ids]])
            mesh, transform, was_degenerate = place_parts(state, arrays, instance_ids)
            is_lost = mesh.degenerate_faces & ~was_degenerate
            if not is_lost.any():
                bvh = build_tree(mesh)
                none_left = np.zeros(len(instance_ids), np.bool_)
                is_degenerate = mesh.degenerate_faces | was_degenerate
                return cls(instance_ids, face_counts, bvh, transform, is_degenerate, none_left)
            first_faces = np.cumsum(face_counts) - face_counts
            instance_ids = instance_ids[~np.logical_or.reduceat(is_lost, first_faces)]
        return None

    @property
    def mesh(self) -> Mesh:
        """The merged mesh."""
        return self.bvh.mesh

    @property
    def first_id(self) -> int:
        """The instance of the primitive with the number 0."""
        return int(self.instance_ids[0])

    @property
    def prim_bits(self) -> int:
        """The bits of a primitive's number that are its prim_id; those above count instances."""
        return int(self.face_counts.max() - 1).bit_length()

    @property
    def merged_ids(self) -> NDArray[np.int64]:
        """The instances that are still merged."""
        return self.instance_ids[~self.has_left]

    @property
    def is_worn(self) -> bool:
        """Whether enough triangles have left for a new tree to pay."""
        return bool(self.face_counts[self.has_left].sum() > _MOST_LEFT * self.face_counts.sum())

    def without(self, instance_ids: NDArray[np.integer]) -> MergedMesh:
        """Return the mesh after instances have left it; itself if none of them is in it."""
        has_left = self.has_left | np.isin(self.instance_ids, instance_ids)
        if (has_left == self.has_left).all():
            return self
        return dataclasses.replace(self, has_left=has_left, departures=self.departures + 1)

    def face_numbers(self) -> FaceNumbers:
        """Return the numbers of the triangles on the device, and those that no ray hits there."""
        first_faces = np.cumsum(self.face_counts) - self.face_counts
        prim_ids = np.arange(self.mesh.face_count) - np.repeat(first_faces, self.face_counts)
        first_numbers = (self.instance_ids - self.first_id) << self.prim_bits
        numbers = np.repeat(first_numbers, self.face_counts) + prim_ids
        return FaceNumbers(numbers.astype(np.int32), self.is_degenerate | np.repeat(self.has_left, self.face_counts))


@dataclass(frozen=True, eq=False)
class Merging:
    """The merged meshes of a scene.

    Attributes
    ----------
    meshes : tuple of MergedMesh
        No instance is in two of them.
    """

    meshes: tuple[MergedMesh, ...] = ()

    @classmethod
    def find(cls, state: SceneState, arrays: SceneArrays, build_tree: BuildTree) -> Merging:
        """Merge the instances of a scene that gain by it."""
        built = (MergedMesh.build(state, arrays, group, build_tree) for group in find_groups(state, arrays))
        return cls(tuple(merged for merged in built if merged is not None))

    @property
    def instance_ids(self) -> NDArray[np.int64]:
        """The instances that are merged."""
        return np.concatenate([np.empty(0, np.int64), *(merged.merged_ids for merged in self.meshes)])

    def note_on(self, arrays: SceneArrays) -> SceneArrays:
        """Return the arrays of a scene with the coordinates in which the device has the merged instances."""
        origin, scale = np.zeros_like(arrays.merged_origin), np.zeros_like(arrays.merged_scale)
        for merged in self.meshes:
            ids, transform = merged.merged_ids, merged.transform
            origin[ids] = transform[:3, :3] @ merged.mesh.origin + transform[:3, 3]
            scale[ids] = merged.mesh.scale
        return arrays._replace(merged_origin=origin, merged_scale=scale)

    def measure_radii(self, instance_count: int) -> NDArray[np.float64]:
        """Return (n,) float64, world units: the radius of the merged mesh that each instance is in, 0 for none."""
        radii = np.zeros(instance_count)
        for merged in self.meshes:
            halves = np.abs(merged.mesh.local_box).max(axis=0).astype(np.float64)
            radii[merged.merged_ids] = np.linalg.norm(halves) / merged.mesh.scale
        return radii

    def list_trees(self, trees: Sequence[Bvh | None]) -> list[Bvh]:
        """Return the trees that rays traverse: those of the geometries, where there are any, and the merged ones."""
        return [bvh for bvh in trees if bvh is not None] + [merged.bvh for merged in self.meshes]

    def without(
        self, instance_ids: NDArray[np.integer], state: SceneState, arrays: SceneArrays, build_tree: BuildTree
    ) -> Merging:
        """Return the merging after instances have left; itself if none of them is merged.

        Parameters
        ----------
        instance_ids : (k,) int
        state, arrays : SceneState, SceneArrays
            Before they leave.
        build_tree : function
            Builds the trees anew that are worn.
        """
        after = [merged.without(instance_ids) for merged in self.meshes]
        if all(one is other for one, other in zip(after, self.meshes, strict=True)):
            return self
        kept = []
        for merged in after:
            if merged.departures > _MOST_DEPARTURES or len(merged.merged_ids) < 2:
                continue
            if not merged.is_worn:
                kept.append(merged)
                continue
            built = MergedMesh.build(state, arrays, merged.merged_ids, build_tree)
            if built is not None:
                kept.append(dataclasses.replace(built, departures=merged.departures))
        return Merging(tuple(kept))


NOTHING_MERGED = Merging()
