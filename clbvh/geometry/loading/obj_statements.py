"""The statements of an OBJ file that hold for all faces below them: names, materials, smoothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .obj_lines import FACE, OTHER, ObjLines


class ObjStatements:
    """The lines of a file that are no vertices and no faces, by keyword."""

    def __init__(self, lines: ObjLines) -> None:
        self._face_lines = lines.find(FACE)
        self._lines: dict[bytes, list[int]] = {}
        self._words: dict[bytes, list[bytes]] = {}
        for line in lines.find(OTHER).tolist():
            keyword, *words = lines.words(line).split(None, 1)
            self._lines.setdefault(keyword, []).append(line)
            self._words.setdefault(keyword, []).append(words[0].strip() if words else b"")

    def has(self, keyword: bytes) -> bool:
        """Return whether the file has such a statement."""
        return keyword in self._lines

    def words_of(self, keyword: bytes) -> list[bytes]:
        """Return what follows the keyword, of all its statements."""
        return self._words.get(keyword, [])

    def find_above(self, keyword: bytes) -> NDArray[np.int64]:
        """Return the number of the last statement above each polygon, (p,); -1 where there is none."""
        return np.searchsorted(np.array(self._lines.get(keyword, []), np.int64), self._face_lines) - 1
