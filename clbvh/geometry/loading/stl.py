"""The STL format, binary and text: triangles in the file's order, of all solids.

Corners are merged where their coordinates are the same bit for bit, and nowhere else: a tolerance would need to know
the unit, which the format does not name. Normals and attributes are skipped.
"""

from __future__ import annotations

import re
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from .merge_points import merge_points

_COUNT = slice(80, 84)  # bytes of a binary file that hold the number of its triangles
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

_VERTEX = rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)\s+"
_FACET = re.compile(
    rb"\bfacet\s+normal\s+(?:\S+\s+){3}outer\s+loop\s+" + 3 * _VERTEX + rb"endloop\s+endfacet\b", re.IGNORECASE
)
_FACET_BEGINNING = re.compile(rb"\bfacet\s+normal\b", re.IGNORECASE)
_SOLID = re.compile(rb"^[ \t]*(end)?solid\b.*$", re.IGNORECASE | re.MULTILINE)


def read_stl(data: bytes, _: Path) -> tuple[NDArray[np.floating], NDArray[np.integer]]:
    """Return the vertices (V, 3), float32 of a binary file and float64 of a text, and the faces (F, 3)."""
    if is_binary_stl(data):
        corners = np.frombuffer(data, _TRIANGLE, offset=_COUNT.stop)["corners"].reshape(-1, 3)
    else:
        corners = _read_text(data)
    vertices, ids = merge_points(corners)
    return vertices, ids.reshape(-1, 3)


def is_binary_stl(data: bytes) -> bool:
    """Return whether the size is the one that the header of a binary STL file would declare.

    The first word tells nothing: many programs begin binary files with `solid`, as text files do.
    """
    return len(data) == _COUNT.stop + int.from_bytes(data[_COUNT], "little") * _TRIANGLE.itemsize


def _read_text(data: bytes) -> NDArray[np.float64]:
    """Return the corners of all triangles, (3 F, 3)."""
    text = data.replace(b"\r", b"\n")
    # Names of solids are free, and may hold any of the format's words.
    solids = [word.lower() for word in _SOLID.findall(text)]
    text = _SOLID.sub(b"", text)
    facet_count = len(_FACET_BEGINNING.findall(text))
    if not solids or not facet_count:
        raise MeshError("the file is cut off or not an STL file: it has no facets, nor the size it declares")
    facets = _FACET.findall(text)
    if facet_count != len(facets) or _FACET.sub(b"", text).strip():
        raise MeshError(
            f"the file is cut off or damaged: it has {facet_count:,} triangles, but {len(facets):,} are whole, "
            "or something else stands between them"
        )
    if solids != [b"", b"end"] * (len(solids) // 2):
        raise MeshError("the file is cut off or damaged: not every 'solid' is followed by its 'endsolid'")
    return np.fromiter(map(float, chain.from_iterable(facets)), np.float64).reshape(-1, 3)
