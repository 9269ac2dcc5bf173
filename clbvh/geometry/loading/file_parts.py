"""Meshes of several parts, as files have them: joined to one mesh that names its parts, or cut into one mesh for each.

Owns the rule by which a file is better kept as placed meshes. Must not know of formats.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..appearance.appearance import Appearance, find_flat_normals, make_unchecked, turn_corners
from ..appearance.material import Material
from ..local_frame import is_singular
from ..mesh import Part, check_face_count
from .file_mesh import FileMesh, finish_looks

# The points and faces of a mesh that no ray and no picture finds, in place of all nodes where all are hidden.
POINT = np.zeros((1, 3)), np.zeros((1, 3), np.int32)

# Files whose nodes place more triangles than this times those of their meshes are scenes of instances.
_MOST_PLACED = 2


class Placed(NamedTuple):
    """A shape, by its index, at a position that a (4, 4) float64 matrix gives. The name may be empty.

    An instance of a scene also has its mask, colour and material.
    """

    name: str
    shape: int
    matrix: NDArray[np.float64]
    looks: tuple[Any, ...] = ()


_Shape = TypeVar("_Shape")


class Parts(NamedTuple, Generic[_Shape]):
    """Shapes, and where they are placed, both in the order of their file or scene. Names need not be unique."""

    shapes: list[_Shape]
    placed: list[Placed]


class Piece(NamedTuple):
    """Some triangles of a mesh, (V, 3) float and (F, 3) int, and their looks."""

    points: NDArray[np.number]
    faces: NDArray[np.integer]
    appearance: Appearance | None


def find_hidden(matrices: Sequence[NDArray[np.float64]] | NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return (n,) bool: which nodes are hidden, as programs do by a scale of 0, of (4, 4) matrices."""
    return is_singular(np.reshape(matrices, (-1, 4, 4)).transpose(1, 2, 0))


def join_nodes(read: FileMesh | Parts[FileMesh]) -> FileMesh:
    """Return the meshes of all nodes as one mesh, in their places; each node with triangles is a part.

    Raises
    ------
    MeshError
        They are too many, or do not fit the memory.
    """
    if isinstance(read, FileMesh):
        return read
    placed = [read.shapes[node.shape] for node in read.placed]
    check_face_count(sum(len(mesh.faces) for mesh in placed), sum(len(mesh.vertices) for mesh in placed))
    pieces: list[Piece] = []
    parts: list[Part] = []
    face_count = 0
    for node, mesh in zip(read.placed, placed, strict=True):
        with np.errstate(invalid="ignore"):
            mirrors = bool(np.linalg.slogdet(node.matrix[:3, :3])[0] < 0)
        # A mirrored triangle is seen from its other side, unless its corners are turned round.
        faces = mesh.faces[:, ::-1] if mirrors else mesh.faces
        looks = _move_looks(mesh.appearance, node.matrix, mirrors)
        pieces.append(Piece(_move(mesh.vertices, node.matrix), faces, looks))
        if len(faces):
            parts.append(Part(node.name.strip() or mesh.name, face_count, face_count + len(faces)))
            face_count += len(faces)
    return join_pieces("", pieces)._replace(parts=tuple(parts))


def join_few(read: FileMesh | Parts[FileMesh]) -> FileMesh | Parts[FileMesh]:
    """Return the meshes of all nodes as one mesh, but in parts if that would multiply the triangles."""
    return split_parts(read) if isinstance(read, Parts) and multiplies(read) else join_nodes(read)


def multiplies(parts: Parts[Any]) -> bool:
    """Return whether the nodes place more than twice the triangles that the meshes have."""
    placed = sum(len(parts.shapes[node.shape].faces) for node in parts.placed)
    return placed > _MOST_PLACED * sum(len(mesh.faces) for mesh in parts.shapes)


def split_parts(read: FileMesh | Parts[FileMesh]) -> Parts[FileMesh]:
    """Return a mesh for each name of the parts, in the order of the file, with the vertices that its faces refer to."""
    if isinstance(read, Parts):
        return Parts([drop_loose_vertices(mesh) for mesh in read.shapes], read.placed)
    if not read.parts:
        return Parts([read], [Placed("", 0, np.eye(4))])
    ranges: dict[str, list[NDArray[np.int64]]] = {"": []}  # what has no name comes first
    for name, begin, end in read.parts:
        ranges.setdefault(name, []).append(np.arange(begin, end))
    meshes = []
    for name, own_ranges in ranges.items():
        if not own_ranges:
            continue
        ids = np.concatenate(own_ranges)
        looks = None if read.appearance is None else _drop_unused(read.appearance.select(ids))
        flat_faces = None if read.flat_faces is None else read.flat_faces[ids]
        meshes.append(drop_loose_vertices(FileMesh(name, read.vertices, read.faces[ids], looks, flat_faces)))
    return Parts(meshes, [Placed(mesh.name, number, np.eye(4)) for number, mesh in enumerate(meshes)])


