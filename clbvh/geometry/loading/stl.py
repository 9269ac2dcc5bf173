"""The STL format, binary and text: triangles in the file's order, of all solids.

trimesh reads binary files; of texts it takes those of any structure, and drops a solid that does not end. Corners are
merged where their coordinates are the same bit for bit, and nowhere else: a tolerance would need to know the unit,
which the format does not name. Normals are skipped: they are those of the triangles. Colours of binary files are read,
of both kinds: those of Materialise Magics, whose header has a `COLOR=`, and those of VisCAM and SolidView.
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ..appearance.appearance import Appearance
from ..appearance.material import OPAQUE, Material
from ..appearance.srgb import linear_to_srgb_bytes
from ..topology import find_equal_points
from .file_mesh import FileMesh, Problems, find_stl_end, finish_looks, has_stl_triangles, read_table

_HEADER_BYTES = 80


# Bits of the attribute: a mark, and three channels of 0 to 31. The colour in a header is red, green, blue and alpha.
_MARK, _MOST = 0x8000, 31
_DEFAULT_COLOUR = re.compile(rb"COLOR=(.{4})", re.DOTALL)

# The first two letters of each line: whole solids of whole facets. A solid's name is free, and may hold any word.
_NAME = re.compile(rb"\n(solid|endsolid)[^\n]*")
_LINE = re.compile(rb"\n *(\w\w)")
_STRUCTURE = re.compile(rb"(?:so(?:faouveveveenen)*en)+")
_VERTEX = re.compile(rb"\n *vertex([^\n]*)")


def read_stl(data: bytes, _: Path, problems: Problems) -> FileMesh:
    """Return the vertices (V, 3), float32 of a binary file and float64 of a text, and the faces (F, 3)."""
    appearance, end = None, find_stl_end(data)
    if len(data) == end or has_stl_triangles(data):
        from trimesh.exchange.stl import load_stl_binary  # takes 0.3 s

        if len(data) > end:
            problems.add(f"{len(data) - end:,} bytes behind the last triangle that the header declares are left out")
        loaded = load_stl_binary(io.BytesIO(data[:end]))
        corners = loaded.get("vertices", np.empty((0, 3), np.float32))
        with problems.drop("the colours"):
            appearance = _read_colours(data[:_HEADER_BYTES], loaded["face_attributes"]["stl"]) if len(corners) else None
    else:
        corners = _read_text(data)
    first, ids = find_equal_points(corners)
    return FileMesh("", corners[first], ids.reshape(-1, 3), appearance)


def _read_text(data: bytes) -> NDArray[np.float64]:
    """Return the corners of the triangles of a text, (3 F, 3)."""
    text = b"\n" + data.strip().replace(b"\r", b"\n").replace(b"\t", b" ").lower() + b"\n"
    text = _NAME.sub(rb"\n\1", re.sub(rb"\n +(?=solid|endsolid)", b"\n", text))
    structure = b"".join(_LINE.findall(text))
    is_whole = _STRUCTURE.fullmatch(structure)
    if not text.startswith(b"\nsolid") or not (is_whole or b"facet" in text):
        raise MeshError("the file is cut off or not an STL file: it has no facets, nor the size it declares")
    if not is_whole:
        raise MeshError("the file is cut off or damaged: it is not of whole solids of whole facets")
    if not (count := structure.count(b"ve")):
        return np.empty((0, 3))
    corners = read_table(b"\n".join(_VERTEX.findall(text)))
    if corners is None or corners.shape != (count, 3):
        raise MeshError("the file is damaged: a vertex is not three numbers")
    return corners


def _read_colours(header: bytes, attributes: NDArray[Any]) -> Appearance | None:
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
    return finish_looks({"colours": np.repeat(colours[:, None], 3, axis=1)}, [])
