"""The OBJ format: vertices and polygons in the file's order, with their looks and the names of objects.

Lines are found by their first letters, all at once; numpy reads the numbers of all lines of a kind. Points and lines
are skipped; statements whose surfaces would be missing from the mesh are refused.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ..appearance.material import Material
from ..mesh import Part
from .file_mesh import (
    FileMesh,
    Problems,
    finish_looks,
    join_channels,
    read_table,
    spread_colours,
    spread_normals,
    spread_uvs,
)
from .mtl import PLAIN, MtlMaterial, read_materials
from .polygons import count_triangles, cut_polygons, report_edges
from .texture_files import TextureFiles

# Comments end with their line even if that ends with a backslash, so they are dropped before lines are joined.
_COMMENT, _CONTINUATION = re.compile(rb"#[^\n]*"), re.compile(rb"\\[ \t]*\n")
_BLANKS = bytes.maketrans(b"\t\v\f\r", b"   \n")
# Curves and surfaces that the polygons do not cover, and files that are read in between.
_UNSUPPORTED = (b"surf", b"call", b"fo", b"bsp", b"bzp", b"cdp", b"res")
_STATEMENT = re.compile(rb"\n(o|g|s|usemtl|mtllib|%s)(?=[ \n])([^\n]*)" % b"|".join(_UNSUPPORTED))
_NO_INDEX = re.compile(rb" (?![-+]?[0-9]+[ \n])([^ \n]*)")
_WRONG_SIGN = re.compile(rb"[-+](?![0-9])|[0-9][-+]")  # numpy takes both for numbers
_TO_BLANKS = bytes.maketrans(b"/\n", b"  ")
_BEFORE_FIRST = -2  # an index that counts back too far; -1 is none
_COLOURED = (6, 7)  # numbers of a vertex: three coordinates, perhaps a weight, and a colour
_NOT_SMOOTH = (b"off", b"0")

_Statements = dict[bytes, tuple[list[bytes], NDArray[np.int64]]]


def read_obj(data: bytes, file: Path, problems: Problems) -> FileMesh:
    """Return the mesh of an OBJ file: vertices (V, 3), faces (F, 3), its looks and its parts.

    The parts are those of the `o` statements, or of the `g` statements in a file without any. Faces above the first
    one are a part without a name. A file that was cut off between two lines cannot be told from a complete one.
    """
    text = _clean(data)
    statements = _find_statements(text)
    rows = _read_vertices(_join(b"v", text))
    sizes, (vertex_ids, uv_ids, normal_ids) = _read_faces(text, len(rows), problems)
    if len(sizes) and sizes[-1] < 3 and not data.endswith((b"\n", b"\r")):
        raise MeshError(f"the file is cut off in a face: face {len(sizes) - 1} has {sizes[-1]} corners")
    report_edges(sizes, problems)
    # Corners of triangles among those of the polygons.
    vertices = rows[:, :3]
    corners = cut_polygons(np.arange(len(vertex_ids)), sizes, vertex_ids, vertices)
    triangles = vertex_ids[corners]

    if len(triangles) == 0 and rows.shape[1] in _COLOURED:
        with problems.drop("the colours"):
            return FileMesh("", vertices, triangles, point_colours=join_channels(list(rows[:, -3:].T), rows.dtype))

    looks: dict[str, NDArray] = {}
    if (normal_ids != -1).any():
        with problems.drop("the normals"):
            normals = _read_values(_join(b"vn", text), 3)
            looks["normals"] = spread_normals(normals, normal_ids[corners], vertices, triangles)
    if (uv_ids != -1).any():
        with problems.drop("the texture coordinates"):
            looks["uvs"] = spread_uvs(_read_values(_join(b"vt", text), 2), uv_ids[corners])
    if rows.shape[1] in _COLOURED:
        with problems.drop("the colours"):
            looks["colours"] = spread_colours(join_channels(list(rows[:, -3:].T), rows.dtype), triangles)

    triangle_counts = count_triangles(sizes)
    materials: list[Material] = []
    if statements[b"usemtl"][0]:
        with problems.drop("the materials"):
            materials, placements, ids = _read_materials(statements, file.parent, problems)
            ids = np.repeat(ids, triangle_counts)
            if len(materials) > 1:
                looks["material_ids"] = ids
            if "uvs" in looks and (placements != PLAIN).any():
                with np.errstate(over="ignore", invalid="ignore"):
                    placed = looks["uvs"] * placements[ids, None, :2] + placements[ids, None, 2:]
                looks["uvs"] = np.nan_to_num(placed)
    flat = None
    words, above = statements[b"s"]
    is_flat = np.array([False, *[word.lower() in _NOT_SMOOTH for word in words]])
    if "normals" not in looks and is_flat.any():
        flat = np.repeat(is_flat[above], triangle_counts)
    words, above = statements[b"o" if statements[b"o"][0] else b"g"]
    numbers: dict[bytes, int] = {b"": 0}
    ids = np.array([0, *[numbers.setdefault(word, len(numbers)) for word in words]])
    parts = _find_parts([word.decode("utf-8", "replace") for word in numbers], np.repeat(ids[above], triangle_counts))
    return FileMesh("", vertices, triangles, finish_looks(looks, materials), flat, parts)


def _find_parts(names: list[str], part_of_face: NDArray[np.int64]) -> tuple[Part, ...]:
    """Return the ranges of faces with the same part; a name that comes again begins another range."""
    begins = np.flatnonzero(np.diff(part_of_face, prepend=-1))
    ends = [*begins[1:].tolist(), len(part_of_face)]
    found = zip(part_of_face[begins].tolist(), begins.tolist(), ends, strict=False)
    return tuple(Part(names[part], begin, end) for part, begin, end in found)


def _clean(data: bytes) -> bytes:
    """Return a text without comments, whose lines hold words with one blank between them; the first line is empty."""
    text = _COMMENT.sub(b"", data.replace(b"\r\n", b"\n").translate(_BLANKS))
    text = _CONTINUATION.sub(b" ", text)
    if b"  " in text:
        text = re.sub(rb"  +", b" ", text)
    return (b"\n" + text + b"\n").replace(b"\n ", b"\n").replace(b" \n", b"\n")


def _find(keyword: bytes, text: bytes) -> NDArray[np.int64]:
    """Return the offsets of the newlines before the lines that begin with a keyword."""
    return np.array([line.start() for line in re.finditer(rb"\n%s(?=[ \n])" % keyword, text)], np.int64)


def _join(keyword: bytes, text: bytes) -> bytes:
    """Return what follows a keyword on its lines: a newline, and a blank before each word; and a last newline."""
    return b"\n".join([b"", *re.findall(rb"\n%s( [^\n]*)?(?=\n)" % keyword, text), b""])


def _find_statements(text: bytes) -> _Statements:
    """Return the words behind each keyword, statement by statement, and the number of statements above each face."""
    found: dict[bytes, list[re.Match[bytes]]] = {key: [] for key in (b"o", b"g", b"s", b"usemtl", b"mtllib")}
    for statement in _STATEMENT.finditer(text):
        if statement[1] not in found:
            raise MeshError(
                f"the statement '{statement[1].decode()}' is not read: a mesh is made of 'v' and 'f' statements"
            )
        found[statement[1]].append(statement)
    faces = _find(b"f", text)
    return {
        key: ([one[2].strip() for one in those], np.searchsorted([one.start() for one in those], faces))
        for key, those in found.items()
    }


def _read_faces(whole: bytes, vertex_count: int, problems: Problems) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the number of corners of each polygon, and the vertices, texture coordinates and normals of all corners.

    The last are (3, corners); -1 where a corner has none.
    """
    # An index between two slashes, or behind the last, may be left out.
    text = _join(b"f", whole).replace(b"//", b"/0/").replace(b"/ ", b"/0 ").replace(b"/\n", b"/0\n")
    sizes, slashes = _count(text, b" ", b"\n")[:-1], _count(text, b"/", b" ")
    if len(empty := np.flatnonzero(sizes == 0)):
        raise MeshError(f"face {empty[0]} has no corners")
    numbers = _read_indices(text, 1 + slashes)
    if numbers is None and b"/" in text:
        problems.add("the texture coordinates and normals cannot be used: a corner has words that are no indices")
        text = re.sub(rb"/[^ \n]*", b"", text)
        slashes[:] = 0
        numbers = _read_indices(text, 1 + slashes)
    if numbers is None:
        found = next(_NO_INDEX.finditer(text))
        face, word = text.count(b"\n", 0, found.start()) - 1, found[1].decode("latin-1")[:80]
        raise MeshError(f"face {face} has a corner '{word}', which is no vertex index")
    first = np.cumsum(1 + slashes) - 1 - slashes
    ids = np.full((3, len(slashes)), -1)
    for at, keyword in enumerate((b"v", b"vt", b"vn")):
        has = np.flatnonzero(slashes >= at)
        values = numbers[first[has] + at]
        ids[at, has] = values - 1
        if len(back := np.flatnonzero(values < 0)):
            # These count back from the lines above.
            above = np.repeat(np.searchsorted(_find(keyword, whole), _find(b"f", whole)), sizes)
            counted = above[has[back]] + values[back]
            ids[at, has[back]] = np.where(counted >= 0, counted, _BEFORE_FIRST)
    wrong = np.flatnonzero((ids[0] < 0) | (ids[0] >= vertex_count))
    if len(wrong):
        raise MeshError(
            f"face {np.repeat(np.arange(len(sizes)), sizes)[wrong[0]]} refers to vertex {numbers[first[wrong[0]]]}, "
            f"but there are {vertex_count} vertices (1 to {vertex_count})"
        )
    return sizes, ids


