"""The OBJ format, read by trimesh: vertices and polygons in the file's order, or object by object, with their looks.

trimesh takes much without a word: an index of 0 for 1, one that counts back from the end of the file, lines of mixed
forms for those of the first. So it gets a text of plain lines alone, in one form, that this module makes of the file;
statements that hold for all faces below them (names, materials, smoothing) are found on the way. Points and lines are
skipped; statements whose surfaces would be missing from the mesh are refused.
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ..appearance.material import Material
from .file_mesh import (
    FileMesh,
    FileNode,
    FileParts,
    Problems,
    count_triangles,
    cut_fans,
    drop_loose_vertices,
    finish_looks,
    join_channels,
    report_edges,
    spread_colours,
    spread_normals,
    spread_uvs,
)
from .mtl import read_materials
from .ply import are_number_lines
from .texture_files import TextureFiles

# Comments end with their line even if that ends with a backslash, so they are dropped before lines are joined.
_COMMENT, _CONTINUATION = re.compile(rb"#[^\n]*"), re.compile(rb"\\[ \t]*\n")
_BLANKS = bytes.maketrans(b"\t\v\f\r", b"   \n")
# Curves and surfaces that the polygons do not cover, and files that are read in between.
_UNSUPPORTED = re.compile(rb"\n(surf|call|fo|bsp|bzp|cdp|res)(?=[ \n])")
_STATEMENT = re.compile(rb"\n(o|g|s|usemtl|mtllib)(?=[ \n])([^\n]*)")
_FACE = re.compile(rb"\nf(?=[ \n])[^\n]*")
_FACE_BYTES = b"0123456789/ \nf"
_NOT_SMOOTH = (b"off", b"0")


class _ObjMesh(NamedTuple):
    """The triangles of a file with their looks, and the values of statements for each triangle."""

    mesh: FileMesh
    parts: list[bytes]
    part_ids: NDArray[np.int64]


def read_obj(data: bytes, file: Path, problems: Problems) -> FileMesh:
    """Return the mesh of an OBJ file: vertices (V, 3), faces (F, 3), and its looks.

    A file that was cut off between two lines cannot be told from a complete one.
    """
    return _read(data, file, problems).mesh


def read_obj_parts(data: bytes, file: Path, problems: Problems) -> FileParts:
    """Return the objects of an OBJ file, each with the vertices that its faces refer to.

    The parts are those of the `o` statements, or of the `g` statements in a file without any. Faces above the first
    one are a part without a name; those below a second statement of one name belong to the first one's part.
    """
    mesh, names, part_of_face = _read(data, file, problems)
    order = np.argsort(part_of_face, kind="stable")
    ends = np.searchsorted(part_of_face[order], np.arange(len(names)), side="right")
    meshes = [
        FileMesh(
            name.decode("utf-8", "replace"),
            *drop_loose_vertices(mesh.vertices, mesh.faces[ids]),
            None if mesh.appearance is None else mesh.appearance.select(ids),
            None if mesh.flat_faces is None else mesh.flat_faces[ids],
        )
        for name, ids in zip(names, np.split(order, ends[:-1]), strict=True)
        if len(ids)
    ]
    return FileParts(meshes, [FileNode(part.name, number, np.eye(4)) for number, part in enumerate(meshes)])


def _read(data: bytes, file: Path, problems: Problems) -> _ObjMesh:
    text = _clean(data)
    if unsupported := _UNSUPPORTED.search(text):
        raise MeshError(
            f"the statement '{unsupported[1].decode()}' is not read: a mesh is made of 'v' and 'f' statements"
        )
    statements = _Statements(text)
    faces = b"".join(_FACE.findall(text)) + b"\n"
    if b"-" in faces:
        text = _count_forwards(text)
        faces = b"".join(_FACE.findall(text)) + b"\n"
    sizes = _count(faces, b" ", b"\n")[:-1]
    _check_sizes(sizes, data)
    report_edges(sizes, problems)
    triangle_counts = count_triangles(sizes)
    vertices, triangles, looks = _read_triangles(text, faces, sizes, problems)

    materials: list[Material] = []
    if statements.words[b"usemtl"]:
        with problems.drop("the materials"):
            materials, ids = _read_materials(statements, len(sizes), file.parent, problems)
            if len(materials) > 1:
                looks["material_ids"] = np.repeat(ids, triangle_counts)
    flat = None
    is_flat = np.array([False, *[words.lower() in _NOT_SMOOTH for words in statements.words[b"s"]]])
    if "normals" not in looks and is_flat.any():
        flat = np.repeat(is_flat[1 + statements.find_above(b"s", len(sizes))], triangle_counts)
    mark = b"o" if statements.words[b"o"] else b"g"
    numbers: dict[bytes, int] = {b"": 0}
    parts = np.array([0, *[numbers.setdefault(words, len(numbers)) for words in statements.words[mark]]])
    part_ids = np.repeat(parts[1 + statements.find_above(mark, len(sizes))], triangle_counts)
    mesh = FileMesh("", vertices, triangles, finish_looks(looks, materials), flat)
    return _ObjMesh(mesh, list(numbers), part_ids)


def _clean(data: bytes) -> bytes:
    """Return a text without comments, of lines that hold words with one space between them."""
    text = _COMMENT.sub(b"", data.replace(b"\r\n", b"\n").translate(_BLANKS))
    text = _CONTINUATION.sub(b" ", text)
    if b"  " in text:
        text = re.sub(rb"  +", b" ", text)
    return (b"\n" + text + b"\n").replace(b"\n ", b"\n").replace(b" \n", b"\n")


class _Statements:
    """What follows each keyword that holds for the faces below it, and the number of faces above."""

    def __init__(self, text: bytes) -> None:
        self.words: dict[bytes, list[bytes]] = {key: [] for key in (b"o", b"g", b"s", b"usemtl", b"mtllib")}
        self._faces_above: dict[bytes, list[int]] = {key: [] for key in self.words}
        face_count = at = 0
        for found in _STATEMENT.finditer(text):
            face_count += text.count(b"\nf ", at, found.start() + 1)
            at = found.start()
            self.words[found[1]].append(found[2].strip())
            self._faces_above[found[1]].append(face_count)

    def find_above(self, keyword: bytes, face_count: int) -> NDArray[np.int64]:
        """Return the number of the last statement above each face, (face_count,); -1 where there is none."""
        return np.searchsorted(self._faces_above[keyword], np.arange(face_count), side="right") - 1


def _count_forwards(text: bytes) -> bytes:
    """Return a text whose indices that count back from the lines above count from the first line instead."""
    above = {b"v": 0, b"vt": 0, b"vn": 0}

    def turn(corner: bytes) -> bytes:
        indices = zip(corner.split(b"/"), above.values(), strict=False)
        return b"/".join(b"%d" % (count + 1 + int(at)) if at.startswith(b"-") else at for at, count in indices)

    lines = []
    for line in text.split(b"\n"):
        keyword, _, words = line.partition(b" ")
        if keyword in above:
            above[keyword] += 1
        lines.append(b"f " + b" ".join(map(turn, words.split())) if keyword == b"f" else line)
    return b"\n".join(lines)


def _count(text: bytes, counted: bytes, begin: bytes) -> NDArray[np.int64]:
    """Return how often one character stands between each two of another, and behind the last."""
    characters = np.frombuffer(text, np.uint8)
    ends = np.append(np.flatnonzero(characters == ord(begin)), len(text))
    return np.diff(np.searchsorted(np.flatnonzero(characters == ord(counted)), ends))


def _check_sizes(sizes: NDArray[np.int64], data: bytes) -> None:
    if len(empty := np.flatnonzero(sizes == 0)):
        raise MeshError(f"face {empty[0]} has no corners")
    if len(sizes) and sizes[-1] < 3 and not data.endswith((b"\n", b"\r")):
        raise MeshError(f"the file is cut off in a face: face {len(sizes) - 1} has {sizes[-1]} corners")


def _read_triangles(
    text: bytes, faces: bytes, sizes: NDArray[np.int64], problems: Problems
) -> tuple[NDArray[np.float64], NDArray[np.integer], dict[str, NDArray]]:
    """Return vertices, triangles, and the looks at the triangles' corners."""
    vertices_text = _read_vertices(text)
    vertex_count = vertices_text.count(b"\n")
    faces, uvs_text, normals_text = _unify(
        faces, vertex_count, _read_values(text, b"vt", 2), _read_values(text, b"vn", 3), problems
    )
    begins = np.cumsum(np.where(sizes >= 3, sizes, 0)) - sizes
    corners = np.empty(sizes[sizes >= 3].sum(), np.int64)
    if len(corners) == 0:
        return np.zeros((vertex_count, 3)), np.empty((0, 3), np.int64), {}
    from trimesh.exchange.obj import load_obj  # takes 0.3 s

    # Faces of one size are a group, by a material that is none: those are read at once.
    lines = faces.split(b"\n")[1:-1]
    groups = [
        b"\nusemtl %d\n" % size + b"\n".join([lines[face] for face in np.flatnonzero(sizes == size)])
        for size in np.unique(sizes[sizes >= 3])
    ]
    plain = b"".join((vertices_text, uvs_text or b"", normals_text or b"", *groups))
    is_split = uvs_text is not None or normals_text is not None
    try:
        pieces = load_obj(io.BytesIO(plain), skip_materials=True, maintain_order=not is_split)["geometry"].values()
    except IndexError:
        raise _describe_corner(faces, vertex_count) from None
    first_vertex = 0
    for piece in pieces:
        size = piece["faces"].shape[1]
        at = begins[sizes == size][:, None] + np.arange(size)
        corners[at] = piece["faces"] + first_vertex
        first_vertex += len(piece["vertices"]) if is_split else 0

    def join(name: str) -> NDArray[np.float64]:
        found = [getattr(piece["visual"], "uv", None) if name == "uv" else piece.get(name) for piece in pieces]
        arrays = [array for array in found if array is not None]
        if len(arrays) < len(found):
            raise MeshError("a corner refers to one that is missing")
        return np.concatenate(arrays if is_split else arrays[:1])

    vertices, triangles = join("vertices"), cut_fans(corners, sizes[sizes >= 3])
    looks: dict[str, NDArray] = {}
    if normals_text is not None:
        with problems.drop("the normals"):
            looks["normals"] = spread_normals(join("vertex_normals"), triangles, vertices, triangles)
    if uvs_text is not None:
        with problems.drop("the texture coordinates"):
            looks["uvs"] = spread_uvs(join("uv"), triangles)
    if all("vertex_colors" in piece for piece in pieces):
        with problems.drop("the colours"):
            colours = join_channels(list(join("vertex_colors").T), np.dtype(np.float64))
            looks["colours"] = spread_colours(colours, triangles)
    return vertices, triangles, looks


