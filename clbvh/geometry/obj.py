"""The Wavefront OBJ format: its vertices and its faces.

Groups, materials, normals and texture coordinates are passed over, and nothing is split or merged: the faces stay
in the file's order.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from ..errors import MeshError
from .polygons import cut_polygons
from .text_numbers import NotANumberError, count_tokens_per_line, parse_numbers

_SPACE, _NEWLINE, _TAB = ord(" "), ord("\n"), ord("\t")


def read_obj(data: bytes, source: str) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Read an OBJ file.

    Parameters
    ----------
    data : bytes
        The file.
    source : str
        What messages call it.

    Returns
    -------
    vertices : (V, 3) float64, object units
    faces : (F, 3) int32
        In the file's order, polygons cut in place; empty for a point cloud.

    Raises
    ------
    MeshError
        Not an OBJ file, an incomplete line, or an index that is no vertex. A file that is cut off exactly between
        two lines cannot be told from a whole one.
    """
    text = _normalise(data)
    characters = np.frombuffer(text, dtype=np.uint8)
    ends = np.flatnonzero(characters == _NEWLINE) + 1
    begins = np.concatenate(([0], ends[:-1]))
    # A line of one character ends the text at worst, so the one behind its first is there.
    spaced = np.isin(characters[np.minimum(begins + 1, len(characters) - 1)], (_SPACE, _TAB))
    is_vertex = spaced & (characters[begins] == ord("v"))
    is_face = spaced & (characters[begins] == ord("f"))

    numbers, counts = _read_lines(characters, begins, ends, is_vertex, "vertex", source)
    if len(counts) == 0:
        raise MeshError(f"{source}: the mesh has no vertices: no line of the file begins with 'v'")
    if counts.min() < 3:
        vertex = int(np.argmax(counts < 3))
        raise MeshError(f"{source}: vertex {vertex + 1} has {counts[vertex]} coordinates instead of 3")
    # Behind the coordinates may stand a weight or a colour.
    vertices = numbers[(np.cumsum(counts) - counts)[:, None] + np.arange(3)]

    corners, sizes = _read_lines(characters, begins, ends, is_face, "face", source)
    # Vertices count from 1; a negative index counts back from the vertices that stand above the face.
    above = np.repeat(np.cumsum(is_vertex)[is_face], sizes)
    corners = np.where(corners < 0, corners + above + 1, corners) - 1
    return vertices, cut_polygons(vertices, corners, sizes, source=source, first_index=1)


def _normalise(data: bytes) -> bytes:
    """Return the text with one statement per line, and no blanks before it."""
    text = data + b"\n"
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\\\n" in text:
        text = text.replace(b"\\\n", b" ")
    if text[0] in b" \t" or b"\n " in text or b"\n\t" in text:
        text = re.sub(rb"(?m)^[ \t]+", b"", text)
    return text


def _read_lines(
    characters: NDArray[np.uint8],
    begins: NDArray[np.int64],
    ends: NDArray[np.int64],
    chosen: NDArray[np.bool_],
    what: str,
    source: str,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the numbers of the chosen lines, and how many each line has."""
    without_keyword = characters.copy()
    without_keyword[begins[chosen]] = _SPACE
    text = without_keyword[np.repeat(chosen, ends - begins)].tobytes()
    if b"#" in text:
        text = re.sub(rb"#[^\n]*", b"", text)
    if b"/" in text:
        text = re.sub(rb"/\S*", b"", text)  # only the first index of a corner is its vertex
    counts = count_tokens_per_line(text)
    try:
        return parse_numbers(text), counts
    except NotANumberError as error:
        line = int(np.searchsorted(np.cumsum(counts), error.token_id, side="right"))
        raise MeshError(f"{source}: {what} {line + 1} has '{error.token}' where a number is expected") from error
