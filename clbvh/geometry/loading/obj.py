"""The OBJ format: vertices and polygons in the file's order, or object by object, with their looks.

Points and lines are skipped; statements whose surfaces would be missing from the mesh are refused. No library is used
for it: trimesh reorders faces, misplaces indices that are 0 or count back, and loses the end of a file that was cut
off.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from .file_mesh import FileMesh, FileNode, FileParts, Problems, count_triangles, cut_fans, drop_loose_vertices
from .obj_lines import FACE, VERTEX, ObjLines, read_corners, resolve_indices
from .obj_looks import ObjMesh, read_obj_looks
from .obj_statements import ObjStatements
from .text_lines import join_polygons, read_coordinates, read_table

# Comments end with their line even if that ends with a backslash, so they are dropped before lines are joined.
_COMMENT = re.compile(rb"#[^\n]*")
_OTHER_INDICES = re.compile(rb"/\S*")  # only the first index of a face's corner is a vertex
_CONTINUATION = re.compile(rb"\\[ \t]*\n")
# Curves and surfaces that the polygons do not cover, and files that are read in between.
_UNSUPPORTED = (b"surf", b"call", b"fo", b"bsp", b"bzp", b"cdp", b"res")
_OBJECT, _GROUP = b"o", b"g"


def read_obj(data: bytes, file: Path, problems: Problems) -> FileMesh:
    """Return the mesh of an OBJ file: vertices (V, 3), faces (F, 3), and its looks.

    A file that was cut off between two lines cannot be told from a complete one.
    """
    mesh = _read_mesh(data)
    return FileMesh("", mesh.vertices, mesh.faces, *read_obj_looks(mesh, file.parent, problems))


def read_obj_parts(data: bytes, file: Path, problems: Problems) -> FileParts:
    """Return the objects of an OBJ file, each with the vertices that its faces refer to.

    The parts are those of the `o` statements, or of the `g` statements in a file without any. Faces above the first
    one are a part without a name; those below a second statement of one name belong to the first one's part.
    """
    mesh = _read_mesh(data)
    appearance, flat = read_obj_looks(mesh, file.parent, problems)
    statements = mesh.statements
    mark = _OBJECT if statements.has(_OBJECT) else _GROUP
    numbers: dict[bytes, int] = {b"": 0}
    values = [numbers.setdefault(b" ".join(words.split()), len(numbers)) for words in statements.words_of(mark)]
    part_of_polygon = np.array([0, *values], np.int64)[1 + statements.find_above(mark)]
    part_of_face = np.repeat(part_of_polygon, count_triangles(mesh.sizes))

    order = np.argsort(part_of_face, kind="stable")
    ends = np.searchsorted(part_of_face[order], np.arange(len(numbers)), side="right")
    meshes = [
        FileMesh(
            name.decode("utf-8", "replace"),
            *drop_loose_vertices(mesh.vertices, mesh.faces[ids]),
            None if appearance is None else appearance.select(ids),
            None if flat is None else flat[ids],
        )
        for name, ids in zip(numbers, np.split(order, ends[:-1]), strict=True)
        if len(ids)
    ]
    return FileParts(meshes, [FileNode(part.name, number, np.eye(4)) for number, part in enumerate(meshes)])


def _strip_comments(data: bytes) -> bytes:
    text = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return _CONTINUATION.sub(b" ", _COMMENT.sub(b"", text))


def _read_mesh(data: bytes) -> ObjMesh:
    """Return the vertices (V, 3), the triangles (F, 3), and all that tells of their looks."""
    lines = ObjLines(_strip_comments(data))
    statements = ObjStatements(lines)
    unsupported = [keyword for keyword in _UNSUPPORTED if statements.has(keyword)]
    if unsupported:
        raise MeshError(
            f"the statement '{min(unsupported).decode()}' is not read: a mesh is made of 'v' and 'f' statements"
        )
    numbers = lines.read_numbers(VERTEX)
    if numbers is not None and numbers.shape[1] >= 3:
        vertices = np.ascontiguousarray(numbers[:, :3])
    else:
        vertices = read_coordinates(lines.list_words(VERTEX))
    read = read_corners(lines)
    if read is None:
        corners, sizes = _read_faces([_OTHER_INDICES.sub(b"", words) for words in lines.list_words(FACE)])
    else:
        corners, sizes = read.indices[:, 0], read.sizes
    ids = resolve_indices(corners, sizes, lines, VERTEX)
    if len(empty := np.flatnonzero(sizes == 0)):
        raise MeshError(f"face {empty[0]} has no corners")
    if len(sizes) and sizes[-1] < 3 and not data.endswith((b"\n", b"\r")):
        raise MeshError(f"the file is cut off in a face: face {len(sizes) - 1} has {sizes[-1]} corners")
    # Checked here, because the message needs the numbers of the file.
    wrong = np.flatnonzero((ids < 0) | (ids >= len(vertices)))
    if len(wrong):
        face = int(np.searchsorted(np.cumsum(sizes), wrong[0], side="right"))
        raise MeshError(
            f"face {face} refers to vertex {corners[wrong[0]]}, but there are {len(vertices)} vertices "
            f"(1 to {len(vertices)})"
        )
    return ObjMesh(vertices, cut_fans(ids, sizes), sizes, numbers, read, lines, statements)


def _read_faces(lines: list[bytes]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the corners of all faces as the file counts them, concatenated, and the number of corners of each."""
    table = read_table(lines)
    if table is None:
        return join_polygons([line.split() for line in lines])
    return table.ravel(), np.full(len(table), table.shape[1])