def _read_vertices(text: bytes) -> bytes:
    """Return the lines of vertices, each of three coordinates, or of those and a colour."""
    lines = b"".join(re.findall(rb"\nv(?=[ \n])[^\n]*", text))
    width = lines[1:].partition(b"\n")[0].count(b" ")
    if not lines:
        raise MeshError("the mesh has no vertices")
    if width in (3, 6, 7) and _are_numbers(lines, b"v", width):
        # Of seven numbers the fourth is a weight.
        return re.sub(rb"(\nv \S+ \S+ \S+) \S+", rb"\1", lines) if width == 7 else lines
    lines = re.sub(rb"(\nv \S+ \S+ \S+)[^\n]*", rb"\1", lines)
    if not _are_numbers(lines, b"v", 3):
        each = enumerate(lines.split(b"\n")[1:])
        vertex, line = next((vertex, line) for vertex, line in each if not _are_numbers(b"\n" + line, b"v", 3))
        raise MeshError(f"vertex {vertex} is '{line.decode('latin-1')[:40]}', and not three coordinates")
    return lines


def _read_values(text: bytes, keyword: bytes, width: int) -> bytes:
    """Return the lines of texture coordinates or normals; none of them if one is not of numbers."""
    lines = b"".join(re.findall(rb"\n%s(?=[ \n])[^\n]*" % keyword, text))
    if not _are_numbers(lines, keyword, width):
        # One coordinate is that of a texture that is a line; a third one is that of a solid texture.
        padded = (lines + b"\n").replace(b"\n", b" 0\n")[2:-1] if keyword == b"vt" else lines
        lines = re.sub(rb"(\n%s(?: \S+){%d})[^\n]*" % (keyword, width), rb"\1", padded)
    return lines if _are_numbers(lines, keyword, width) else b""  # corners that refer to them are a problem