def _drop_unused(looks: Appearance) -> Appearance:
    """Return looks with the materials that faces have, in their order: of thousands in a file, a part has a few."""
    if looks.material_ids is None:
        return looks
    used, ids = np.unique(looks.material_ids, return_inverse=True)
    materials = tuple(looks.materials[number] for number in used.tolist())
    return make_unchecked(**(vars(looks) | {"materials": materials, "material_ids": ids.astype(np.int32)}))


def drop_loose_vertices(mesh: FileMesh) -> FileMesh:
    """Return a mesh with the vertices that faces refer to, in their order."""
    used, renumbered = np.unique(mesh.faces, return_inverse=True)
    if len(used) == len(mesh.vertices):
        return mesh
    return mesh._replace(vertices=mesh.vertices[used], faces=renumbered.reshape(mesh.faces.shape))


def join_pieces(name: str, pieces: Sequence[Piece]) -> FileMesh:
    """Return triangles one after the other as one mesh; an array of points that pieces share is listed once."""
    points = {id(piece.points): piece.points for piece in pieces}
    begins = np.cumsum([0, *map(len, points.values())]).tolist()
    first = dict(zip(points, begins, strict=False))
    faces = [piece.faces + first[id(piece.points)] for piece in pieces]
    return FileMesh(
        name,
        np.concatenate([np.empty((0, 3)), *points.values()]),
        np.concatenate([np.empty((0, 3), np.int64), *faces]),
        _join_looks(pieces),
    )


def _join_looks(pieces: Sequence[Piece]) -> Appearance | None:
    """Return the looks of triangles that follow each other; None if none of them has any.

    Where some pieces have normals, the others have those of their faces.
    """
    looks = [piece.appearance or Appearance() for piece in pieces]
    arrays: dict[str, NDArray] = {}
    for name, fill in _FILLERS.items():
        given = [getattr(each, name) for each in looks]
        if any(values is not None for values in given):
            arrays[name] = _concatenate(
                [fill(piece) if values is None else values for values, piece in zip(given, pieces, strict=True)]
            )
    if not any(each.materials for each in looks):
        return finish_looks(arrays, [])
    # A piece without a material in the midst of others is like a mesh without one; its colours are not tinted.
    plain = Material(base_colour=(1.0, 1.0, 1.0)) if "colours" in arrays else Material()
    used = [each.materials or (plain,) for each in looks]
    numbers = {material: number for number, material in enumerate(dict.fromkeys(chain.from_iterable(used)))}
    if len(numbers) > 1:
        ids = []
        for each, materials, piece in zip(looks, used, pieces, strict=True):
            own = np.array([numbers[material] for material in materials], np.int32)
            ids.append(np.repeat(own[:1], len(piece.faces)) if each.material_ids is None else own[each.material_ids])
        arrays["material_ids"] = _concatenate(ids)
    return finish_looks(arrays, list(numbers))


# The values of pieces that have none where others have: those of their faces, the middle of no texture, and white,
# which tints nothing.
_FILLERS: dict[str, Callable[[Piece], NDArray]] = {
    "normals": lambda piece: np.repeat(find_flat_normals(piece.points[piece.faces])[:, None], 3, axis=1),
    "uvs": lambda piece: np.zeros((len(piece.faces), 3, 2), np.float32),
    "colours": lambda piece: np.full((len(piece.faces), 3, 4), 255, np.uint8),
}


def _move(points: NDArray[np.number], matrix: NDArray[np.float64]) -> NDArray[np.number]:
    """Return an array of its own, so that each node has its own vertices."""
    if (matrix == np.eye(4)).all():
        return points.view()
    with np.errstate(over="ignore", invalid="ignore"):  # coordinates that are not finite are refused later
        return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3])


def _move_looks(looks: Appearance | None, matrix: NDArray[np.float64], mirrors: bool) -> Appearance | None:
    if looks is None or (matrix == np.eye(4)).all():
        return looks
    with np.errstate(all="ignore"):
        moved = looks.transformed(matrix)
    return turn_corners(moved) if mirrors else moved


def _concatenate(arrays: list[NDArray]) -> NDArray:
    return np.ascontiguousarray(arrays[0]) if len(arrays) == 1 else np.concatenate(arrays)
