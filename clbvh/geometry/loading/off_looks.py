"""The looks in an OFF file: normals, colours and texture coordinates of vertices, and colours of faces.

Mark Phillips and others, "Geomview Manual", 1996, section "OFF Files".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ..appearance.appearance import Appearance
from .file_mesh import (
    Problems,
    count_triangles,
    finish_looks,
    join_channels,
    spread_colours,
    spread_normals,
    spread_uvs,
)
from .ply import are_number_lines

_CHANNELS = (3, 4)


class OffLines(NamedTuple):
    """The letters before `OFF`, and the lines of vertices and faces."""

    letters: str
    vertices: list[bytes]
    faces: list[bytes]


def read_off_looks(
    lines: OffLines,
    vertices: NDArray[np.float64],
    faces: NDArray[np.integer],
    sizes: NDArray[np.integer],
    problems: Problems,
) -> Appearance | None:
    """Return the looks of a file's triangles, None if it says nothing of them.

    Parameters
    ----------
    lines : OffLines
    vertices, faces : (V, 3) float64 and (F, 3) int
    sizes : (p,) int
        Corners per polygon.
    problems : Problems
    """
    looks: dict[str, NDArray] = {}
    if lines.letters:
        with problems.drop("the looks of the vertices"):
            looks |= _read_vertices(lines, vertices, faces)
    if "colours" not in looks and lines.faces and len(lines.faces[0].split()) > 1 + sizes[0]:
        with problems.drop("the colours"):
            polygons = np.repeat(np.arange(len(sizes)), count_triangles(sizes))
            if (colours := _read_face_colours(lines.faces, sizes)) is not None:
                looks["colours"] = spread_colours(colours, np.repeat(polygons[:, None], 3, axis=1))
    return finish_looks(looks, [])


def _read_vertices(lines: OffLines, vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> dict[str, NDArray]:
    """Return what stands behind the coordinates: normals, then colours, then texture coordinates."""
    table = _read_table(lines.vertices)
    if table is None:
        raise MeshError("their lines differ in length, or hold words that are no numbers")
    looks: dict[str, NDArray] = {}
    at = 3
    if "N" in lines.letters:
        looks["normals"] = spread_normals(table[:, at : at + 3], faces, vertices, faces)
        at += 3
    end = table.shape[1] - (2 if "ST" in lines.letters else 0)
    if "C" in lines.letters:
        if end - at not in _CHANNELS:
            raise MeshError(f"a colour has {end - at} numbers")
        looks["colours"] = spread_colours(_join(table[:, at:end], lines.vertices[0].split()[at:end]), faces)
    if "ST" in lines.letters:
        looks["uvs"] = spread_uvs(table[:, end:], faces)
    return looks


def _read_face_colours(lines: list[bytes], sizes: NDArray[np.integer]) -> NDArray[np.uint8] | None:
    """Return the colours behind the corners of polygons, (p, 4); None if those are no colours."""
    words = lines[0].split()[1 + int(sizes[0]) :]
    if len(words) not in _CHANNELS:
        return None  # one number is that of a colour in a table, which the file does not have
    if (sizes == sizes[0]).all():
        table = _read_table(lines)
    else:
        rest = [b" ".join(line.split()[1 + int(size) :]) for line, size in zip(lines, sizes, strict=True)]
        table = _read_table(rest)
    if table is None:
        raise MeshError("not all faces have one")
    return _join(table[:, -len(words) :], words)


def _read_table(lines: list[bytes]) -> NDArray[np.float64] | None:
    """Return the numbers of all lines; None unless they are as many in each."""
    width = len(lines[0].split())
    text = b"\n".join(lines) + b"\n"
    if not are_number_lines(np.frombuffer(text, np.uint8), width):
        return None
    return np.fromstring(text, np.float64, sep=" ").reshape(-1, width)


def _join(numbers: NDArray[np.float64], words: list[bytes]) -> NDArray[np.uint8]:
    """Return colours: whole numbers are shares of 255, others of 1."""
    is_whole = all(word.isdigit() for word in words)
    return join_channels(list(numbers.T), np.dtype(np.uint8 if is_whole else np.float64))