def _are_numbers(lines: bytes, keyword: bytes, width: int) -> bool:
    table = (lines + b"\n").replace(b"\n" + keyword + b" ", b"\n")[1:]
    return bool(are_number_lines(np.frombuffer(table, np.uint8), width))


def _unify(
    faces: bytes, vertex_count: int, uvs: bytes, normals: bytes, problems: Problems
) -> tuple[bytes, bytes | None, bytes | None]:
    """Return faces whose corners have one form, and the lines of texture coordinates and normals, None if not used.

    Where forms differ, a corner without a value gets one behind the last of the file.
    """
    if b"+" in faces:
        faces = re.sub(rb"\+(?=[0-9])", b"", faces)
    slashes = _count(faces, b"/", b" ")
    if faces.translate(None, _FACE_BYTES) or slashes.max(initial=0) > 2:
        problems.add("the texture coordinates and normals cannot be used: a corner has words that are no indices")
        faces = re.sub(rb"/[^ \n]*", b"", faces)
        slashes[:] = 0
    if faces.translate(None, _FACE_BYTES) or re.search(rb" 0*(?=[/ \n])", faces):
        raise _describe_corner(faces, vertex_count)
    if b"/0" in faces:
        faces = re.sub(rb"/0+(?=[/ \n])", b"/", faces)  # written by programs that mean none
    if not uvs and not normals:
        if re.search(rb"/[1-9]", faces):
            problems.add(
                "the texture coordinates and normals cannot be used: corners refer to them, but there are none"
            )
        faces = re.sub(rb"/[^ \n]*", b"", faces)
        slashes[:] = 0
    if slashes.max(initial=0) == 0:
        return faces, None, None
    both = faces.count(b"//")
    if slashes.min() == slashes.max() and both in (0, len(slashes)) and not re.search(rb"/[ \n]", faces):
        return faces, uvs if both == 0 else None, normals if slashes[0] == 2 else None
    faces = re.sub(rb"/+(?=[ \n])", b"", faces)
    uv, normal = uvs.count(b"\n") + 1, normals.count(b"\n") + 1
    if re.search(rb" [^ /\n]+/0*%d(?=[ /\n])|/[^ /\n]*/0*%d(?=[ \n])" % (uv, normal), faces):
        problems.add("the texture coordinates and normals cannot be used: a corner refers to one that is missing")
        return re.sub(rb"/[^ \n]*", b"", faces), None, None
    has_uvs, has_normals = re.search(rb"[0-9]/[0-9]", faces), re.search(rb"/[^ /\n]*/", faces)
    faces = faces.replace(b"//", b"/%d/" % uv)
    faces = re.sub(rb"( [^ /\n]+)(?=[ \n])", rb"\g<1>/%d/%d" % (uv, normal), faces)
    faces = re.sub(rb"( [^ /\n]+/[^ /\n]+)(?=[ \n])", rb"\g<1>/%d" % normal, faces)
    return faces, uvs + b"\nvt 0 0" if has_uvs else None, normals + b"\nvn 0 0 0" if has_normals else None


