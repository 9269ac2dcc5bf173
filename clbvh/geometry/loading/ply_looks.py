"""The looks in a PLY file: normals, colours and texture coordinates of vertices or faces, and names of textures.

The names of properties are those that MeshLab, Blender, VCGlib, CloudCompare and the Stanford repository write.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
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
    spread_colours,
    spread_normals,
    spread_uvs,
)
from .texture_files import TextureFiles

_NORMALS = ("nx", "ny", "nz")
_COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_ALPHAS = ("alpha", "diffuse_alpha", "a")
_UVS = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
_CORNER_UVS, _TEXTURE_ID = "texcoord", "texnumber"
_TEXTURE = re.compile(rb"^comment[ \t]+texturefile[ \t]+(.+?)[ \t]*\r?$", re.IGNORECASE | re.MULTILINE)


class PlyColumn(NamedTuple):
    """The values of one property, row after row, the number of them in each row, and their type in the file."""

    values: NDArray[np.number]
    sizes: NDArray[np.int64]
    dtype: np.dtype


class PlyTriangles(NamedTuple):
    """The triangles of a file, (V, 3) and (F, 3), and the number of corners of each of its polygons.

    The sizes are None if all polygons are triangles.
    """

    vertices: NDArray[np.number]
    faces: NDArray[np.integer]
    sizes: NDArray[np.int64] | None


def read_ply_looks(
    header: bytes,
    vertex_columns: Mapping[str, PlyColumn],
    face_columns: Mapping[str, PlyColumn],
    triangles: PlyTriangles,
    folder: Path,
    problems: Problems,
) -> Appearance | None:
    """Return the looks of a file's triangles, None if it says nothing of them."""
    looks: dict[str, NDArray] = {}
    vertices, faces, _ = triangles
    if all(name in vertex_columns for name in _NORMALS):
        with problems.drop("the normals"):
            normals = np.column_stack([vertex_columns[name].values for name in _NORMALS])
            looks["normals"] = spread_normals(normals, faces, vertices, faces)
    for columns in (vertex_columns, face_columns):
        if "colours" not in looks and (names := _find_names(columns, _COLOURS)):
            with problems.drop("the colours"):
                channels = [columns[name] for name in [*names, *[name for name in _ALPHAS if name in columns][:1]]]
                colours = join_channels([channel.values for channel in channels], channels[0].dtype)
                is_of_faces = columns is face_columns
                ids = np.repeat(_find_polygons(triangles)[:, None], 3, axis=1) if is_of_faces else faces
                looks["colours"] = spread_colours(colours, ids)
    if _CORNER_UVS in face_columns:
        with problems.drop("the texture coordinates"):
            looks["uvs"] = _read_corner_uvs(face_columns[_CORNER_UVS], triangles)
    elif names := _find_names(vertex_columns, _UVS):
        with problems.drop("the texture coordinates"):
            looks["uvs"] = spread_uvs(np.column_stack([vertex_columns[name].values for name in names]), faces)
    materials: list[Material] = []
    if "uvs" in looks and (textures := _TEXTURE.findall(header)):
        materials = _read_materials(textures, TextureFiles(folder, problems))
        if len(materials) > 1 and _TEXTURE_ID in face_columns:
            with problems.drop("the numbers of the textures"):
                ids = face_columns[_TEXTURE_ID].values.astype(np.int64)
                is_known = (ids >= 0) & (ids < len(materials))
                if not is_known.all():
                    ids = np.where(is_known, ids, len(materials))
                    materials.append(Material(base_colour=(1.0, 1.0, 1.0)))
                looks["material_ids"] = ids[_find_polygons(triangles)].astype(np.int32)
    return finish_looks(looks, materials)


def _find_names(columns: Mapping[str, PlyColumn], choices: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    return next((names for names in choices if all(name in columns for name in names)), ())


def _find_polygons(triangles: PlyTriangles) -> NDArray[np.int64]:
    """Return the polygon that each triangle was cut from, (F,) int64."""
    if triangles.sizes is None:
        return np.arange(len(triangles.faces))
    return np.repeat(np.arange(len(triangles.sizes)), count_triangles(triangles.sizes))


def _read_corner_uvs(column: PlyColumn, triangles: PlyTriangles) -> NDArray[np.float32]:
    """Return the texture coordinates of lists that have two numbers for each corner of a polygon, or none."""
    sizes = np.full(len(triangles.faces), 3) if triangles.sizes is None else triangles.sizes
    if len(sizes) != len(column.sizes) or not ((column.sizes == 2 * sizes) | (column.sizes == 0)).all():
        raise MeshError("a face has not two of them for each corner")
    slots = cut_fans(np.arange(sizes.sum()), sizes)
    uvs = column.values.reshape(-1, 2)
    if len(uvs) == sizes.sum():
        return spread_uvs(uvs, slots)
    # Corners in the lists that are there, in their order, have the coordinates; the others have none.
    has_uvs = np.repeat(column.sizes > 0, sizes)
    return spread_uvs(uvs, np.where(has_uvs, np.cumsum(has_uvs) - 1, -1)[slots])


def _read_materials(names: list[bytes], textures: TextureFiles) -> list[Material]:
    """Return a white material for each texture."""
    texts = [name.decode("utf-8", "replace") for name in names]
    return [
        Material(text, base_colour=(1.0, 1.0, 1.0), base_colour_texture=textures.read(text, is_srgb=True))
        for text in texts
    ]
