"""OBJ and OFF, the formats that are lines of text: their vertices and polygons, in the file's order.

Everything else of an OBJ file (groups, materials, normals, texture coordinates) and the colours of an OFF file are
passed over. trimesh reads both too, but reorders faces, misplaces indices that are 0 or count back, and loses the end
of a file that is cut off; what mends that has to look at every line, and then only numbers are left to read.
"""

from __future__ import annotations

import re
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import MeshError
from .polygons import cut_fans

_OBJ_PASSED_OVER = re.compile(rb"#[^\r\n]*|/\S*")  # of a face's corner, only the first index is a vertex
_OBJ_KEYWORD = re.compile(rb"^[ \t]*([vf])[ \t]", re.MULTILINE)
_OBJ_VERTEX = re.compile(rb"^[ \t]*v[ \t](.*)", re.MULTILINE)
_OBJ_FACE = re.compile(rb"^[ \t]*f[ \t](.*)", re.MULTILINE)
# The letters before OFF announce more numbers per vertex; all of them follow the coordinates.
OFF_KEYWORD = re.compile(rb"\s*(?:#[^\n]*\n\s*)*(?:ST)?C?N?OFF\b")


def read_obj(data: bytes, _: Path) -> tuple[NDArray[np.float64], NDArray[np.integer]]:
    """Return the vertices (V, 3) and faces (F, 3) of an OBJ file.

    A file that is cut off exactly between two lines cannot be told from a whole one.
    """
    text = _OBJ_PASSED_OVER.sub(b"", re.sub(rb"\\\r?\n", b" ", data)).replace(b"\r", b"\n")
    vertices = _read_coordinates(_OBJ_VERTEX.findall(text))
    corners, sizes = _join_polygons([line.split() for line in _OBJ_FACE.findall(text)])
    # Vertices count from 1; a negative index counts back from the vertices that stand above the face.
    ids = np.where(corners > 0, corners - 1, -1)
    if (corners < 0).any():
        keywords = np.array(_OBJ_KEYWORD.findall(text))
        above = np.cumsum(keywords == b"v")[keywords == b"f"]
        ids = np.where(corners < 0, corners + above.repeat(sizes), ids)
    # Checked here, because the file's own numbers are needed to say which.
    wrong = np.flatnonzero((ids < 0) | (ids >= len(vertices)))
    if len(wrong):
        face = int(np.searchsorted(np.cumsum(sizes), wrong[0], side="right"))
        raise MeshError(
            f"face {face} refers to vertex {corners[wrong[0]]}, but there are {len(vertices)} vertices "
            f"(1 to {len(vertices)})"
        )
    return vertices, cut_fans(ids, sizes)


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
    vertices = _read_coordinates(lines[:vertex_count])
    # A face line is a count, so many indices, and perhaps a colour.
    rows = [line.split() for line in lines[vertex_count : vertex_count + face_count]]
    polygons = [row[1 : 1 + int(row[0])] for row in rows]
    for face, (row, polygon) in enumerate(zip(rows, polygons, strict=True)):
        if len(polygon) != int(row[0]):
            raise MeshError(f"face {face} declares {int(row[0])} corners, but its line has {len(row) - 1} more numbers")
    return vertices, cut_fans(*_join_polygons(polygons))


def _read_coordinates(lines: list[bytes]) -> NDArray[np.float64]:
    """Return the first three numbers of each line."""
    if not lines:
        raise MeshError("the mesh has no vertices")
    return np.loadtxt(lines, usecols=(0, 1, 2), ndmin=2)


def _join_polygons(polygons: list[list[bytes]]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the corners of all polygons, one behind the other, and how many each has."""
    corners = np.fromiter(map(int, chain.from_iterable(polygons)), np.int64)
    return corners, np.fromiter(map(len, polygons), np.int64)
