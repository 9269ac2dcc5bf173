"""The STL format, binary and ASCII: triangles that share no vertices."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from ..errors import MeshError
from .text_numbers import NotANumberError, parse_numbers

_HEADER_BYTES = 80
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_COUNT_BYTES = 4
_DATA_BEGIN = _HEADER_BYTES + _COUNT_BYTES

_SOLID = re.compile(rb"solid\b[^\r\n]*")
_FACET = re.compile(rb"facet\s+normal\s+\S+\s+\S+\s+\S+\s+outer\s+loop\b")
# How far into a text file its first facet may stand, behind a long name or comments.
_FACET_WITHIN_BYTES = 4096
_NUMBERS_PER_FACET = 9


def is_stl(data: bytes) -> bool:
    """Return whether the bytes can be nothing but an STL file: by their size, or by their first words."""
    return len(data) == _find_binary_size(data) or _is_text(data)


def read_stl(data: bytes, source: str) -> tuple[NDArray[np.floating], NDArray[np.int32]]:
    """Read an STL file.

    Parameters
    ----------
    data : bytes
        The file.
    source : str
        What messages call it.

    Returns
    -------
    vertices : (3 F, 3) float32 (binary) or float64 (ASCII), object units
    faces : (F, 3) int32
        In the file's order, those of all solids together.

    Raises
    ------
    MeshError
        Not an STL file, cut off, or longer than its header says.
    """
    size = _find_binary_size(data)
    if len(data) != size and _is_text(data):
        vertices = _read_text(data, source)
    elif len(data) < _DATA_BEGIN:
        raise MeshError(f"{source}: the file is cut off or not an STL file: it has only {len(data)} bytes")
    elif len(data) != size:
        raise MeshError(
            f"{source}: the file is cut off, damaged or not an STL file: its header declares "
            f"{_read_count(data):,} triangles, which take {size:,} bytes, but it has {len(data):,}"
        )
    else:
        vertices = np.frombuffer(data, dtype=_TRIANGLE, offset=_DATA_BEGIN)["corners"].reshape(-1, 3)
    return vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)


def _read_count(data: bytes) -> int:
    return int.from_bytes(data[_HEADER_BYTES:_DATA_BEGIN], "little")


def _find_binary_size(data: bytes) -> int:
    """Return how many bytes the file should have, if it is a binary one."""
    return _DATA_BEGIN + _read_count(data) * _TRIANGLE.itemsize


def _is_text(data: bytes) -> bool:
    # Many a binary file begins with "solid" too, but goes on with zeros.
    start = data[:_FACET_WITHIN_BYTES]
    words = start.lower().split(None, 1)
    return words[:1] == [b"solid"] and b"\0" not in start


def _read_text(data: bytes, source: str) -> NDArray[np.float64]:
    """Return the corners of all facets as (3 F, 3) float64."""
    text = data.lower()
    # Take the lines of the solids out: they hold names, which may be anything.
    ends: list[bool] = []
    pieces = []
    at = 0
    for match in _SOLID.finditer(text):
        ends.append(text.endswith(b"end", at, match.start()))
        pieces.append(text[at : match.start() - len(b"end") * ends[-1]])
        at = match.end()
    if ends != [False, True] * (len(ends) // 2) or not ends:
        raise MeshError(f"{source}: the file is cut off: a 'solid' has no 'endsolid'")
    text = b"".join([*pieces, text[at:]])

    # All that is left of a facet is "vertex x y z", three times.
    text, facet_count = _FACET.subn(b"", text)
    facets = text.split(b"endfacet")
    if len(facets) - 1 != facet_count:
        raise MeshError(f"{source}: {facet_count} facets begin, but {len(facets) - 1} end: the file is damaged")
    for facet_id, facet in enumerate(facets[:-1]):
        if facet.count(b"vertex") != 3 or facet.count(b"endloop") != 1:
            raise MeshError(f"{source}: facet {facet_id} is not one loop of three vertices")
    text = text.replace(b"vertex", b"").replace(b"endloop", b"").replace(b"endfacet", b"")
    try:
        numbers = parse_numbers(text)
    except NotANumberError as error:
        facet_id = error.token_id // _NUMBERS_PER_FACET
        raise MeshError(f"{source}: facet {facet_id} has '{error.token}' where a coordinate is expected") from error
    if len(numbers) != facet_count * _NUMBERS_PER_FACET:
        raise MeshError(f"{source}: the file has {len(numbers)} coordinates for {facet_count} facets instead of 9 each")
    return numbers.reshape(-1, 3)
