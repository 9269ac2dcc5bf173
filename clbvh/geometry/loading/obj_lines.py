"""The lines of an OBJ file by kind, and the corners of its faces, found in one pass by compiled loops."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...support.compiled import compiled
from .ply import are_number_lines

# The kinds of lines.
VERTEX, UV, NORMAL, FACE, OTHER = range(1, 6)

_NEWLINE, _SPACE, _TAB, _V, _T, _N, _F = b"\n \tvtnf"
_ZERO, _NINE, _MINUS, _PLUS, _SLASH = b"09-+/"
_MAX_DIGITS = 18  # fit int64


class ObjLines:
    """The lines of a text without comments, by kind.

    Attributes
    ----------
    text : bytes
    kinds : (n,) uint8
        Of the lines that are not empty.
    """

    def __init__(self, text: bytes) -> None:
        self.text = text
        self._bytes = np.frombuffer(text, np.uint8)
        count = _count_lines(self._bytes)
        self.kinds = np.empty(count, np.uint8)
        self._begins, self._ends = np.empty(count, np.int64), np.empty(count, np.int64)
        _find_lines(self._bytes, self.kinds, self._begins, self._ends)

    def find(self, kind: int) -> NDArray[np.int64]:
        """Return the numbers of the lines of a kind."""
        return np.flatnonzero(self.kinds == kind)

    def words(self, line: int) -> bytes:
        """Return a line without its keyword, or with it if it is of the kind `OTHER`."""
        return self.text[self._begins[line] : self._ends[line]]

    def list_words(self, kind: int) -> list[bytes]:
        """Return all lines of a kind."""
        return [self.words(line) for line in self.find(kind)]

    def join(self, kind: int) -> NDArray[np.uint8]:
        """Return all lines of a kind, each with its end, as bytes (n,)."""
        lines = self.find(kind)
        joined = np.empty(int((self._ends[lines] - self._begins[lines]).sum()) + len(lines), np.uint8)
        _copy_lines(self._bytes, self._begins, self._ends, lines, joined)
        return joined

    def read_numbers(self, kind: int) -> NDArray[np.float64] | None:
        """Return the numbers of the lines of a kind, a table; None unless all lines have the same number of them."""
        lines = self.find(kind)
        if len(lines) == 0:
            return None
        width = len(self.words(lines[0]).split())
        joined = self.join(kind).tobytes()
        if width == 0 or not are_number_lines(np.frombuffer(joined, np.uint8), width):
            return None
        return np.fromstring(joined, np.float64, sep=" ").reshape(-1, width)


class ObjCorners(NamedTuple):
    """The corners of all faces: indices of vertex, texture coordinates and normal, 0 for none, and corners per face."""

    indices: NDArray[np.int64]
    sizes: NDArray[np.int64]


def read_corners(lines: ObjLines) -> ObjCorners | None:
    """Return the corners of all faces; None if a word is no corner."""
    text = lines.join(FACE)
    indices = np.zeros((_count_words(text), 3), np.int64)
    sizes = np.zeros(len(lines.find(FACE)), np.int64)
    return ObjCorners(indices, sizes) if _parse_corners(text, indices, sizes) else None


def resolve_indices(
    corners: NDArray[np.int64], sizes: NDArray[np.int64], lines: ObjLines, kind: int
) -> NDArray[np.int64]:
    """Return indices from 0 of indices as the file counts them, (n,); what is no index becomes negative.

    Indices count from 1; a negative one counts back from the last line of its kind above the face.
    """
    ids = np.where(corners > 0, corners - 1, -1)
    if (corners < 0).any():
        above = np.cumsum(lines.kinds == kind)[lines.kinds == FACE]
        ids = np.where(corners < 0, corners + above.repeat(sizes), ids)
    return ids


@compiled
def _count_lines(text):
    count = 0
    is_empty = True
    for character in text:
        if character == _NEWLINE:
            is_empty = True
        elif is_empty and character != _SPACE and character != _TAB:
            count += 1
            is_empty = False
    return count


@compiled
def _find_lines(text, kinds, begins, ends):
    """Write the kind, begin and end of each line that is not empty."""
    line, at, size = 0, 0, len(text)
    while at < size:
        while at < size and (text[at] == _SPACE or text[at] == _TAB):
            at += 1
        begin = at
        while at < size and text[at] != _NEWLINE:
            at += 1
        if at > begin:
            kind, width = OTHER, 0
            first = text[begin]
            second = text[begin + 1] if begin + 1 < at else _SPACE
            third = text[begin + 2] if begin + 2 < at else _SPACE
            is_short = second in (_SPACE, _TAB)
            if first == _F and is_short:
                kind, width = FACE, 1
            elif first == _V and is_short:
                kind, width = VERTEX, 1
            elif first == _V and third in (_SPACE, _TAB):
                if second == _T:
                    kind, width = UV, 2
                elif second == _N:
                    kind, width = NORMAL, 2
            kinds[line], begins[line], ends[line] = kind, begin + width, at
            line += 1
        at += 1


@compiled
def _copy_lines(text, begins, ends, lines, joined):
    at = 0
    for line in lines:
        for source in range(begins[line], ends[line]):
            joined[at] = text[source]
            at += 1
        joined[at] = _NEWLINE
        at += 1


@compiled
def _count_words(text):
    count = 0
    is_between = True
    for character in text:
        if character in (_SPACE, _TAB, _NEWLINE):
            is_between = True
        elif is_between:
            is_between = False
            count += 1
    return count


@compiled
def _parse_corners(text, indices, sizes):
    """Write the indices of corners such as `7`, `7/8`, `7//9` and `7/8/9`; return whether all words are corners."""
    corner, face, slot, digits, value, sign = -1, 0, 0, 0, 0, 0
    for character in text:
        if _ZERO <= character <= _NINE:
            if digits == 0 and sign == 0:
                sign = 1
            if digits == 0 and slot == 0:
                corner += 1
                sizes[face] += 1
            digits += 1
            if digits > _MAX_DIGITS:
                return False
            value = 10 * value + (np.int64(character) - _ZERO)
            continue
        if character in (_MINUS, _PLUS):
            if digits > 0 or sign != 0:
                return False
            sign = -1 if character == _MINUS else 1
            continue
        if sign != 0 and digits == 0:
            return False  # a sign without a number
        if digits > 0:
            indices[corner, slot] = sign * value
        elif slot == 0 and character == _SLASH:
            return False  # no vertex before the slash
        digits, value, sign = 0, 0, 0
        if character == _SLASH:
            slot += 1
            if slot > 2:
                return False
        elif character in (_SPACE, _TAB):
            slot = 0
        elif character == _NEWLINE:
            slot = 0
            face += 1
        else:
            return False
    return True