def _read_indices(faces: bytes, widths: NDArray[np.int64]) -> NDArray[np.int64] | None:
    """Return the numbers of faces; None if they are not whole ones, or not as many as the corners have."""
    text = faces.translate(_TO_BLANKS)
    if widths.max(initial=0) > 3 or text.translate(None, b"0123456789+- "):
        return None
    if (b"-" in text or b"+" in text) and _WRONG_SIGN.search(text):
        return None
    numbers = np.fromstring(text + b" 0", np.int64, sep=" ")[:-1]  # of no text numpy makes a number, too
    return numbers if len(numbers) == widths.sum() else None


def _count(text: bytes, counted: bytes, begin: bytes) -> NDArray[np.int64]:
    """Return how often one character stands between each two of another, and behind the last."""
    characters = np.frombuffer(text, np.uint8)
    ends = np.append(np.flatnonzero(characters == ord(begin)), len(text))
    return np.diff(np.searchsorted(np.flatnonzero(characters == ord(counted)), ends))


def _read_vertices(lines: bytes) -> NDArray[np.float64]:
    """Return the coordinates of each vertex, and what follows them if that is as long for all."""
    if lines == b"\n":
        raise MeshError("the file has no vertices")
    rows = _read_rows(lines, 3)
    if rows is None:
        each = enumerate(lines.split(b"\n")[1:])
        vertex, line = next((at, line) for at, line in each if _read_rows(b"\n" + line + b"\n", 3) is None)
        raise MeshError(f"vertex {vertex} is 'v{line.decode('latin-1')[:40]}', and not three coordinates")
    return rows


