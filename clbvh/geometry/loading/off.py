"""The OFF format, as text: vertices and polygons in the file's order, with their looks.

No library is used for it: trimesh loses the end of a file that was cut off.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from .file_mesh import FileMesh, Problems, cut_fans, report_edges
from .off_looks import OffLines, read_off_looks
from .text_lines import join_polygons, read_coordinates, read_table

# The letters before OFF announce more numbers per vertex, all of them behind the coordinates.
OFF_KEYWORD = re.compile(rb"\s*(?:#[^\n]*\n\s*)*((?:ST)?C?N?)OFF\b")
_BINARY = re.compile(rb"[ \t]+BINARY\b")


def read_off(data: bytes, _: Path, problems: Problems) -> FileMesh:
    """Return the vertices (V, 3) and faces (F, 3) of a text OFF file."""
    keyword = OFF_KEYWORD.match(data)
    if keyword is None:
        raise MeshError("not an OFF file: it does not begin with the word 'OFF'")
    if _BINARY.match(data, keyword.end()):
        raise MeshError("the file is a binary OFF file, and only text is read: save it as text, or as PLY")
    text = re.sub(rb"#[^\r\n]*", b"", data[keyword.end() :])
    counts, *lines = [line for line in text.splitlines() if line.strip()] or [b""]
    vertex_count, face_count = (int(word) for word in counts.split()[:2])
    if min(vertex_count, face_count) < 0 or len(lines) < vertex_count + face_count:
        raise MeshError(
            f"the file is cut off or damaged: it declares {vertex_count:,} vertices and {face_count:,} faces, "
            f"but has {len(lines):,} lines for them"
        )
    if len(lines) > vertex_count + face_count:
        raise MeshError(
            f"the file goes on behind the {vertex_count:,} vertices and {face_count:,} faces that it declares, "
            "so one of the two is damaged"
        )
    vertices = read_coordinates(lines[:vertex_count])
    corners, sizes = _read_faces(lines[vertex_count:])
    faces = cut_fans(corners, sizes)
    report_edges(sizes, problems)
    texts = OffLines(keyword[1].decode(), lines[:vertex_count], lines[vertex_count:])
    return FileMesh("", vertices, faces, read_off_looks(texts, vertices, faces, sizes, problems))


def _read_faces(lines: list[bytes]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the corners of all faces, concatenated, and the number of corners of each.

    The line of a face has the number of its corners, their indices, and perhaps a colour.
    """
    # Nearly always all faces have as many corners as the first.
    size = lines[0].split()[0] if lines else b""
    if size.isdigit() and int(size) < len(lines[0]):
        table = read_table(lines, range(1 + int(size)))
        if table is not None and (table[:, 0] == int(size)).all():
            return table[:, 1:].ravel(), table[:, 0]
    rows = [line.split() for line in lines]
    polygons = [row[1 : 1 + int(row[0])] for row in rows]
    for face, (row, polygon) in enumerate(zip(rows, polygons, strict=True)):
        if len(polygon) != int(row[0]):
            raise MeshError(f"face {face} declares {int(row[0])} corners, but its line has {len(row) - 1} more numbers")
    return join_polygons(polygons)
