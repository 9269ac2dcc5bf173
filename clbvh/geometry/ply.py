"""The PLY format: ASCII, binary little-endian and big-endian, with any properties and any polygons.

Owns the header and the rows of elements. ASCII data become float64 rows first, so that both kinds are read by the
same code. Every count is held against the bytes that are there before anything of its size is made.

Greg Turk, "The PLY Polygon File Format", 1994.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import MeshError
from .polygons import cut_polygons
from .text_numbers import NotANumberError, parse_numbers

_MAX_HEADER_BYTES = 1 << 20
_END_OF_HEADER = re.compile(rb"(?:^|[\r\n])end_header[ \t]*(\r\n|\n|\r)")

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("long", "int64"), "i8"),
    **dict.fromkeys(("ulong", "uint64"), "u8"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
_STRUCT_CODES = dict(zip(("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"), "bBhHiIqQfd", strict=True))
_FACE_LISTS = ("vertex_indices", "vertex_index")
_NO_LIST = np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class _Property:
    """One property of an element; a list when it has a `count_type`."""

    name: str
    value_type: np.dtype
    count_type: np.dtype | None = None


@dataclass(frozen=True)
class _Element:
    """A table of the file: `count` rows of the same properties."""

    name: str
    count: int
    properties: tuple[_Property, ...]


@dataclass(frozen=True)
class _Column:
    """The values of one property; `sizes` says how many each row has, and is empty when the property is no list."""

    values: NDArray[np.number]
    sizes: NDArray[np.int64]


def read_ply(data: bytes, source: str) -> tuple[NDArray[np.floating], NDArray[np.int32]]:
    """Read a PLY file.

    Parameters
    ----------
    data : bytes
        The file.
    source : str
        What messages call it.

    Returns
    -------
    vertices : (V, 3) float32 or float64, object units
        float64 for ASCII files and where the file has doubles or integers.
    faces : (F, 3) int32
        In the file's order, polygons cut in place; empty for a point cloud.

    Raises
    ------
    MeshError
        Not a PLY file, cut off, longer than its header says, or an index that is no vertex.
    """
    byte_order, elements, body = _read_header(data, source)
    if byte_order == "=":
        rows = _parse_body(data, body, source).view(np.uint8)
        elements = tuple(_with_text_types(element) for element in elements)
    else:
        rows = np.frombuffer(data, dtype=np.uint8)[body:]

    columns: dict[str, dict[str, _Column]] = {}
    begin = 0
    for element in elements:
        columns[element.name], begin = _read_rows(rows, begin, element, source)
    if begin < len(rows):
        raise MeshError(
            f"{source}: the file goes on where its header says it ends, so one of the two is damaged: write it again"
        )

    vertices = _join_coordinates(columns.get("vertex", {}), source)
    face_element = next((element for element in elements if element.name == "face"), None)
    if face_element is None or face_element.count == 0:
        return vertices, np.empty((0, 3), dtype=np.int32)
    corners = columns["face"][_find_face_list(face_element, source)]
    return vertices, cut_polygons(vertices, corners.values, corners.sizes, source=source)


def _read_header(data: bytes, source: str) -> tuple[str, tuple[_Element, ...], int]:
    """Return the byte order, the elements, and where the data begin."""
    if not re.match(rb"ply\s", data):
        raise MeshError(f"{source}: not a PLY file: it does not begin with the line 'ply'")
    end = _END_OF_HEADER.search(data, 0, _MAX_HEADER_BYTES)
    if end is None:
        raise MeshError(f"{source}: the file is cut off or not a PLY file: its header has no line 'end_header'")

    byte_order = None
    tables: list[tuple[str, int, list[_Property]]] = []
    for line in re.split(r"[\r\n]+", data[: end.start()].decode("latin-1"))[1:]:
        words = line.split()
        try:
            match words:
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case ["format", name, _version]:
                    byte_order = _BYTE_ORDERS[name.lower()]
                case ["element", name, count] if int(count) >= 0:
                    tables.append((name, int(count), []))
                case ["property", "list", count_type, value_type, name] if tables:
                    tables[-1][2].append(
                        _Property(name, _find_type(value_type, byte_order), _find_type(count_type, byte_order))
                    )
                case ["property", value_type, name] if tables:
                    tables[-1][2].append(_Property(name, _find_type(value_type, byte_order)))
                case _:
                    raise ValueError(line)  # noqa: TRY301
        except (KeyError, ValueError) as error:
            raise MeshError(
                f"{source}: the PLY header has a line that makes no sense: '{line.strip()[:80]}'"
            ) from error
    if byte_order is None:
        raise MeshError(f"{source}: the PLY header has no 'format' line, so it does not say how to read the data")
    return byte_order, tuple(_Element(name, count, tuple(props)) for name, count, props in tables), end.end()


def _find_type(name: str, byte_order: str | None) -> np.dtype:
    return np.dtype(_TYPES[name.lower()]).newbyteorder(byte_order or "=")  # type: ignore[arg-type]


def _with_text_types(element: _Element) -> _Element:
    """Return the element as the rows of an ASCII file have it: each number a float64."""
    number = np.dtype(np.float64)
    return _Element(
        element.name,
        element.count,
        tuple(_Property(p.name, number, number if p.count_type else None) for p in element.properties),
    )


def _parse_body(data: bytes, body: int, source: str) -> NDArray[np.float64]:
    try:
        return parse_numbers(memoryview(data)[body:])
    except NotANumberError as error:
        line = data.count(b"\n", 0, body + error.offset) + 1
        raise MeshError(f"{source}: line {line} has '{error.token}' where a number is expected") from error


def _read_rows(rows: NDArray[np.uint8], begin: int, element: _Element, source: str) -> tuple[dict[str, _Column], int]:
    """Read one element that starts at byte `begin`; return its columns and where it ends."""
    if element.count == 0 or not element.properties:
        return {}, begin

    # Nearly always all rows are as long as the first one: then each property is one strided view.
    first = _walk_rows(rows, begin, element, 1, source)
    width = first.end - begin
    end = begin + element.count * width
    fixed = all(prop.count_type is None for prop in element.properties)
    if end > len(rows) and fixed:
        raise _cut_off(element, (len(rows) - begin) // width, source)
    if end <= len(rows):
        columns = {}
        for prop, place, size in zip(element.properties, first.places, first.sizes, strict=True):
            if prop.count_type is not None:
                at = place[0] - prop.count_type.itemsize
                if (_view(rows, prop.count_type, at, element.count, width) != size[0]).any():
                    break
                sizes = np.full(element.count, size[0], dtype=np.int64)
                step = prop.value_type.itemsize
                values = np.empty((element.count, size[0]), dtype=prop.value_type.newbyteorder("="))
                for item in range(size[0]):
                    values[:, item] = _view(rows, prop.value_type, place[0] + item * step, element.count, width)
                columns[prop.name] = _Column(values.ravel(), sizes)
            else:
                column = _view(rows, prop.value_type, place[0], element.count, width)
                columns[prop.name] = _Column(column, _NO_LIST)
        else:
            return columns, end

    # Rows of different lengths, or a file that is cut off: go from row to row.
    walk = _walk_rows(rows, begin, element, element.count, source)
    columns = {}
    for prop, place, size in zip(element.properties, walk.places, walk.sizes, strict=True):
        places = np.array(place)
        anywhere = np.ndarray((len(rows) - prop.value_type.itemsize + 1,), prop.value_type, buffer=rows, strides=(1,))
        if prop.count_type is None:
            columns[prop.name] = _Column(anywhere[places], _NO_LIST)
            continue
        sizes = np.array(size, dtype=np.int64)
        items = np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        columns[prop.name] = _Column(anywhere[np.repeat(places, sizes) + items * prop.value_type.itemsize], sizes)
    return columns, walk.end


def _view(rows: NDArray[np.uint8], dtype: np.dtype, begin: int, count: int, width: int) -> NDArray[np.number]:
    """Return the values of one type at the same place of each row."""
    return np.ndarray((count,), dtype, buffer=rows, offset=begin, strides=(width,))


@dataclass(frozen=True)
class _Walk:
    """Per property, where the value or the first list item of each row lies, and the lists' lengths."""

    places: list[list[int]]
    sizes: list[list[int]]
    end: int


