"""Instances merged on the device: meshes that are placed once become one mesh, with one tree, where the scene has them.

Owns the rule by which instances are merged, what is merged, and the numbers that tell the merged primitives apart. They
are in the order of (instance_id, prim_id), so the tree decides between equally near primitives as the instances would.
Must not know of OpenCL.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...errors import SceneError
from ...geometry import Mesh
from ...layouts.leaf_blocks import FaceNumbers
from ...scene.state import SceneState
from ...structs import ALL_PRIM_BITS, PRIM_KINDS
from ...support.compiled import compiled
from ...support.memory import check_memory
from ..hits.scene_arrays import SceneArrays, place_vector

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


# Least number of instances that gain by it. Of knots side by side, picture rays and random ones take 1.02 to 1.1 times
# as long apart as merged for 2 of 50,000 triangles, 1.1 to 1.25 times for 4 of 20,000, 1.4 times for 64 of 20,000 and
# 2 times for 2,000 of 500; where the boxes of 64 overlap, 4 times (CPU time on a 2-core x86-64 server, PoCL).
LEAST_COUNT = 4

# A part of a merged mesh is at least this share of it, by the largest sides of their boxes. So rounding a corner to
# float32, which moves it by 2^-24 of half the size of the merged mesh, moves it by 2^-17 of that of the part at most. A
# field of 45 x 45 balls is one mesh from 2^-6 on, and then traced 1.5 to 1.7 times as fast as apart; as 5 meshes, with
# 2^-5, 1.1 to 1.3 times (CPU time on a 2-core x86-64 server, PoCL).
_LEAST_SHARE = 2.0**-7

# A part that its map flattens is at least this thick beside the merged mesh. So rounding moves a corner by 2^-10 of the
# thickness at most, and a ray meets the side from which it comes: of balls of this thickness, 2 of 10^5 rays met the
# back in place of the front; a tenth as thick, 22, and a hundredth, 709. An instance resolves its own axes, however
# flat.
_LEAST_THICKNESS = 2.0**-15

# A part is at least this share of the scene, and its matrix turns and flattens by this factor at most. Others would be
# refused as instances, or nearly, and any part may have to become one.
_LEAST_OF_SCENE = 2.0**-30
_MOST_CONDITION = 2.0**20


def find_groups(state: SceneState, arrays: SceneArrays) -> list[NDArray[np.int64]]:
    """Return the instances that are to be merged with each other.

    Parameters
    ----------
    state : SceneState
    arrays : SceneArrays
        Of the state.

    Returns
    -------
    list of (n,) int64
        The ids of each group, ascending: at least `LEAST_COUNT` triangle meshes that are placed once, have the same
        mask, and are mirrored or not.
    """
    if state.instance_count < LEAST_COUNT:
        return []
    middles = np.einsum("nij,nj->ni", arrays.linear, arrays.origin[arrays.geometry_id]) + arrays.offset
    halves = np.einsum("nij,nj->ni", np.abs(arrays.linear), arrays.half_size[arrays.geometry_id])
    candidates = np.flatnonzero(_may_be_merged(state, arrays, middles, halves))
    groups = []
    sizes = _measure_sizes(arrays, halves)
    kinds = np.column_stack((state.masks[candidates], arrays.is_mirrored[candidates]))
    for kind in np.unique(kinds, axis=0):
        alike = candidates[(kinds == kind).all(axis=1)]
        for group in _find_alike_in_size(alike, sizes, middles, halves):
            group = _with_short_numbers(group, state)
            if len(group) >= LEAST_COUNT:
                groups.append(group)
    return groups


def _may_be_merged(
    state: SceneState, arrays: SceneArrays, middles: NDArray[np.float64], halves: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return (n,) bool: triangle meshes that are placed once, and that are neither tiny nor flattened by far."""
    is_single = np.bincount(state.geometry_ids, minlength=state.geometry_count)[state.geometry_ids] == 1
    is_mesh = arrays.kind[arrays.geometry_id] == PRIM_KINDS["triangles"]
    scene = _half_size(np.arange(len(middles)), middles, halves)
    is_large = halves.max(axis=1) >= _LEAST_OF_SCENE * scene
    with np.errstate(over="ignore", invalid="ignore"):  # infinite for one that is flattened by far
        condition = np.einsum("nij,njk->nik", np.abs(arrays.linear), np.abs(arrays.inverse)).sum(axis=2).max(axis=1)
    return np.asarray(is_single & is_mesh & is_large & (condition <= _MOST_CONDITION) & (halves.max(axis=1) > 0))