def _read_values(lines: bytes, width: int) -> NDArray[np.float64]:
    """Return texture coordinates or normals, (n, width)."""
    rows = _read_rows(lines, width)
    if rows is None and width == 2:
        # One coordinate is that of a texture that is a line.
        rows = _read_rows(lines.replace(b"\n", b" 0\n")[2:], width)
    if rows is None:
        raise MeshError("some are not numbers")
    return rows[:, :width]


def _read_rows(lines: bytes, least: int) -> NDArray[np.float64] | None:
    """Return the numbers of lines: all of each line, or the first ones where there are not as many on each.

    None if a line has fewer, or other words.
    """
    rows = read_table(lines)
    if rows is None:
        rows = read_table(re.sub(rb"(\n(?: \S+){%d})[^\n]*" % least, rb"\1", lines))
    is_whole = rows is not None and rows.shape[1] >= least and len(rows) == lines.count(b"\n") - 1
    return rows if is_whole else None


def _read_materials(
    statements: _Statements, folder: Path, problems: Problems
) -> tuple[list[Material], NDArray[np.float32], NDArray[np.int32]]:
    """Return the materials that faces use, how their textures lie (n, 4), and the material of each polygon."""
    textures = TextureFiles(folder, problems)
    known: dict[bytes, MtlMaterial] = {}
    for words in statements[b"mtllib"][0]:
        known = read_materials(words, folder, textures, problems) | known
    used, above = statements[b"usemtl"]
    numbers: dict[bytes, int] = {}
    ids = [numbers.setdefault(name, len(numbers)) for name in used]
    if known.keys().isdisjoint(numbers):
        return [], np.array([PLAIN], np.float32), np.zeros(len(above), np.int32)
    if missing := [name.decode("utf-8", "replace")[:40] for name in numbers if name not in known]:
        names = ", ".join(f"'{name}'" for name in missing[:3])
        problems.add(f"the materials {names}{', ...' if len(missing) > 3 else ''} are missing from the .mtl files")
    found = [known.get(name) or MtlMaterial(Material(name.decode("utf-8", "replace")), PLAIN) for name in numbers]
    if (above == 0).any():
        # Faces above the first statement have no material of the file.
        found.append(MtlMaterial(Material(), PLAIN))
    placements = np.array([each.placement for each in found], np.float32)
    return [each.material for each in found], placements, np.array([len(numbers), *ids], np.int32)[above]
