"""The PLY format: ASCII, binary little-endian and big-endian, with any properties, any polygons and strips.

numpy reads the numbers; no array is larger than the file allows. Looks are normals, colours and texture coordinates of
vertices or faces, and names of textures, by the names that MeshLab, Blender, VCGlib, CloudCompare and the Stanford
repository write.

Greg Turk, "The PLY Polygon File Format", 1994.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ...support.files import open_regular, read_errors_as
from ..appearance.material import Material
from ..mesh import check_face_count
from .file_mesh import (
    FileMesh,
    Problems,
    finish_looks,
    join_channels,
    spread_colours,
    spread_normals,
    spread_uvs,
)
from .ply_data import (
    HEADER,
    MAX_HEADER_BYTES,
    Column,
    Columns,
    find_table,
    read_columns,
    read_header,
)
from .polygons import count_triangles, cut_polygons, report_edges
from .texture_files import TextureFiles

# In place of a vertex: the next one begins another strip.
RESTART = -1


def cut_strips(corners: NDArray[np.integer], sizes: NDArray[np.integer]) -> NDArray[np.integer]:
    """Cut strips into triangles.

    Parameters
    ----------
    corners : (n,) int
        Vertex indices of all strips, concatenated; -1 ends a strip within a list as well.
    sizes : (s,) int
        Numbers per list.

    Returns
    -------
    (F, 3) int
        Triangles in the order of the strips, all wound like the first of their strip. Without those that have a vertex
        twice: they lead a strip round a corner, and are no surface.

    Raises
    ------
    MeshError
        The triangles do not fit the memory.
    """
    check_face_count(len(corners))
    numbers = np.insert(corners, np.cumsum(sizes)[:-1], RESTART)
    if len(numbers) < 3:
        return np.empty((0, 3), np.int64)
    positions = np.arange(len(numbers))
    begins = np.maximum.accumulate(np.where(numbers == RESTART, positions + 1, 0))
    triangles = np.lib.stride_tricks.sliding_window_view(numbers, 3).copy()
    # Every second triangle of a strip is wound the other way round.
    is_odd = (positions - begins)[:-2] % 2 == 1
    triangles[is_odd, 1:] = triangles[is_odd, :0:-1]
    first, second, third = triangles.T
    is_whole = (triangles != RESTART).all(axis=1)
    return triangles[is_whole & (first != second) & (second != third) & (third != first)]


_STRIPS = "tristrips"
_FACE_KINDS = ("face", _STRIPS)
_FACE_LISTS = ("vertex_indices", "vertex_index")
_NORMALS = ("nx", "ny", "nz")
_COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_ALPHAS = ("alpha", "diffuse_alpha", "a")
_UVS = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
_CORNER_UVS, _TEXTURE_ID = "texcoord", "texnumber"
_TEXTURE = re.compile(rb"^comment[ \t]+texturefile[ \t]+(.+?)[ \t]*\r?$", re.IGNORECASE | re.MULTILINE)


def read_ply(data: bytes, file: Path, problems: Problems) -> FileMesh:
    """Return the mesh of a PLY file: vertices (V, 3), in the file's own type, faces (F, 3), and its looks."""
    header, columns = read_columns(data, problems)

    # The vertices, and the corners of all polygons or strips.
    if not columns:
        return FileMesh("", np.empty((0, 3)), np.empty((0, 3), np.int64))
    if not {"x", "y", "z"} <= columns.get("vertex", {}).keys():
        raise MeshError("the mesh has no vertices with x, y and z")
    vertices = np.column_stack([columns["vertex"][axis].values for axis in "xyz"])
    if not (kinds := [kind for kind in _FACE_KINDS if kind in columns]):
        no_faces = np.empty((0, 3), dtype=np.int64)
        return FileMesh("", vertices, no_faces, point_colours=_read_point_colours(columns["vertex"], problems))
    of_faces = columns[kinds[0]]
    if not (names := [name for name in _FACE_LISTS if name in of_faces]):
        raise MeshError(f"the faces have no list '{_FACE_LISTS[0]}'")
    corners, sizes, _ = of_faces[names[0]]
    ids: NDArray[Any] = corners
    if corners.dtype.kind != "i":
        with np.errstate(invalid="ignore"):
            ids = corners.astype(np.int64)
        if (ids != corners).any():
            corner = int(np.argmax(ids != corners))
            face = int(np.searchsorted(np.cumsum(sizes), corner, side="right"))
            raise MeshError(f"face {face} refers to vertex {corners[corner]}, which is no whole number")
    if kinds[0] == _STRIPS:
        faces, of_faces = cut_strips(ids, sizes), {}
    else:
        faces = cut_polygons(ids, sizes, ids, vertices)
        report_edges(sizes, problems)

    if len(faces) == 0:
        return FileMesh("", vertices, faces, point_colours=_read_point_colours(columns["vertex"], problems))

    # The looks: values at corners, a white material for each texture, and the texture of each face.
    looks = _read_looks(columns["vertex"], of_faces, vertices, faces, (ids, sizes), problems)
    materials: list[Material] = []
    if "uvs" in looks and (names := [name.decode("utf-8", "replace") for name in _TEXTURE.findall(header)]):
        textures = TextureFiles(file.parent, problems)
        white = (1.0, 1.0, 1.0)
        materials = [Material(name, white, base_colour_texture=textures.read(name, is_srgb=True)) for name in names]
        if len(materials) > 1 and _TEXTURE_ID in of_faces:
            with problems.drop("the numbers of the textures"):
                ids = of_faces[_TEXTURE_ID].values.astype(np.int64)
                is_known = (ids >= 0) & (ids < len(materials))
                if not is_known.all():
                    ids = np.where(is_known, ids, len(materials))
                    materials.append(Material(base_colour=white))
                looks["material_ids"] = ids[_find_polygons(sizes)].astype(np.int32)
    return FileMesh("", vertices, faces, finish_looks(looks, materials))