def _walk_rows(rows: NDArray[np.uint8], begin: int, element: _Element, count: int, source: str) -> _Walk:
    """Go through the first `count` rows of an element and note where everything lies."""
    places: list[list[int]] = [[] for _ in element.properties]
    sizes: list[list[int]] = [[] for _ in element.properties]
    steps = [
        (place, size, prop.value_type.itemsize, prop.count_type and _make_reader(prop.count_type))
        for prop, place, size in zip(element.properties, places, sizes, strict=True)
    ]
    memory = memoryview(rows)  # type: ignore[arg-type]
    at = begin
    for row in range(count):
        for place, size, item_bytes, count_reader in steps:
            length = 1
            if count_reader is not None:
                if at + count_reader.size > len(rows):
                    raise _cut_off(element, row, source)
                (length,) = count_reader.unpack_from(memory, at)
                at += count_reader.size
                # Written so that NaN is refused, and before `int` meets an infinity.
                if not length >= 0 or (length < len(rows) and length != int(length)):
                    raise MeshError(f"{source}: row {row} of '{element.name}' has a list of {length:g} items")
            if length > (len(rows) - at) // item_bytes:
                raise _cut_off(element, row, source)
            place.append(at)
            size.append(int(length))
            at += int(length) * item_bytes
    return _Walk(places, sizes, at)


def _make_reader(dtype: np.dtype) -> struct.Struct:
    return struct.Struct(dtype.str[0].replace("|", "<") + _STRUCT_CODES[dtype.str[1:]])


def _cut_off(element: _Element, row: int, source: str) -> MeshError:
    return MeshError(
        f"{source}: the file is cut off: its header declares {element.count:,} rows of '{element.name}', "
        f"but the data end in row {row:,}"
    )


def _join_coordinates(columns: dict[str, _Column], source: str) -> NDArray[np.floating]:
    """Return x, y and z as (V, 3) vertices."""
    if not columns:
        raise MeshError(f"{source}: the mesh has no vertices")
    if missing := [axis for axis in "xyz" if axis not in columns or len(columns[axis].sizes)]:
        raise MeshError(f"{source}: the vertices have no property '{missing[0]}'")
    axes = [columns[axis].values for axis in "xyz"]
    exact = all(axis.dtype.kind == "f" and axis.dtype.itemsize <= 4 for axis in axes)
    vertices = np.empty((len(axes[0]), 3), dtype=np.float32 if exact else np.float64)
    for axis in range(3):
        vertices[:, axis] = axes[axis]
    return vertices


def _find_face_list(element: _Element, source: str) -> str:
    """Return the name of the list that holds the faces' vertices."""
    lists = [prop.name for prop in element.properties if prop.count_type is not None]
    for name in _FACE_LISTS:
        if name in lists:
            return name
    if len(lists) == 1:
        return lists[0]
    raise MeshError(f"{source}: the faces have no list '{_FACE_LISTS[0]}'")
