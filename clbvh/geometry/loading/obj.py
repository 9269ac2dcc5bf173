"""The OBJ format: vertices and polygons in the file's order.

Groups, materials, normals and texture coordinates are skipped. trimesh reads OBJ too, but reorders faces, misplaces
indices that are 0 or count back, and loses the end of a file that was cut off. Code that repairs this has to look at
every line, and then only numbers are left to read.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from .polygons import cut_fans, join_polygons
from .text_lines import read_coordinates

_COMMENTS_AND_OTHER_INDICES = re.compile(rb"#[^\r\n]*|/\S*")  # only the first index of a face's corner is a vertex
_KEYWORD = re.compile(rb"^[ \t]*([vf])[ \t]", re.MULTILINE)
_VERTEX = re.compile(rb"^[ \t]*v[ \t](.*)", re.MULTILINE)
_FACE = re.compile(rb"^[ \t]*f[ \t](.*)", re.MULTILINE)


def read_obj(data: bytes, _: Path) -> tuple[NDArray[np.float64], NDArray[np.integer]]:
    """Return the vertices (V, 3) and faces (F, 3) of an OBJ file.

    A file that was cut off between two lines cannot be told from a complete one.
    """
    text = _COMMENTS_AND_OTHER_INDICES.sub(b"", re.sub(rb"\\\r?\n", b" ", data)).replace(b"\r", b"\n")
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