def map_triangles(file: Path) -> tuple[NDArray[np.floating], NDArray[np.integer]] | None:
    """Return the vertices (V, 3) and the faces (F, 3) of a file of triangles without reading them: views of the file.

    None where the file is not laid out as two tables of little-endian numbers, vertices and triangles; `read_ply` reads
    it then, or finds its fault. Vertex indices are not checked.

    Raises
    ------
    MeshError
        The file cannot be read, or its header is damaged.
    """
    with read_errors_as(MeshError, file), open_regular(file) as opened:
        data, size = opened.read(MAX_HEADER_BYTES), os.fstat(opened.fileno()).st_size
    if HEADER.match(data) is None:
        return None
    try:
        _, byte_order, elements, begin = read_header(data)
        mapped, tables = np.memmap(file, np.uint8, "r"), {}
        for element in elements if byte_order == "<" else []:
            if element.row_count and (table := find_table(mapped.data, begin, element)[0]) is not None:
                tables[element.name], begin = table, begin + table.nbytes
    except MeshError as error:
        raise MeshError(f"{file}: {error}") from error
    if list(tables) != ["vertex", "face"] or begin != size:
        return None
    # The coordinates must lie side by side, and every face must be a triangle.
    fields, names = dict(tables["vertex"].dtype.fields or {}), tables["face"].dtype.names or ()
    points = [(fields[axis][0].base, fields[axis][1]) for axis in "xyz" if axis in fields]
    corners = next((tables["face"][name] for name in _FACE_LISTS if name in names), None)
    if corners is None or corners.shape[1:] != (3,) or corners.dtype.kind == "f" or not points:
        return None
    kind, at = points[0]
    if points != [(kind, at + axis * kind.itemsize) for axis in range(3)]:
        return None
    point = np.dtype(
        {"names": ["xyz"], "formats": [(kind, (3,))], "offsets": [at], "itemsize": tables["vertex"].itemsize}
    )
    return tables["vertex"].view(point)["xyz"], corners


def _read_looks(
    of_vertices: Columns,
    of_faces: Columns,
    vertices: NDArray[np.number],
    faces: NDArray[np.integer],
    polygons: tuple[NDArray[np.integer], NDArray[np.int64]],
    problems: Problems,
) -> dict[str, NDArray]:
    """Return normals, colours and texture coordinates of triangles, given the corners of all polygons, and of each."""
    _, sizes = polygons
    looks: dict[str, NDArray] = {}
    if all(name in of_vertices for name in _NORMALS):
        with problems.drop("the normals"):
            normals = np.column_stack([of_vertices[name].values for name in _NORMALS])
            looks["normals"] = spread_normals(normals, faces, vertices, faces)
    for columns in (of_vertices, of_faces):
        if "colours" not in looks and _find_names(columns, _COLOURS):
            with problems.drop("the colours"):
                colours = _join_colours(columns)
                ids = np.repeat(_find_polygons(sizes)[:, None], 3, axis=1) if columns is of_faces else faces
                looks["colours"] = spread_colours(colours, ids)
    if _CORNER_UVS in of_faces:
        with problems.drop("the texture coordinates"):
            looks["uvs"] = _read_corner_uvs(of_faces[_CORNER_UVS], *polygons, vertices)
    elif names := _find_names(of_vertices, _UVS):
        with problems.drop("the texture coordinates"):
            looks["uvs"] = spread_uvs(np.column_stack([of_vertices[name].values for name in names]), faces)
    return looks


def _read_point_colours(columns: Columns, problems: Problems) -> NDArray[np.uint8] | None:
    if _find_names(columns, _COLOURS):
        with problems.drop("the colours"):
            return _join_colours(columns)
    return None


def _join_colours(columns: Columns) -> NDArray[np.uint8]:
    """Return the colours of an element that has some, (n, 4) uint8."""
    names = [*_find_names(columns, _COLOURS), *[name for name in _ALPHAS if name in columns][:1]]
    return join_channels([columns[name].values for name in names], columns[names[0]].dtype)


def _find_names(columns: Columns, choices: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    return next((names for names in choices if all(name in columns for name in names)), ())


def _find_polygons(sizes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the polygon that each triangle was cut from, (F,) int64."""
    return np.repeat(np.arange(len(sizes)), count_triangles(sizes))


def _read_corner_uvs(
    column: Column, corners: NDArray[np.integer], sizes: NDArray[np.int64], vertices: NDArray[np.number]
) -> NDArray[np.float32]:
    """Return the texture coordinates of lists that have two numbers for each corner of a polygon, or none."""
    if not ((column.sizes == 2 * sizes) | (column.sizes == 0)).all():
        raise MeshError("a face has not two of them for each corner")
    # Corners in the lists that are there, in their order, have the coordinates; the others have none.
    has_uvs = np.repeat(column.sizes > 0, sizes)
    slots = cut_polygons(np.where(has_uvs, np.cumsum(has_uvs) - 1, -1), sizes, corners, vertices)
    return spread_uvs(column.values.reshape(-1, 2), slots)
