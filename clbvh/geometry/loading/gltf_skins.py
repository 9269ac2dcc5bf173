"""Skins of glTF files: meshes that joints carry, posed as the joints stand in the scene.

A vertex goes to the mean of the places to which its joints take it, by their weights; a joint takes it by its matrix
times its inverse bind matrix. The node of the mesh has no say.

Khronos Group, "glTF 2.0 Specification", 2021, section 3.7.3.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ..appearance.appearance import find_cofactors, make_unchecked, normalize, turn_corners
from .file_parts import Piece
from .gltf_data import GltfData, get_list, get_object


class Skin(NamedTuple):
    """What each joint does to a mesh, (n, 4, 4) float64, and its node, (4, 4), where no joint is named."""

    joints: NDArray[np.float64]
    node: NDArray[np.float64]


def read_skin(
    gltf: GltfData, index: Any, node: NDArray[np.float64], matrices: Mapping[Any, NDArray[np.float64]]
) -> Skin:
    """Return a skin; `matrices` are those of the scene's nodes, from their own coordinates to the scene's."""
    table = gltf.item("skins", index)
    joints = get_list(table, "joints")
    for joint in joints:
        gltf.item("nodes", joint)
        if joint not in matrices:
            raise MeshError(f"skins[{index}] has the joint nodes[{joint}], which is not in the scene")
    placed = np.reshape([matrices[joint] for joint in joints], (-1, 4, 4))
    if (bound := table.get("inverseBindMatrices")) is None:
        return Skin(placed, node)
    inverse = gltf.read_vectors(bound, (16,)).reshape(-1, 4, 4).transpose(0, 2, 1)  # column by column
    if len(inverse) < len(joints):
        raise MeshError(f"skins[{index}] has {len(inverse):,} inverse bind matrices for {len(joints):,} joints")
    with np.errstate(over="ignore", invalid="ignore"):  # coordinates that are not finite are refused later
        return Skin(placed @ inverse[: len(joints)], node)


def pose_piece(gltf: GltfData, primitive: dict[str, Any], piece: Piece, skin: Skin, where: str) -> Piece:
    """Return a primitive as its joints hold it, with the points that its faces refer to."""
    used, faces = np.unique(piece.faces, return_inverse=True)
    faces, looks = faces.reshape(piece.faces.shape), piece.appearance
    linear, shift = np.split(_blend(gltf, primitive, skin, len(piece.points), used, where)[:, :3], [3], axis=2)
    with np.errstate(all="ignore"):  # as above
        points = (linear @ piece.points[used, :, None] + shift)[..., 0]
        if looks is not None and looks.normals is not None:
            normals = find_cofactors(linear)[faces] @ looks.normals[..., None]
            looks = make_unchecked(**(vars(looks) | {"normals": normalize(normals[..., 0])[0]}))
        # A mirrored triangle is seen from its other side, unless its corners are turned round.
        if len(used) and np.median(np.linalg.det(linear)) < 0:
            faces, looks = faces[:, ::-1], None if looks is None else turn_corners(looks)
    return Piece(points, faces, looks)


def _blend(
    gltf: GltfData, primitive: dict[str, Any], skin: Skin, count: int, used: NDArray[np.integer], where: str
) -> NDArray[np.float64]:
    """Return what the joints do to the used ones of `count` vertices, (n, 4, 4)."""
    attributes = get_object(primitive, "attributes")
    sets = [number for number in range(len(attributes)) if f"JOINTS_{number}" in attributes]
    if not sets:
        return np.broadcast_to(skin.node, (len(used), 4, 4))

    def read(name: str) -> NDArray[np.float64]:
        values = [gltf.read_vectors(attributes.get(f"{name}_{number}"), (4,)) for number in sets]
        if wrong := [len(each) for each in values if len(each) != count]:
            raise MeshError(f"{where} has {wrong[0]:,} {name.lower()} for {count:,} vertices")
        return np.concatenate(values, axis=1)[used].T

    joints, weights = read("JOINTS"), read("WEIGHTS")
    joints[weights == 0] = 0  # whatever stands there
    if not ((joints >= 0) & (joints < len(skin.joints))).all():
        raise MeshError(f"{where} has a vertex with a joint that is not among the {len(skin.joints):,} of its skin")
    # Weights that were rounded to bytes sum up to about 1. A vertex without any is the first joint's.
    weights[0, weights.sum(axis=0) == 0] = 1
    blended = np.zeros((len(used), 4, 4))
    with np.errstate(all="ignore"):  # as above
        for joint, weight in zip(joints.astype(np.int64), weights / weights.sum(axis=0), strict=True):
            blended += weight[:, None, None] * skin.joints[joint]
    return blended
