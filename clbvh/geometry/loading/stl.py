"""The STL format, binary and text: triangles in the file's order, of all solids.

Corners are merged where their coordinates are the same bit for bit, and nowhere else: a tolerance would need to know
the unit, which the format does not name. Normals are skipped: they are those of the triangles. Colours of binary files
are read, of both kinds: those of Materialise Magics, whose header has a `COLOR=`, and those of VisCAM and SolidView.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ..appearance.appearance import Appearance
from ..appearance.material import OPAQUE, Material
from ..appearance.srgb import linear_to_srgb_bytes
from ..topology import find_equal_points
from .file_mesh import FileMesh, Problems, finish_looks, spread_colours

_COUNT = slice(80, 84)  # bytes of a binary file that hold the number of its triangles
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

# Bits of the attribute: a mark, and three channels of 0 to 31. The colour in a header is red, green, blue and alpha.
_MARK, _MOST = 0x8000, 31
_DEFAULT_COLOUR = re.compile(rb"COLOR=(.{4})", re.DOTALL)

# The words of a triangle, None where a number stands. Those of the normal may be anything.
_VERTEX = (b"vertex", None, None, None)
_FACET = (b"facet", b"normal", None, None, None, b"outer", b"loop", *3 * _VERTEX, b"endloop", b"endfacet")
_COORDINATES = [at for at, word in enumerate(_FACET) if word is None][3:]


def read_stl(data: bytes, _: Path, problems: Problems) -> FileMesh:
    """Return the vertices (V, 3), float32 of a binary file and float64 of a text, and the faces (F, 3)."""
    appearance = None
    if is_binary_stl(data):
        triangles = np.frombuffer(data, _TRIANGLE, offset=_COUNT.stop)
        corners = triangles["corners"].reshape(-1, 3)
        with problems.drop("the colours"):
            appearance = _read_colours(data[: _COUNT.start], triangles["attribute"])
    else:
        corners = _read_text(data)
    first, ids = find_equal_points(corners)
    vertices = corners[first]
    return FileMesh("", vertices, ids.reshape(-1, 3), appearance)


def is_binary_stl(data: bytes) -> bool:
    """Return whether the size is the one that the header of a binary STL file would declare.

    The first word tells nothing: many programs begin binary files with `solid`, as text files do.
    """
    return len(data) == _COUNT.stop + int.from_bytes(data[_COUNT], "little") * _TRIANGLE.itemsize


def _read_colours(header: bytes, attributes: NDArray[np.uint16]) -> Appearance | None:
    """Return the colours of the triangles, whose attributes have 5 bits for each channel; None if they have none."""
    found = _DEFAULT_COLOUR.search(header)
    if not attributes.any() and found is None:
        return None
    is_marked = (attributes & _MARK) != 0
    if found is not None:
        # The mark means the colour of the header; without any attribute all triangles have that one.
        default, channels = np.frombuffer(found[1], np.uint8), (0, 5, 10)
        has_own = ~is_marked if attributes.any() else np.zeros(len(attributes), np.bool_)
    else:
        default = np.append(linear_to_srgb_bytes(Material.base_colour), np.uint8(OPAQUE))
        has_own, channels = is_marked, (10, 5, 0)
        if not has_own.any():
            return None
    colours = np.tile(default, (len(attributes), 1))
    colours[has_own, 3] = OPAQUE
    for channel, shift in enumerate(channels):
        shares = (attributes[has_own] >> shift & _MOST).astype(np.uint32)
        colours[has_own, channel] = (shares * OPAQUE + _MOST // 2) // _MOST
    corners = np.repeat(np.arange(len(colours))[:, None], 3, axis=1)
    return finish_looks({"colours": spread_colours(colours, corners)}, [])


def _read_text(data: bytes) -> NDArray[np.float64]:
    """Return the corners of all triangles, (3 F, 3)."""
    text = data.replace(b"\r", b"\n").lower()
    keywords, body = _split_solids(text)
    words = body.split()
    if not keywords or not words:
        raise MeshError("the file is cut off or not an STL file: it has no facets, nor the size it declares")
    whole_count = len(words) // len(_FACET)
    for at, keyword in enumerate(_FACET):
        column = words[at :: len(_FACET)]
        if keyword is not None and column != [keyword] * len(column):
            whole_count = min(whole_count, next(i for i, word in enumerate(column) if word != keyword))
    if whole_count * len(_FACET) != len(words):
        raise MeshError(
            f"the file is cut off or damaged: behind {whole_count:,} whole triangles it has words that are none"
        )
    if keywords != [b"solid", b"endsolid"] * (len(keywords) // 2):
        raise MeshError("the file is cut off or damaged: not every 'solid' is followed by its 'endsolid'")
    columns = [np.loadtxt(words[at :: len(_FACET)], ndmin=1, comments=None) for at in _COORDINATES]
    return np.column_stack(columns).reshape(-1, 3)


def _split_solids(text: bytes) -> tuple[list[bytes], bytes]:
    """Return the first words of all lines that begin or end a solid, and the text without those lines.

    The name of a solid is free, and may hold any of the format's words.
    """
    keywords, parts, begin = [], [], 0
    at = text.find(b"solid")
    while at >= 0:
        line_begin, line_end = text.rfind(b"\n", 0, at) + 1, text.find(b"\n", at)
        line_end = len(text) if line_end < 0 else line_end
        word = text[line_begin:line_end].split(None, 1)[0]
        if word in (b"solid", b"endsolid"):
            keywords.append(word)
            parts.append(text[begin:line_begin])
            begin = line_end
        at = text.find(b"solid", line_end)
    return keywords, b"".join([*parts, text[begin:]])
