"""The OBJ format: vertices and polygons in the file's order.

Groups, materials, normals, texture coordinates, colours, points and lines are skipped; statements whose surfaces would
be missing from the mesh are refused. No library is used for it: trimesh reorders faces, misplaces indices that are 0 or
count back, and loses the end of a file that was cut off.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from .polygons import cut_fans, join_polygons
from .text_lines import read_coordinates

# Comments end with their line even if that ends with a backslash, so they are dropped before lines are joined.
_COMMENTS_AND_OTHER_INDICES = re.compile(rb"#[^\n]*|/\S*")  # only the first index of a face's corner is a vertex
_CONTINUATION = re.compile(rb"\\[ \t]*\n")
_KEYWORD = re.compile(rb"^[ \t]*([vf])(?=\s|\Z)", re.MULTILINE)
_VERTEX = re.compile(rb"^[ \t]*v(?=\s|\Z)(.*)", re.MULTILINE)
_FACE = re.compile(rb"^[ \t]*f(?=\s|\Z)(.*)", re.MULTILINE)
_UNSUPPORTED = re.compile(rb"^[ \t]*(surf|call|fo|bsp|bzp|cdp|res)[ \t]", re.MULTILINE)


def read_obj(data: bytes, _: Path) -> tuple[NDArray[np.float64], NDArray[np.integer]]:
    """Return the vertices (V, 3) and faces (F, 3) of an OBJ file.

    A file that was cut off between two lines cannot be told from a complete one.
    """
    text = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    text = _CONTINUATION.sub(b" ", _COMMENTS_AND_OTHER_INDICES.sub(b"", text))
    if unsupported := _UNSUPPORTED.search(text):
        raise MeshError(
            f"the statement '{unsupported[1].decode()}' is not read: an OBJ file may have polygons only, written as "
            "'v' and 'f' lines"
        )
    vertices = read_coordinates(_VERTEX.findall(text))
    corners, sizes = join_polygons([line.split() for line in _FACE.findall(text)])
    # Vertices count from 1; a negative index counts back from the last vertex above the face.
    ids = np.where(corners > 0, corners - 1, -1)
    if (corners < 0).any():
        keywords = np.array(_KEYWORD.findall(text))
        above = np.cumsum(keywords == b"v")[keywords == b"f"]
        ids = np.where(corners < 0, corners + above.repeat(sizes), ids)
    # Checked here, because the message needs the numbers of the file.
    wrong = np.flatnonzero((ids < 0) | (ids >= len(vertices)))
    if len(wrong):
        face = int(np.searchsorted(np.cumsum(sizes), wrong[0], side="right"))
        raise MeshError(
            f"face {face} refers to vertex {corners[wrong[0]]}, but there are {len(vertices)} vertices "
            f"(1 to {len(vertices)})"
        )
    return vertices, cut_fans(ids, sizes)
