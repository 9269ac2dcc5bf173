"""The OFF format, as text: vertices and polygons in the file's order; colours are skipped.

No library is used for it: trimesh loses the end of a file that was cut off.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from .polygons import cut_fans, join_polygons
from .text_lines import read_coordinates

# The letters before OFF announce more numbers per vertex, all of them behind the coordinates.
OFF_KEYWORD = re.compile(rb"\s*(?:#[^\n]*\n\s*)*(?:ST)?C?N?OFF\b")


def read_off(data: bytes, _: Path) -> tuple[NDArray[np.float64], NDArray[np.integer]]:
    """Return the vertices (V, 3) and faces (F, 3) of a text OFF file."""
    keyword = OFF_KEYWORD.match(data)
    if keyword is None:
        raise MeshError("not an OFF file: it does not begin with the word 'OFF'")
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
    # The line of a face: the number of its corners, their indices, and perhaps a colour.
    rows = [line.split() for line in lines[vertex_count : vertex_count + face_count]]
    polygons = [row[1 : 1 + int(row[0])] for row in rows]
    for face, (row, polygon) in enumerate(zip(rows, polygons, strict=True)):
        if len(polygon) != int(row[0]):
            raise MeshError(f"face {face} declares {int(row[0])} corners, but its line has {len(row) - 1} more numbers")
    return vertices, cut_fans(*join_polygons(polygons))
