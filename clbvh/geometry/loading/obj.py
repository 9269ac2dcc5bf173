"""The OBJ format: vertices and polygons in the file's order, or object by object.

Materials, normals, texture coordinates, colours, points and lines are skipped; statements whose surfaces would
be missing from the mesh are refused. No library is used for it: trimesh reorders faces, misplaces indices that are 0 or
count back, and loses the end of a file that was cut off.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from .parts import FileMesh, FileNode, FileParts, drop_loose_vertices
from .polygons import cut_fans
from .text_lines import join_polygons, read_coordinates, read_table

# Comments end with their line even if that ends with a backslash, so they are dropped before lines are joined.
_COMMENT = re.compile(rb"#[^\n]*")
_OTHER_INDICES = re.compile(rb"/\S*")  # only the first index of a face's corner is a vertex
_CONTINUATION = re.compile(rb"\\[ \t]*\n")
# Curves and surfaces that the polygons do not cover, and files that are read in between.
_UNSUPPORTED = (b"surf", b"call", b"fo", b"bsp", b"bzp", b"cdp", b"res")
_KEYWORDS = b"v|f|" + b"|".join(_UNSUPPORTED)
_STATEMENT = re.compile(rb"^[ \t]*(" + _KEYWORDS + rb")(?=\s|\Z)(.*)", re.MULTILINE)
# The same with the names of objects and groups, which may hold what would end the index of a corner.
_OBJECT, _GROUP = b"o", b"g"
_OTHER_INDICES_OR_NAME = re.compile(rb"^([ \t]*[og][ \t].*)|/\S*", re.MULTILINE)
_STATEMENT_OR_NAME = re.compile(rb"^[ \t]*(o|g|" + _KEYWORDS + rb")(?=\s|\Z)(.*)", re.MULTILINE)


def read_obj(data: bytes, _: Path) -> tuple[NDArray[np.float64], NDArray[np.integer]]:
    """Return the vertices (V, 3) and faces (F, 3) of an OBJ file.

    A file that was cut off between two lines cannot be told from a complete one.
    """
    text = _CONTINUATION.sub(b" ", _OTHER_INDICES.sub(b"", _strip_comments(data)))
    vertices, corners, sizes = _read_polygons(_STATEMENT.findall(text))
    return vertices, cut_fans(corners, sizes)


def read_obj_parts(data: bytes, _: Path) -> FileParts:
    """Return the objects of an OBJ file, each with the vertices that its faces refer to.

    The parts are those of the `o` statements, or of the `g` statements in a file without any. Faces above the first
    one are a part without a name; those below a second statement of one name belong to the first one's part.
    """
    text = _CONTINUATION.sub(b" ", _OTHER_INDICES_OR_NAME.sub(rb"\1", _strip_comments(data)))
    statements = _STATEMENT_OR_NAME.findall(text)
    vertices, corners, sizes = _read_polygons(statements)
    faces = cut_fans(corners, sizes)

    # The part of each polygon, and of each of its triangles.
    keywords = [keyword for keyword, _ in statements]
    mark = _OBJECT if _OBJECT in keywords else _GROUP
    numbers: dict[bytes, int] = {}
    parts, part = [], numbers.setdefault(b"", 0)
    for keyword, words in statements:
        if keyword == mark:
            part = numbers.setdefault(b" ".join(words.split()), len(numbers))
        elif keyword == b"f":
            parts.append(part)
    part_of_face = np.repeat(np.array(parts, np.int64), sizes - 2)

    order = np.argsort(part_of_face, kind="stable")
    ends = np.searchsorted(part_of_face[order], np.arange(len(numbers)), side="right")
    meshes = [
        FileMesh(name.decode("utf-8", "replace"), *drop_loose_vertices(vertices, faces[ids]))
        for name, ids in zip(numbers, np.split(order, ends[:-1]), strict=True)
        if len(ids)
    ]
    return FileParts(meshes, [FileNode(mesh.name, number, np.eye(4)) for number, mesh in enumerate(meshes)])


def _strip_comments(data: bytes) -> bytes:
    return _COMMENT.sub(b"", data.replace(b"\r\n", b"\n").replace(b"\r", b"\n"))


def _read_polygons(
    statements: list[tuple[bytes, bytes]],
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the vertices (V, 3), the corners of all polygons as vertex indices from 0, and the number of each."""
    unsupported = {keyword for keyword, _ in statements}.intersection(_UNSUPPORTED)
    if unsupported:
        raise MeshError(
            f"the statement '{min(unsupported).decode()}' is not read: a mesh is made of 'v' and 'f' statements"
        )
    vertices = read_coordinates([words for keyword, words in statements if keyword == b"v"])
    corners, sizes = _read_faces([words for keyword, words in statements if keyword == b"f"])
    # Vertices count from 1; a negative index counts back from the last vertex above the face.
    ids = np.where(corners > 0, corners - 1, -1)
    if (corners < 0).any():
        keywords = np.array([keyword for keyword, _ in statements])
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
    return vertices, ids, sizes


def _read_faces(lines: list[bytes]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the corners of all faces as the file counts them, concatenated, and the number of corners of each."""
    table = read_table(lines)
    if table is None:
        return join_polygons([line.split() for line in lines])
    return table.ravel(), np.full(len(table), table.shape[1])
