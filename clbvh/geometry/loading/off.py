"""The OFF format, as text: its lines are those of an ASCII PLY file under another header.

Mark Phillips and others, "Geomview Manual", 1996, section "OFF Files".
"""

from __future__ import annotations

import re
from pathlib import Path

from ...errors import MeshError
from .file_mesh import OFF_KEYWORD, FileMesh, Problems
from .ply import read_ply

_BINARY = re.compile(rb"[ \t]+BINARY\b")

_COLOUR = ("red", "green", "blue", "alpha")


def read_off(data: bytes, file: Path, problems: Problems) -> FileMesh:
    """Return the mesh of a text OFF file: vertices (V, 3), faces (F, 3), and its looks."""
    keyword = OFF_KEYWORD.match(data)
    if keyword is None:
        raise MeshError("not an OFF file: it does not begin with the word 'OFF'")
    if _BINARY.match(data, keyword.end()):
        raise MeshError("the file is a binary OFF file, and only text is read: save it as text, or as PLY")
    text = re.sub(rb"#[^\r\n]*", b"", data[keyword.end() :])
    lines = [line for line in text.splitlines() if line.strip()]
    # Vertices, faces and edges, which may be left out, on one line or several: a vertex has more than one number.
    counts: list[bytes] = []
    used = 0
    while used < len(lines) and (len(counts) < 2 or (len(counts) == 2 and len(lines[used].split()) == 1)):
        counts += lines[used].split()
        used += 1
    if len(counts) < 2:
        raise MeshError("the file is cut off: it does not say how many vertices and faces it has")
    if not (counts[0] + counts[1]).isdigit():
        shown = b" ".join(counts[:2]).decode("latin-1")[:40]
        raise MeshError(f"the numbers of vertices and faces must follow 'OFF', not '{shown}'")
    vertex_count, face_count = int(counts[0]), int(counts[1])
    lines = lines[used:]
    if len(lines) != vertex_count + face_count:
        fault = "is cut off" if len(lines) < vertex_count + face_count else "goes on behind the end that it declares"
        raise MeshError(
            f"the file {fault}: {vertex_count:,} vertices and {face_count:,} faces take as many lines, but it has "
            f"{len(lines):,}"
        )
    vertices, faces = lines[:vertex_count], lines[vertex_count:]
    widths = [len(line.split()) for line in vertices]
    if min(widths, default=3) < 3:
        vertex = widths.index(min(widths))
        raise MeshError(f"vertex {vertex} has {widths[vertex]} numbers instead of 3")
    if len(set(widths)) > 1:
        vertices = [b" ".join(line.split()[:3]) for line in vertices]
    letters = (keyword[1] or keyword[2] or b"").decode().upper()
    of_vertices = _name_columns(vertices[0].split() if vertices else [], letters, problems)
    extra = []
    for face, line in enumerate(faces):
        words = line.split()
        if not words[0].isdigit():
            shown = words[0].decode("latin-1")[:40]
            raise MeshError(f"face {face} begins with '{shown}', which is no number of corners")
        extra.append(len(words) - 1 - int(words[0]))
        if extra[-1] < 0:
            raise MeshError(f"face {face} declares {int(words[0])} corners, but has {len(words) - 1}")
    of_faces: list[str] = []
    if len(set(extra)) == 1:
        words = faces[0].split()[len(faces[0].split()) - extra[0] :]
        # One number is that of a colour in a table, which the file does not have.
        of_faces = _name_colour(words) if len(words) in (3, 4) else [f"float extra{at}" for at in range(len(words))]
    elif extra:
        problems.add("the colours cannot be used: not all faces have one")
        faces = [b" ".join(line.split()[: 1 + int(line.split()[0])]) for line in faces]
    header = [
        *("ply", "format ascii 1.0"),
        *(f"element vertex {vertex_count}", *(f"property {column}" for column in of_vertices)),
        *(f"element face {face_count}", "property list int int vertex_indices"),
        *(f"property {column}" for column in of_faces),
        "end_header",
    ]
    return read_ply(b"\n".join(["\n".join(header).encode(), *vertices, *faces, b""]), file, problems)


def _name_columns(words: list[bytes], letters: str, problems: Problems) -> list[str]:
    """Return the types and names of a vertex's numbers: coordinates, normal, colour, texture coordinates."""
    columns = [f"double {axis}" for axis in "xyz"]
    rest = words[3:]
    end = len(rest) - 2 * ("ST" in letters)
    at = 3 * ("N" in letters)
    if letters and (("C" not in letters and end != at) or ("C" in letters and end - at not in (3, 4))):
        problems.add("the looks of the vertices cannot be used: their numbers are not those that the keyword announces")
        letters = ""
    if not letters:
        return columns + [f"double extra{at}" for at in range(len(rest))]
    columns += [f"double n{axis}" for axis in "xyz"[:at]]
    columns += _name_colour(rest[at:end])
    return columns + [f"double {name}" for name in "st" * ("ST" in letters)]


def _name_colour(words: list[bytes]) -> list[str]:
    """Return the types and names of a colour's numbers: whole ones are shares of 255, others of 1."""
    kind = "uchar" if all(word.isdigit() for word in words) else "float"
    return [f"{kind} {name}" for name in _COLOUR[: len(words)]]
