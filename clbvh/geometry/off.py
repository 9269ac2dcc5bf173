"""The OFF format in its text form, with the optional colours, normals and texture coordinates passed over."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from ..errors import MeshError
from .polygons import cut_polygons
from .text_numbers import NotANumberError, count_tokens_per_line, parse_numbers

# The letters before OFF announce more numbers per vertex; all of them follow the coordinates.
KEYWORD = re.compile(rb"\s*(?:#[^\n]*\n\s*)*(?:ST)?C?N?OFF\b")


def read_off(data: bytes, source: str) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Read an OFF file.

    Parameters
    ----------
    data : bytes
        The file.
    source : str
        What messages call it.

    Returns
    -------
    vertices : (V, 3) float64, object units
    faces : (F, 3) int32
        In the file's order, polygons cut in place; empty for a point cloud.

    Raises
    ------
    MeshError
        Not a text OFF file, cut off, an incomplete line, or an index that is no vertex.
    """
    keyword = KEYWORD.match(data)
    if keyword is None:
        raise MeshError(f"{source}: not an OFF file: it does not begin with the word 'OFF'")
    text = data[keyword.end() :].replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if re.match(rb"\s*BINARY\b", text):
        raise MeshError(f"{source}: binary OFF files are not supported: convert it to PLY")
    if b"#" in text:
        text = re.sub(rb"#[^\n]*", b"", text)

    try:
        numbers = parse_numbers(text)
    except NotANumberError as error:
        line = data.count(b"\n", 0, keyword.end()) + text.count(b"\n", 0, error.offset) + 1
        raise MeshError(f"{source}: line {line} has '{error.token}' where a number is expected") from error
    counts = count_tokens_per_line(text)
    counts = counts[counts > 0]
    first = np.cumsum(counts) - counts
    if len(counts) == 0 or counts[0] < 2 or not (numbers[:2] >= 0).all() or (numbers[:2] % 1 != 0).any():
        raise MeshError(f"{source}: the file does not say how many vertices and faces it has")
    vertex_count, face_count = (min(int(count), 1 << 62) for count in np.minimum(numbers[:2], 1e18))
    line_count = len(counts) - 1
    if line_count < vertex_count + face_count:
        raise MeshError(
            f"{source}: the file is cut off: it declares {vertex_count:,} vertices and {face_count:,} faces, "
            f"but has {line_count:,} lines for them"
        )

    vertex_lines = slice(1, 1 + vertex_count)
    if (counts[vertex_lines] < 3).any():
        vertex = int(np.argmax(counts[vertex_lines] < 3))
        raise MeshError(f"{source}: vertex {vertex} has {counts[1 + vertex]} coordinates instead of 3")
    vertices = numbers[first[vertex_lines, None] + np.arange(3)]

    # A face line is a count, so many indices, and perhaps a colour.
    face_lines = slice(1 + vertex_count, 1 + vertex_count + face_count)
    begins = first[face_lines]
    declared = numbers[begins]
    wrong = ~((declared >= 0) & (declared < counts[face_lines]) & (declared % 1 == 0))
    if wrong.any():
        face = int(np.argmax(wrong))
        raise MeshError(
            f"{source}: face {face} declares {declared[face]:g} corners, "
            f"but its line has {counts[face_lines][face] - 1} more numbers"
        )
    sizes = declared.astype(np.int64)
    items = np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    corners = numbers[np.repeat(begins + 1, sizes) + items]
    return vertices, cut_polygons(vertices, corners, sizes, source=source)