def _describe_corner(faces: bytes, vertex_count: int) -> MeshError:
    """Return the error of the first corner without a vertex."""
    for face, line in enumerate(faces.split(b"\n")[1:-1]):
        for corner in line.split()[1:]:
            index = corner.partition(b"/")[0]
            if not re.fullmatch(rb"-?[0-9]{1,18}", index):
                return MeshError(
                    f"face {face} has a corner '{corner.decode('latin-1')[:80]}', which is no vertex index"
                )
            if not 1 <= int(index) <= vertex_count:
                return MeshError(
                    f"face {face} refers to vertex {int(index)}, but there are {vertex_count} vertices "
                    f"(1 to {vertex_count})"
                )
    return MeshError("a corner refers to a vertex that the file does not have")


def _read_materials(
    statements: _Statements, face_count: int, folder: Path, problems: Problems
) -> tuple[list[Material], NDArray[np.int32]]:
    """Return the materials that faces use, and the one of each polygon."""
    textures = TextureFiles(folder, problems)
    known: dict[bytes, Material] = {}
    for words in statements.words[b"mtllib"]:
        known = read_materials(words, folder, textures, problems) | known
    numbers: dict[bytes, int] = {}
    ids = [numbers.setdefault(name, len(numbers)) for name in statements.words[b"usemtl"]]
    if not any(name in known for name in numbers):
        return [], np.zeros(0, np.int32)
    missing = [name for name in numbers if name not in known]
    if missing:
        names = ", ".join(f"'{name.decode('utf-8', 'replace')[:40]}'" for name in missing[:3])
        problems.add(f"the materials {names}{', ...' if len(missing) > 3 else ''} are missing from the .mtl files")
    materials = [known.get(name) or Material(name.decode("utf-8", "replace")) for name in numbers]
    above = statements.find_above(b"usemtl", face_count)
    if (above < 0).any():
        # Faces above the first statement have no material of the file.
        ids.append(len(materials))
        materials.append(Material())
    return materials, np.array(ids, np.int32)[above]
