"""The STL format, binary and text, read by trimesh: triangles in the file's order, of all solids.

trimesh takes texts of any structure, and drops a solid that does not end, so texts are looked at first. Corners are
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
from .file_mesh import FileMesh, Problems, finish_looks, is_binary_stl, spread_colours
from .ply import are_number_lines

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
    from trimesh.exchange.stl import load_stl_ascii, load_stl_binary  # takes 0.3 s

    appearance = None
    if is_binary_stl(data):
        loaded = load_stl_binary(io.BytesIO(data))
        solids = [loaded] if "vertices" in loaded else []
        with problems.drop("the colours"):
            appearance = _read_colours(data[:_HEADER_BYTES], loaded["face_attributes"]["stl"]) if solids else None
    else:
        text, triangle_count = _check_text(data)
        loaded = load_stl_ascii(io.BytesIO(text)) if triangle_count else {"geometry": {}}
        solids = list(loaded["geometry"].values()) if "geometry" in loaded else [loaded]
        if sum(len(solid["faces"]) for solid in solids) != triangle_count:
            raise MeshError(f"the file is damaged: {triangle_count:,} facets are not as many triangles")
    corners = np.concatenate([np.empty((0, 3), np.float32), *(solid["vertices"] for solid in solids)])
    first, ids = find_equal_points(corners)
    return FileMesh("", corners[first], ids.reshape(-1, 3), appearance)


def _check_text(data: bytes) -> tuple[bytes, int]:
    """Return a text of whole solids without their names, and the number of its triangles."""
    text = b"\n" + data.strip().replace(b"\r", b"\n").replace(b"\t", b" ").lower() + b"\n"
    text = _NAME.sub(rb"\n\1", re.sub(rb"\n +(?=solid|endsolid)", b"\n", text))
    is_whole = _STRUCTURE.fullmatch(b"".join(_LINE.findall(text)))
    if not text.startswith(b"\nsolid") or not (is_whole or b"facet" in text):
        raise MeshError("the file is cut off or not an STL file: it has no facets, nor the size it declares")
    if not is_whole:
        raise MeshError("the file is cut off or damaged: it is not of whole solids of whole facets")
    numbers = b"".join(numbers + b"\n" for numbers in _VERTEX.findall(text))
    if not are_number_lines(np.frombuffer(numbers, np.uint8), 3):
        raise MeshError("the file is damaged: a vertex is not three numbers")
    # Normals that are no numbers would make trimesh print a traceback.
    return text.replace(b"normal", b""), text.count(b"endfacet")


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
    corners = np.repeat(np.arange(len(colours))[:, None], 3, axis=1)
    return finish_looks({"colours": spread_colours(colours, corners)}, [])
