"""The looks in an OBJ file: normals and texture coordinates of corners, colours of vertices, materials of faces."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ..appearance.appearance import Appearance
from ..appearance.material import Material
from .file_mesh import (
    Problems,
    count_triangles,
    cut_fans,
    finish_looks,
    join_channels,
    report_edges,
    spread_colours,
    spread_normals,
    spread_uvs,
)
from .mtl import read_materials
from .obj_lines import NORMAL, UV, ObjCorners, ObjLines, resolve_indices
from .obj_statements import ObjStatements
from .texture_files import TextureFiles

# Numbers in the line of a vertex with a colour: behind x, y and z, or behind the weight.
_COLOUR_AT = {6: 3, 7: 4}

_SMOOTHING, _USE, _LIBRARY = b"s", b"usemtl", b"mtllib"
_NOT_SMOOTH = (b"off", b"0")


class ObjMesh(NamedTuple):
    """The triangles of a file, and what tells of their looks.

    Attributes
    ----------
    vertices, faces : (V, 3) float64 and (F, 3) int
    sizes : (p,) int64
        Corners per polygon.
    numbers : (V, n) float64, or None
        All numbers of the vertices' lines. None if they differ in length.
    corners : ObjCorners, or None
        None if a corner has words that are no indices.
    lines : ObjLines
    statements : ObjStatements
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.integer]
    sizes: NDArray[np.int64]
    numbers: NDArray[np.float64] | None
    corners: ObjCorners | None
    lines: ObjLines
    statements: ObjStatements


def read_obj_looks(
    mesh: ObjMesh, folder: Path, problems: Problems
) -> tuple[Appearance | None, NDArray[np.bool_] | None]:
    """Return the looks of a file's triangles, and which of them it declares flat; None for what it does not say."""
    looks: dict[str, NDArray] = {}
    report_edges(mesh.sizes, problems)
    if mesh.corners is None:
        problems.add("the texture coordinates and normals cannot be used: a corner has words that are no indices")
    else:
        # The slot of each triangle's corners in the list of all corners.
        slots = cut_fans(np.arange(len(mesh.corners.indices)), mesh.sizes)
        with problems.drop("the normals"):
            if (ids := _find_ids(mesh, mesh.corners, 2, NORMAL)) is not None:
                normals = _read_lines(mesh.lines, NORMAL, 3)
                looks["normals"] = spread_normals(normals, ids[slots], mesh.vertices, mesh.faces)
        with problems.drop("the texture coordinates"):
            if (ids := _find_ids(mesh, mesh.corners, 1, UV)) is not None:
                looks["uvs"] = spread_uvs(_read_lines(mesh.lines, UV, 2), ids[slots])
    if mesh.numbers is not None and (at := _COLOUR_AT.get(mesh.numbers.shape[1])):
        with problems.drop("the colours"):
            channels = list(mesh.numbers[:, at : at + 3].T)
            looks["colours"] = spread_colours(join_channels(channels, mesh.numbers.dtype), mesh.faces)
    materials: list[Material] = []
    if mesh.statements.has(_USE):
        with problems.drop("the materials"):
            materials, used = _read_materials(mesh.statements, folder, problems)
            if len(materials) > 1:
                looks["material_ids"] = np.repeat(used, count_triangles(mesh.sizes))
    flat = None
    if "normals" not in looks and any(words.lower() in _NOT_SMOOTH for words in mesh.statements.words_of(_SMOOTHING)):
        is_flat = [False, *[words.lower() in _NOT_SMOOTH for words in mesh.statements.words_of(_SMOOTHING)]]
        flat = np.repeat(np.array(is_flat)[1 + mesh.statements.find_above(_SMOOTHING)], count_triangles(mesh.sizes))
    return finish_looks(looks, materials), flat


def _find_ids(mesh: ObjMesh, corners: ObjCorners, slot: int, kind: int) -> NDArray[np.int64] | None:
    """Return the indices from 0 in one slot of all corners; None if no corner has one."""
    indices = corners.indices[:, slot]
    return resolve_indices(indices, corners.sizes, mesh.lines, kind) if indices.any() else None


def _read_lines(lines: ObjLines, kind: int, width: int) -> NDArray[np.float64]:
    """Return the first numbers of all lines of a kind."""
    numbers = lines.read_numbers(kind)
    if numbers is None:
        padded = [words + b" 0" for words in lines.list_words(kind)]
        if not padded:
            raise MeshError("corners refer to them, but there are none")
        numbers = np.loadtxt(padded, usecols=range(width), ndmin=2, comments=None)
    if numbers.shape[1] < width:  # one coordinate, of a texture that is a line
        numbers = np.column_stack((numbers, np.zeros((len(numbers), width - numbers.shape[1]))))
    return numbers[:, :width]


def _read_materials(
    statements: ObjStatements, folder: Path, problems: Problems
) -> tuple[list[Material], NDArray[np.int32]]:
    """Return the materials that faces use, and the one of each polygon."""
    textures = TextureFiles(folder, problems)
    known: dict[bytes, Material] = {}
    for words in statements.words_of(_LIBRARY):
        known = read_materials(words, folder, textures, problems) | known
    numbers: dict[bytes, int] = {}
    ids = [numbers.setdefault(name, len(numbers)) for name in statements.words_of(_USE)]
    if not any(name in known for name in numbers):
        return [], np.zeros(0, np.int32)
    missing = [name for name in numbers if name not in known]
    if missing:
        names = ", ".join(f"'{name.decode('utf-8', 'replace')[:40]}'" for name in missing[:3])
        problems.add(f"the materials {names}{', ...' if len(missing) > 3 else ''} are missing from the .mtl files")
    materials = [known.get(name) or Material(name.decode("utf-8", "replace")) for name in numbers]
    above = statements.find_above(_USE)
    if (above < 0).any():
        # Faces above the first statement have no material of the file.
        ids.append(len(materials))
        materials.append(Material())
    return materials, np.array(ids, np.int32)[above]
