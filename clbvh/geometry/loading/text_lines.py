"""Lines of numbers, as the text formats OBJ and OFF have them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError

_WHOLE = re.compile(rb"[+-]?[0-9]{1,18}")  # fits int64


def read_coordinates(lines: list[bytes]) -> NDArray[np.float64]:
    """Return the first three numbers of each line, (n, 3).

    Raises
    ------
    MeshError
        There is no line, or one is empty.
    ValueError
        A line has a word among its first three that is no number, or fewer than three.
    """
    if not lines:
        raise MeshError("the mesh has no vertices")
    # numpy would skip an empty line, and all later faces would refer to the wrong vertices.
    empty = next((vertex for vertex, line in enumerate(lines) if not line.strip()), None)
    if empty is not None:
        raise MeshError(f"vertex {empty} has no coordinates")
    return np.loadtxt(lines, usecols=(0, 1, 2), ndmin=2, comments=None)


def read_table(lines: list[bytes], columns: Sequence[int] | None = None) -> NDArray[np.int64] | None:
    """Return whole numbers, one row per line; None if the lines differ in length or a word is no whole number.

    Parameters
    ----------
    lines : list of bytes
    columns : sequence of int, optional
        Those that are read; all without it.
    """
    if not lines or not lines[0].strip():
        return None
    try:
        table = np.loadtxt(lines, np.int64, usecols=columns, ndmin=2, comments=None)
    except ValueError:
        return None
    return table if len(table) == len(lines) else None


def join_polygons(polygons: list[list[bytes]]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the corners of all polygons, concatenated, and the number of corners of each.

    Raises
    ------
    MeshError
        A word is no whole number, or one of too many digits for an index.
    """
    words = list(chain.from_iterable(polygons))
    sizes = np.fromiter(map(len, polygons), np.int64)
    table = read_table(words)
    if table is not None and table.shape[1] == 1:
        return table[:, 0], sizes
    for face, polygon in enumerate(polygons):
        for word in polygon:
            if not _WHOLE.fullmatch(word):
                raise MeshError(f"face {face} has a corner {word.decode('latin-1')[:80]!r}, which is no vertex index")
    return np.empty(0, np.int64), sizes
