"""The PLY format: ASCII, binary little-endian and big-endian, with any properties, any polygons and strips.

numpy reads the numbers; no array is larger than the file allows. Looks are normals, colours and texture coordinates of
vertices or faces, and names of textures, by the names that MeshLab, Blender, VCGlib, CloudCompare and the Stanford
repository write.

Greg Turk, "The PLY Polygon File Format", 1994.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ...support.files import open_regular, read_errors_as
from ..appearance.material import Material
from ..mesh import check_face_count
from .file_mesh import (
    FileMesh,
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


_MAX_HEADER_BYTES = 1 << 20
_HEADER = re.compile(rb"ply[ \t]*[\r\n](.*?[\r\n])end_header[ \t]*(?:\r\n|\n|\r)", re.DOTALL)
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"},
    **{"double": "f8", "float64": "f8"},
}
_EMPTY_LINES = re.compile(rb"\n\s*\n")
# numpy takes a bare sign with the number behind the next blank. Two patterns are ten times as fast as one of both.
_BARE_SIGNS = re.compile(rb"-(?![0-9.iInN])"), re.compile(rb"\+(?![0-9.iInN])")
_STRIPS = "tristrips"
_FACE_KINDS = ("face", _STRIPS)
_KEYWORDS = ("format", "element", "property")
_FACE_LISTS = ("vertex_indices", "vertex_index")
_CHUNK_BYTES = 1 << 18  # searched at a time: they stay in the cache

_NORMALS = ("nx", "ny", "nz")
_COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_ALPHAS = ("alpha", "diffuse_alpha", "a")
_UVS = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
_CORNER_UVS, _TEXTURE_ID = "texcoord", "texnumber"
_TEXTURE = re.compile(rb"^comment[ \t]+texturefile[ \t]+(.+?)[ \t]*\r?$", re.IGNORECASE | re.MULTILINE)


class _Property(NamedTuple):
    """One property of an element; a list if it has a type for lengths."""

    name: str
    dtype: np.dtype
    length_dtype: np.dtype | None = None


class _Element(NamedTuple):
    """A table of the file: `row_count` rows of the same properties."""

    name: str
    row_count: int
    properties: list[_Property]


class _Column(NamedTuple):
    """The values of one property, row after row, the number of them in each row, and their type in the file."""

    values: NDArray[np.number]
    sizes: NDArray[np.int64]
    dtype: np.dtype


_Columns = Mapping[str, _Column]


def read_ply(data: bytes, file: Path, problems: Problems) -> FileMesh:
    """Return the mesh of a PLY file: vertices (V, 3), in the file's own type, faces (F, 3), and its looks."""
    # The header, and the rows of all elements.
    header, byte_order, elements, begin = _read_header(data)
    read_rows = _read_rows
    if byte_order == "=":
        lines = data[begin:].replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        data, begin = _EMPTY_LINES.sub(b"\n", lines).strip() + b"\n", 0
        read_rows = _read_text_rows
    columns: dict[str, _Columns] = {}
    for element in elements:
        if element.row_count and element.properties:
            columns[element.name], begin = read_rows(data, begin, element)
    if data[begin:].strip():
        raise MeshError("the file goes on behind the end that its header declares, so one of the two is damaged")

    # The vertices, and the corners of all polygons or strips.
    if not columns:
        return FileMesh("", np.empty((0, 3)), np.empty((0, 3), np.int64))
    if not {"x", "y", "z"} <= columns.get("vertex", {}).keys():
        raise MeshError("the mesh has no vertices with x, y and z")
    vertices = np.column_stack([columns["vertex"][axis].values for axis in "xyz"])
    if not (kinds := [kind for kind in _FACE_KINDS if kind in columns]):
        return FileMesh("", vertices, np.empty((0, 3), dtype=np.int64))
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
        faces = cut_fans(ids, sizes)
        report_edges(sizes, problems)

    # The looks: values at corners, a white material for each texture, and the texture of each face.
    looks = _read_looks(columns["vertex"], of_faces, vertices, faces, sizes, problems)
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
        data, size = opened.read(_MAX_HEADER_BYTES), os.fstat(opened.fileno()).st_size
    if _HEADER.match(data) is None:
        return None
    try:
        _, byte_order, elements, begin = _read_header(data)
        mapped, tables = np.memmap(file, np.uint8, "r"), {}
        for element in elements if byte_order == "<" else []:
            if element.row_count and (table := _find_table(mapped.data, begin, element)[0]) is not None:
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
    of_vertices: _Columns,
    of_faces: _Columns,
    vertices: NDArray[np.number],
    faces: NDArray[np.integer],
    sizes: NDArray[np.int64],
    problems: Problems,
) -> dict[str, NDArray]:
    """Return normals, colours and texture coordinates of triangles, given the numbers of corners of the polygons."""
    looks: dict[str, NDArray] = {}
    if all(name in of_vertices for name in _NORMALS):
        with problems.drop("the normals"):
            normals = np.column_stack([of_vertices[name].values for name in _NORMALS])
            looks["normals"] = spread_normals(normals, faces, vertices, faces)
    for columns in (of_vertices, of_faces):
        if "colours" not in looks and (names := _find_names(columns, _COLOURS)):
            with problems.drop("the colours"):
                channels = [columns[name] for name in [*names, *[name for name in _ALPHAS if name in columns][:1]]]
                colours = join_channels([channel.values for channel in channels], channels[0].dtype)
                ids = np.repeat(_find_polygons(sizes)[:, None], 3, axis=1) if columns is of_faces else faces
                looks["colours"] = spread_colours(colours, ids)
    if _CORNER_UVS in of_faces:
        with problems.drop("the texture coordinates"):
            looks["uvs"] = _read_corner_uvs(of_faces[_CORNER_UVS], sizes)
    elif names := _find_names(of_vertices, _UVS):
        with problems.drop("the texture coordinates"):
            looks["uvs"] = spread_uvs(np.column_stack([of_vertices[name].values for name in names]), faces)
    return looks