def _measure_sizes(arrays: SceneArrays, halves: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n,) float64: the sizes of which `_LEAST_SHARE` speaks, less where a part is too flat for its size."""
    half_sizes = arrays.half_size[arrays.geometry_id]
    # Half of what separates the planes -1 and 1 of each axis of the object in the world.
    with np.errstate(over="ignore", divide="ignore"):
        stretches = 1.0 / np.linalg.norm(arrays.inverse, axis=2)
    thicknesses = half_sizes * stretches * (_LEAST_SHARE / _LEAST_THICKNESS)
    # A mesh that is flat by itself, not by its map, is as exact as its own float32.
    unflattened = half_sizes.max(axis=1, keepdims=True) * stretches
    return np.minimum(halves.max(axis=1), np.maximum(thicknesses, unflattened).min(axis=1))


def _find_alike_in_size(
    instance_ids: NDArray[np.int64],
    sizes: NDArray[np.float64],
    middles: NDArray[np.float64],
    halves: NDArray[np.float64],
) -> Iterator[NDArray[np.int64]]:
    """Yield groups of instances, each of which is as large as the rule wants it beside the box of its group.

    Those that are large beside all are a group. The others, if all are small, are cut in two where they are.
    """
    pending = [instance_ids]
    while pending:
        ids = pending.pop()
        if len(ids) < LEAST_COUNT:
            continue
        is_large = sizes[ids] >= _LEAST_SHARE * _half_size(ids, middles, halves)
        if is_large.any():
            yield ids[is_large]
            pending.append(ids[~is_large])
            continue
        # The box is many times larger than any of them, so they are apart; or all are flat.
        lower, upper = middles[ids].min(axis=0), middles[ids].max(axis=0)
        axis = int(np.argmax(upper / 2 - lower / 2))
        is_below = middles[ids, axis] <= lower[axis] / 2 + upper[axis] / 2
        if not is_below.all():
            pending += [ids[is_below], ids[~is_below]]


def _half_size(ids: NDArray[np.int64], middles: NDArray[np.float64], halves: NDArray[np.float64]) -> float:
    """Return half the largest side of the box around some instances."""
    lower, upper = (middles[ids] - halves[ids]).min(axis=0), (middles[ids] + halves[ids]).max(axis=0)
    return float(np.max(upper / 2 - lower / 2))


def _with_short_numbers(group: NDArray[np.int64], state: SceneState) -> NDArray[np.int64]:
    """Return the instances of a group whose primitives have numbers on the device, see `Merging`."""
    face_counts = np.array([state.shapes[geometry].prim_count for geometry in state.geometry_ids[group]])
    id_bits = int(group[-1] - group[0]).bit_length()
    return group[face_counts <= 1 << max(ALL_PRIM_BITS - id_bits, 0)]


# Of a vertex and of a face, in the arrays and in the copies that a mesh makes of them.
_VERTEX_BYTES, _FACE_BYTES = 60, 25


def place_parts(
    state: SceneState, arrays: SceneArrays, instance_ids: NDArray[np.int64]
) -> tuple[Mesh, NDArray[np.float64], NDArray[np.bool_]]:
    """Return the meshes of instances as one.

    Parameters
    ----------
    state : SceneState
    arrays : SceneArrays
        Of the state.
    instance_ids : (n,) int64
        At least one triangle mesh; all are mirrored, or none is.

    Returns
    -------
    mesh : Mesh
        The vertices and the faces of one instance after the other. Its zero is in the first one: far from the scene's
        zero, float64 would round the vertices by more than the differences of two of them.
    transform : (4, 4) float64
        From the mesh's coordinates to the scene's: a translation, and a mirror if it is one that has placed the
        instances. So the corners of a face run as in its own mesh.
    is_degenerate : (F,) bool
        Whether no ray hits a triangle in its own mesh, see `Mesh.degenerate_faces`.

    Raises
    ------
    SceneError
        The mesh does not fit the free memory.
    """
    shapes = [state.shapes[geometry_id] for geometry_id in state.geometry_ids[instance_ids]]
    vertex_counts = np.array([len(shape.vertices) for shape in shapes if isinstance(shape, Mesh)])
    face_counts = np.array([shape.prim_count for shape in shapes])
    vertices, faces = np.empty((vertex_counts.sum(), 3)), np.empty((face_counts.sum(), 3), np.int32)
    check_memory("the merged meshes of the scene", len(vertices) * _VERTEX_BYTES + len(faces) * _FACE_BYTES, SceneError)
    is_degenerate = np.empty(len(faces), np.bool_)
    first, transform = instance_ids[0], np.eye(4)
    transform[:3, 3] = arrays.offset[first] + arrays.linear[first] @ arrays.origin[arrays.geometry_id[first]]
    transform[0, 0] = -1.0 if arrays.is_mirrored[first] else 1.0
    _place(arrays, instance_ids, vertex_counts, face_counts, transform, vertices, faces, is_degenerate)
    return Mesh.from_arrays(vertices, faces, name="merged meshes"), transform, is_degenerate


@compiled
def _place(arrays, instance_ids, vertex_counts, face_counts, transform, vertices, faces, is_degenerate):
    local = np.empty((3, 3))
    first_vertex, first_face = 0, 0
    side = transform[0, 0]
    for part in range(len(instance_ids)):
        instance = instance_ids[part]
        geometry = arrays.geometry_id[instance]
        origin, scale = arrays.origin[geometry], arrays.scale[geometry]
        source_vertex, source_face = arrays.first_vertex[geometry], arrays.first_face[geometry]
        centre = place_vector(arrays, instance, origin[0], origin[1], origin[2])
        x = centre[0] + arrays.offset[instance, 0] - transform[0, 3]
        y = centre[1] + arrays.offset[instance, 1] - transform[1, 3]
        z = centre[2] + arrays.offset[instance, 2] - transform[2, 3]
        for vertex in range(vertex_counts[part]):
            point = arrays.vertices[source_vertex + vertex]
            moved = place_vector(arrays, instance, point[0] - origin[0], point[1] - origin[1], point[2] - origin[2])
            vertices[first_vertex + vertex, 0] = side * (moved[0] + x)
            vertices[first_vertex + vertex, 1] = moved[1] + y
            vertices[first_vertex + vertex, 2] = moved[2] + z
        for face in range(face_counts[part]):
            for corner in range(3):
                vertex = arrays.faces[source_face + face, corner]
                faces[first_face + face, corner] = first_vertex + vertex
                for axis in range(3):
                    # As the mesh has it in float32.
                    position = (arrays.vertices[source_vertex + vertex, axis] - origin[axis]) * scale
                    local[corner, axis] = np.float64(np.float32(position))
            is_degenerate[first_face + face] = _is_flat(local)
        first_vertex += vertex_counts[part]
        first_face += face_counts[part]


@compiled
def _is_flat(corners):
    """Return whether three points lie on one line, or in one point; exact for coordinates that float32 has."""
    ux, uy, uz = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
    vx, vy, vz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
    return uy * vz == uz * vy and uz * vx == ux * vz and ux * vy == uy * vx
