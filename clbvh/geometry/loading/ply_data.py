"""The data of PLY files: the header, and the rows of each element as columns of numbers.

numpy reads the numbers; no array is larger than the file allows. Must not know what the elements mean.

Greg Turk, "The PLY Polygon File Format", 1994.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from .file_mesh import Problems

MAX_HEADER_BYTES = 1 << 20
HEADER = re.compile(rb"ply[ \t]*[\r\n](.*?[\r\n])end_header[ \t]*(?:\r\n|\n|\r)", re.DOTALL)
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"},
    **{"double": "f8", "float64": "f8"},
}
_EMPTY_LINES = re.compile(rb"\n\s*\n")
_COMMENT = re.compile(rb"(?:^[ \t]*(?:comment|obj_info)\b|#)[^\n]*", re.MULTILINE)
_WHOLE_END = 2.0**63
_NUMBER = re.compile(rb"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[-+]?(?:inf|infinity|nan)", re.IGNORECASE)
# numpy takes a bare sign with the number behind the next blank. Two patterns are ten times as fast as one of both.
_BARE_SIGNS = re.compile(rb"-(?![0-9.iInN])"), re.compile(rb"\+(?![0-9.iInN])")
_KEYWORDS = ("format", "element", "property")
_AGAIN = " again "  # in names that are declared twice: those of files have no blanks
_CHUNK_BYTES = 1 << 18  # searched at a time: they stay in the cache


class Property(NamedTuple):
    """One property of an element; a list if it has a type for lengths."""

    name: str
    dtype: np.dtype
    length_dtype: np.dtype | None = None


class Element(NamedTuple):
    """A table of the file: `row_count` rows of the same properties."""

    name: str
    row_count: int
    properties: list[Property]


class Column(NamedTuple):
    """The values of one property, row after row, the number of them in each row, and their type in the file."""

    values: NDArray[np.number]
    sizes: NDArray[np.int64]
    dtype: np.dtype


Columns = Mapping[str, Column]
_Named = TypeVar("_Named", Property, Element)


def read_columns(data: bytes, problems: Problems) -> tuple[bytes, dict[str, Columns]]:
    """Return the lines of the header, and the columns of each element that has rows.

    Of elements or properties with one name the first one has it, and of rows of text that are longer than declared only
    the beginning is read; both are told.
    """
    header, byte_order, elements, begin = read_header(data)
    is_text = byte_order == "="
    if is_text:
        lines = data[begin:].replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        if any(word in lines for word in (b"#", b"comment", b"obj_info")):
            lines = _COMMENT.sub(b"", lines)
        data, begin = _EMPTY_LINES.sub(b"\n", lines).strip() + b"\n", 0
    columns: dict[str, Columns] = {}
    for element in elements:
        for name in (element.name, *[prop.name for prop in element.properties]):
            if _AGAIN in name:
                problems.add(f"'{name.split(_AGAIN)[0]}' is declared twice, and the first one is read")
        if not (element.row_count and element.properties):
            continue
        if is_text:
            columns[element.name], begin = _read_text_rows(data, begin, element, problems)
        else:
            columns[element.name], begin = _read_rows(data, begin, element)
    if data[begin:].strip():
        raise MeshError("the file goes on behind the end that its header declares, so one of the two is damaged")
    return header, columns


def read_header(data: bytes) -> tuple[bytes, str, list[Element], int]:
    """Return the lines of the header, the byte order, the elements, and the offset of the data."""
    header = HEADER.match(data, 0, MAX_HEADER_BYTES)
    if header is None:
        raise MeshError("the file is cut off or not a PLY file: it has no header from 'ply' to 'end_header'")
    byte_order = ""
    elements: list[Element] = []
    for line in header[1].splitlines():
        try:
            match line.decode("latin-1").split():
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case ["format", name, _version]:
                    byte_order = _BYTE_ORDERS[name]
                case ["element", name, count] if int(count) >= 0:
                    elements.append(Element(name, int(count), []))
                case ["property", "list", length_type, value_type, name]:
                    types = [np.dtype(byte_order + _TYPES[word]) for word in (value_type, length_type)]
                    elements[-1].properties.append(Property(name, *types))
                case ["property", value_type, name]:
                    elements[-1].properties.append(Property(name, np.dtype(byte_order + _TYPES[value_type])))
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
    named = [element._replace(properties=_name_apart(element.properties)) for element in _name_apart(elements)]
    return header[1], byte_order, named, header.end()


def _name_apart(declared: Sequence[_Named]) -> list[_Named]:
    """Return properties or elements of which those have another name whose name was declared before."""
    names = [one.name for one in declared]
    return [
        one._replace(name=f"{one.name}{_AGAIN}{at}") if one.name in names[:at] else one
        for at, one in enumerate(declared)
    ]


def _read_text_rows(data: bytes, begin: int, element: Element, problems: Problems) -> tuple[Columns, int]:
    """Convert the lines of one element to binary rows of int64 or float64, and read those."""
    end = _find_line_end(data, begin, element.row_count)
    if end < begin:
        raise _cut_off(element)
    for bare_sign in _BARE_SIGNS:
        if word := bare_sign.search(data, begin, end):
            raise MeshError(f"the lines of '{element.name}' have a '{word[0].decode()}' that is no number")
    is_whole = all(prop.dtype.kind != "f" for prop in element.properties)
    dtype = np.dtype(np.int64 if is_whole else np.float64)
    numbers = _read_numbers(data[begin:end], dtype)
    properties = [Property(prop.name, dtype, prop.length_dtype and dtype) for prop in element.properties]
    numeric = element._replace(properties=properties)
    columns: Columns = {}
    row_end = -1
    with suppress(MeshError):
        columns, row_end = _read_rows(numbers.tobytes(), 0, numeric)
    if row_end != numbers.nbytes:
        rows = _drop_surplus(data[begin:end], numeric, problems)
        columns, _ = _read_rows(rows.astype(dtype).tobytes(), 0, numeric)
    return {prop.name: columns[prop.name]._replace(dtype=prop.dtype) for prop in element.properties}, end


def _read_numbers(lines: bytes, dtype: np.dtype) -> NDArray[Any]:
    """Return the numbers of a text; not all of them, or none, where a word is no number of that type."""
    try:
        return np.fromstring(lines, dtype, sep=" ")
    except (ValueError, DeprecationWarning):
        return np.empty(0, dtype)


def _drop_surplus(lines: bytes, element: Element, problems: Problems) -> NDArray[np.float64]:
    """Return the numbers of an element's lines without those behind the last one that the header declares for a line.

    Raises
    ------
    MeshError
        A word is no number, or not a whole one where that is declared, or a line has too few.
    """
    is_word = np.frombuffer(b"\n" + lines, np.uint8) > ord(" ")
    is_begin = is_word[1:] & ~is_word[:-1]
    line_begins = np.append(0, np.flatnonzero(np.frombuffer(lines, np.uint8) == ord("\n"))[:-1] + 1)
    widths = np.add.reduceat(is_begin, line_begins, dtype=np.int64)
    numbers = _read_numbers(lines, np.dtype(np.float64))
    if len(numbers) != widths.sum():
        wrong = next((word for word in lines.split() if not _NUMBER.fullmatch(word)), b"").decode("latin-1")
        raise MeshError(f"the lines of '{element.name}' have '{wrong[:40]}' where a number is declared")
    begins = np.cumsum(widths) - widths
    declared = np.zeros(len(widths))
    for prop in element.properties:
        if prop.length_dtype is not None and (declared < widths).all():
            lengths = numbers[begins + declared.astype(np.int64)]
            if len(wrong_rows := np.flatnonzero(~(lengths >= 0) | (lengths != np.floor(lengths)))):
                raise _wrong_length(element, wrong_rows[0], lengths[wrong_rows[0]])
            declared += lengths
        declared += 1
    if len(short := np.flatnonzero(declared > widths)):
        row = short[0]
        raise MeshError(f"row {row} of '{element.name}' has {widths[row]} numbers instead of {declared[row]:.0f}")
    rows = numbers[np.arange(len(numbers)) - np.repeat(begins, widths) < np.repeat(declared, widths)]
    is_whole = (np.floor(rows) == rows) & (np.abs(rows) < _WHOLE_END)
    if element.properties[0].dtype.kind == "i" and not is_whole.all():
        number = rows[is_whole.argmin()]
        raise MeshError(f"the lines of '{element.name}' have '{number:g}' where a whole number is declared")
    if surplus := np.count_nonzero(declared < widths):
        problems.add(f"{surplus:,} rows of '{element.name}' have more numbers than are declared, which are left out")
    return rows


def _wrong_length(element: Element, row: int, length: Any) -> MeshError:
    return MeshError(f"row {row} of '{element.name}' declares a list of {length:.15g} items")


def _find_line_end(data: bytes, begin: int, line_count: int) -> int:
    """Return the offset of the line behind the next `line_count` lines, -1 if there are fewer."""
    while line_count > (count := data.count(b"\n", begin, begin + _CHUNK_BYTES)):
        line_count -= count
        begin += _CHUNK_BYTES
        if begin >= len(data):
            return -1
    line_ends = np.flatnonzero(np.frombuffer(data[begin : begin + _CHUNK_BYTES], np.uint8) == ord("\n"))
    return begin + int(line_ends[line_count - 1]) + 1


def _read_rows(data: bytes, begin: int, element: Element) -> tuple[Columns, int]:
    """Read the element at offset `begin`; return its columns and the offset of its end."""
    min_width = sum((prop.length_dtype or prop.dtype).itemsize for prop in element.properties)
    if begin + element.row_count * min_width > len(data):
        raise _cut_off(element)
    table, first = find_table(data, begin, element)
    if table is None:
        return _walk_rows(data, begin, element)
    return {
        name: Column(table[name].ravel(), sizes.repeat(element.row_count), dtype)
        for name, (_, sizes, dtype) in first.items()
    }, begin + table.nbytes


def find_table(data: bytes | memoryview, begin: int, element: Element) -> tuple[NDArray[np.void] | None, Columns]:
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


def _walk_rows(data: bytes | memoryview, begin: int, element: Element) -> tuple[Columns, int]:
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
                    raise _wrong_length(element, row, length)
                size = int(length)
                at += length_dtype.itemsize
            if at + size * dtype.itemsize > len(data):
                raise _cut_off(element)
            pieces[name].append(np.frombuffer(data, dtype, size, at))
            at += size * dtype.itemsize
    return {
        prop.name: Column(np.concatenate(rows), np.fromiter(map(len, rows), np.int64), prop.dtype)
        for prop, rows in zip(element.properties, pieces.values(), strict=True)
    }, at


def _cut_off(element: Element) -> MeshError:
    return MeshError(f"the file is cut off: its header declares {element.row_count:,} rows of '{element.name}'")
