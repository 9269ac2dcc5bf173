"""Lines of decimal numbers, checked before a fast reader that is not strict takes them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...support.compiled import compiled

# The kinds of characters.
_DIGIT, _SIGN, _DOT, _EXPONENT, _SPACE, _NEWLINE, _OTHER = range(7)

# The places in a number: between two, after its sign, in its digits, after a dot without digits, after the dot, after
# the e, after its sign, and in its digits.
_BETWEEN, _SIGNED, _WHOLE, _DOTTED, _FRACTION, _E, _E_SIGNED, _E_WHOLE, _WRONG = range(9)


def _make_kinds() -> NDArray[np.uint8]:
    kinds = np.full(256, _OTHER, np.uint8)
    kinds[list(b"0123456789")] = _DIGIT
    kinds[list(b"+-")], kinds[list(b".")], kinds[list(b"eE")] = _SIGN, _DOT, _EXPONENT
    kinds[list(b" \t\r")], kinds[list(b"\n")] = _SPACE, _NEWLINE
    return kinds


def _make_steps() -> NDArray[np.uint8]:
    """Return the next place for each place and each kind of the first four."""
    steps = np.full((_WRONG, _SPACE), _WRONG, np.uint8)
    steps[:, _DIGIT] = (_WHOLE, _WHOLE, _WHOLE, _FRACTION, _FRACTION, _E_WHOLE, _E_WHOLE, _E_WHOLE)
    steps[_BETWEEN, _SIGN], steps[_E, _SIGN] = _SIGNED, _E_SIGNED
    steps[_BETWEEN, _DOT] = steps[_SIGNED, _DOT] = _DOTTED
    steps[_WHOLE, _DOT] = _FRACTION
    steps[_WHOLE, _EXPONENT] = steps[_FRACTION, _EXPONENT] = _E
    return steps


_KINDS, _STEPS = _make_kinds(), _make_steps()


@compiled
def are_number_lines(text, numbers_per_line):
    """Say whether each line of a text, (n,) uint8, holds this number of decimal numbers and nothing else."""
    place, count = _BETWEEN, 0
    for character in text:
        kind = _KINDS[character]
        if kind < _SPACE:
            place = _STEPS[place, kind]
            if place == _WRONG:
                return False
            continue
        if place != _BETWEEN:
            # A number ends with a digit, or with a dot behind one.
            if place != _WHOLE and place != _FRACTION and place != _E_WHOLE:
                return False
            place, count = _BETWEEN, count + 1
        if kind == _OTHER:
            return False
        if kind == _NEWLINE:
            if count != numbers_per_line:
                return False
            count = 0
    return True