def _find_names(columns: _Columns, choices: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    return next((names for names in choices if all(name in columns for name in names)), ())


def _find_polygons(sizes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the polygon that each triangle was cut from, (F,) int64."""
    return np.repeat(np.arange(len(sizes)), count_triangles(sizes))


def _read_corner_uvs(column: _Column, sizes: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return the texture coordinates of lists that have two numbers for each corner of a polygon, or none."""
    if not ((column.sizes == 2 * sizes) | (column.sizes == 0)).all():
        raise MeshError("a face has not two of them for each corner")
    # Corners in the lists that are there, in their order, have the coordinates; the others have none.
    has_uvs = np.repeat(column.sizes > 0, sizes)
    slots = cut_fans(np.where(has_uvs, np.cumsum(has_uvs) - 1, -1), sizes)
    return spread_uvs(column.values.reshape(-1, 2), slots)


def _read_header(data: bytes) -> tuple[bytes, str, list[_Element], int]:
    """Return the lines of the header, the byte order, the elements, and the offset of the data."""
    header = _HEADER.match(data, 0, _MAX_HEADER_BYTES)
    if header is None:
        raise MeshError("the file is cut off or not a PLY file: it has no header from 'ply' to 'end_header'")
    byte_order = ""
    elements: list[_Element] = []
    for line in header[1].splitlines():
        try:
            match line.decode("latin-1").split():
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case ["format", name, _version]:
                    byte_order = _BYTE_ORDERS[name]
                case ["element", name, count] if int(count) >= 0:
                    elements.append(_Element(name, int(count), []))
                case ["property", "list", length_type, value_type, name]:
                    types = [np.dtype(byte_order + _TYPES[word]) for word in (value_type, length_type)]
                    elements[-1].properties.append(_Property(name, *types))
                case ["property", value_type, name]:
                    elements[-1].properties.append(_Property(name, np.dtype(byte_order + _TYPES[value_type])))
                # Above the elements, other lines say nothing of the data: some programs sign there without `comment`.
                case [word, *_] if not elements and word not in _KEYWORDS:
                    pass
                case _:
                    raise ValueError(line)  # noqa: TRY301
        except (LookupError, ValueError) as error:
            words = line.decode("latin-1").strip()[:80]
            raise MeshError(f"the PLY header has a line that is not PLY: '{words}'") from error
    if not byte_order:
        raise MeshError("the PLY header has no 'format' line, so it does not say how to read the data")
    return header[1], byte_order, elements, header.end()


def _read_text_rows(data: bytes, begin: int, element: _Element) -> tuple[_Columns, int]:
    """Convert the lines of one element to binary rows of int64 or float64, and read those."""
    end = _find_line_end(data, begin, element.row_count)
    if end < begin:
        raise _cut_off(element)
    for bare_sign in _BARE_SIGNS:
        if word := bare_sign.search(data, begin, end):
            raise MeshError(f"the lines of '{element.name}' have a '{word[0].decode()}' that is no number")
    is_whole = all(prop.dtype.kind != "f" for prop in element.properties)
    dtype = np.dtype(np.int64 if is_whole else np.float64)
    rows = np.fromstring(data[begin:end], dtype, sep=" ").tobytes()
    properties = [_Property(prop.name, dtype, prop.length_dtype and dtype) for prop in element.properties]
    columns, row_end = _read_rows(rows, 0, element._replace(properties=properties))
    if row_end != len(rows):
        raise MeshError(f"the lines of '{element.name}' have more numbers than the header declares")
    return {prop.name: columns[prop.name]._replace(dtype=prop.dtype) for prop in element.properties}, end


def _find_line_end(data: bytes, begin: int, line_count: int) -> int:
    """Return the offset of the line behind the next `line_count` lines, -1 if there are fewer."""
    while line_count > (count := data.count(b"\n", begin, begin + _CHUNK_BYTES)):
        line_count -= count
        begin += _CHUNK_BYTES
        if begin >= len(data):
            return -1
    line_ends = np.flatnonzero(np.frombuffer(data[begin : begin + _CHUNK_BYTES], np.uint8) == ord("\n"))
    return begin + int(line_ends[line_count - 1]) + 1


def _read_rows(data: bytes, begin: int, element: _Element) -> tuple[_Columns, int]:
    """Read the element at offset `begin`; return its columns and the offset of its end."""
    min_width = sum((prop.length_dtype or prop.dtype).itemsize for prop in element.properties)
    if begin + element.row_count * min_width > len(data):
        raise _cut_off(element)
    table, first = _find_table(data, begin, element)
    if table is None:
        return _walk_rows(data, begin, element)
    return {
        name: _Column(table[name].ravel(), sizes.repeat(element.row_count), dtype)
        for name, (_, sizes, dtype) in first.items()
    }, begin + table.nbytes


def _find_table(data: bytes | memoryview, begin: int, element: _Element) -> tuple[NDArray[np.void] | None, _Columns]:
    """Return the rows of an element as a view, or None where they are no table; and the first row."""
    # The lists of all rows are nearly always as long as those of the first row: then the rows are a table.
    first, first_end = _walk_rows(data, begin, element._replace(row_count=1))
    if begin + element.row_count * (first_end - begin) > len(data):
        return None, first
    fields: list[tuple[str, np.dtype, tuple[int, ...]]] = []
    for name, dtype, length_dtype in element.properties:
        fields += [(f"{name} length", length_dtype, ())] if length_dtype else []
        fields += [(name, dtype, first[name].values.shape)]
    table = np.frombuffer(data, fields, element.row_count, begin)
    lists = [prop.name for prop in element.properties if prop.length_dtype]
    is_table = all((table[f"{name} length"] == first[name].sizes).all() for name in lists)
    return table if is_table else None, first


def _walk_rows(data: bytes | memoryview, begin: int, element: _Element) -> tuple[_Columns, int]:
    """Read an element row by row."""
    pieces: dict[str, list[NDArray[np.number]]] = {prop.name: [] for prop in element.properties}
    at = begin
    for row in range(element.row_count):
        for name, dtype, length_dtype in element.properties:
            size = 1
            if length_dtype is not None:
                if at + length_dtype.itemsize > len(data):
                    raise _cut_off(element)
                length = np.frombuffer(data, length_dtype, 1, at)[0]
                # Written so that NaN and infinity are refused before `int` meets them.
                if not (0 <= length <= len(data) and length == int(length)):
                    raise MeshError(f"row {row} of '{element.name}' declares a list of {length} items")
                size = int(length)
                at += length_dtype.itemsize
            if at + size * dtype.itemsize > len(data):
                raise _cut_off(element)
            pieces[name].append(np.frombuffer(data, dtype, size, at))
            at += size * dtype.itemsize
    return {
        prop.name: _Column(np.concatenate(rows), np.fromiter(map(len, rows), np.int64), prop.dtype)
        for prop, rows in zip(element.properties, pieces.values(), strict=True)
    }, at


def _cut_off(element: _Element) -> MeshError:
    return MeshError(f"the file is cut off: its header declares {element.row_count:,} rows of '{element.name}'")
