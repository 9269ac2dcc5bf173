"""Decimal numbers in text to float64, many at a time.

Owns the reading of white-space separated numbers, for every text format of a mesh. Knows nothing of meshes.

A dragon-class file has five million numbers, and `float` on each takes a second. Here eight digits are read at once
as one 64-bit word, for all tokens of a chunk together (Daniel Lemire, "Quickly parsing eight digits", 2018). The
result is the double nearest to the text, as `float` gives it: with at most 2^53 in the mantissa and 22 in the
exponent, both operands of the last division are exact, so it rounds once (William Clinger, "How to Read Floating
Point Numbers Accurately", 1990). All other tokens go to `float`.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

# Chunk and temporaries stay in the cache, yet are large enough that threads seldom wait for each other: on a 2-core
# x86-64 server, 37 MB take 0.13 s with 512 KB or 1 MB and two threads, 0.19 s with 128 KB, and 0.25 s with one thread.
_CHUNK_BYTES = 1 << 19
_MAX_THREADS = 4

# Words are read backwards from the end of a token, so a chunk needs blanks before its first one.
_WORD_BYTES = 8
_LEAD_BYTES = 3 * _WORD_BYTES

# A token longer than this is no number, and a file without white space must not be walked byte by byte.
_MAX_TOKEN_BYTES = 1024

_MAX_VALUE_DIGITS = 2 * _WORD_BYTES  # digits before or after the point whose value is taken from words
_MAX_RUN_DIGITS = 3 * _WORD_BYTES  # so many are still known to be digits
_MAX_MANTISSA_DIGITS = 19  # a decimal number of so many digits fits uint64
_MAX_EXACT_MANTISSA = np.uint64(1 << 53)
_MAX_EXACT_POWER = 22  # 10^22 is the largest power of ten that float64 holds exactly

# A call of `float` takes about three times as long as a token in `np.fromstring`.
_MANY = 3

_POWERS_OF_TEN = np.array([float(10**power) for power in range(_MAX_EXACT_POWER + 1)])
_INTEGER_POWERS_OF_TEN = np.array([10**power for power in range(_MAX_MANTISSA_DIGITS + 1)], dtype=np.uint64)

# The last n characters of a word, which a little-endian machine holds in its upper n bytes.
_KEEP_LAST = np.array(
    [0, *((0xFFFF_FFFF_FFFF_FFFF << (64 - 8 * count)) & 0xFFFF_FFFF_FFFF_FFFF for count in range(1, 9))],
    dtype=np.uint64,
)
_ZEROS = np.uint64(0x3030_3030_3030_3030)
_TOP_BITS = np.uint64(0x8080_8080_8080_8080)
_ABOVE_NINE = np.uint64(0x7676_7676_7676_7676)  # added to a byte above 9, it sets the byte's top bit

_SPACE, _NEWLINE, _PLUS, _MINUS, _POINT, _LOWER_E, _LOWER_BIT = 0x20, 0x0A, 0x2B, 0x2D, 0x2E, 0x65, 0x20


class NotANumberError(ValueError):
    """A token of the text is no decimal number.

    Parameters
    ----------
    token : str
        The token, shortened.
    offset : int
        Where it begins, in bytes.
    token_id : int
        Which token it is, from 0.
    """

    def __init__(self, token: bytes, offset: int, token_id: int) -> None:
        self.token = token[:40].decode("ascii", "replace")
        self.offset = offset
        self.token_id = token_id
        super().__init__(f"'{self.token}' at byte {offset} is not a number")


def parse_numbers(text: bytes | memoryview) -> NDArray[np.float64]:
    """Read all numbers of a text.

    Parameters
    ----------
    text : bytes
        Decimal numbers, `nan` and `inf` among them, between bytes that are not above 32.

    Returns
    -------
    (n,) float64
        Each the double nearest to its token.

    Raises
    ------
    NotANumberError
        At the first token that is none.

    Notes
    -----
    About 150 MB/s per thread, on up to four threads; the result does not depend on their number. Beside the result it
    takes some 4 MB per thread.
    """
    if len(text) == 0:
        return np.empty(0)
    source = np.frombuffer(text, dtype=np.uint8)
    bounds = [0]
    while bounds[-1] < len(source):
        bounds.append(_find_chunk_end(source, bounds[-1]))

    def parse(chunk_id: int) -> NDArray[np.float64]:
        begin, end = bounds[chunk_id], bounds[chunk_id + 1]
        chunk = np.full(_LEAD_BYTES + end - begin + 1, _SPACE, dtype=np.uint8)
        chunk[_LEAD_BYTES:-1] = source[begin:end]
        return _parse_chunk(chunk, begin - _LEAD_BYTES)

    # numpy lets go of the interpreter while it works on an array, so threads run side by side.
    chunk_ids = range(len(bounds) - 1)
    thread_count = min(len(chunk_ids), _count_cpus(), _MAX_THREADS)
    parts: list[NDArray[np.float64]] = []
    try:
        with ThreadPoolExecutor(thread_count) as threads:
            for part in threads.map(parse, chunk_ids) if thread_count > 1 else map(parse, chunk_ids):
                parts.append(part)  # noqa: PERF402 - what stands there when a later chunk fails is counted
    except NotANumberError as error:
        # The chunk counted its own tokens only; the ones before it are in `parts`, in order.
        error.token_id += sum(map(len, parts))
        raise
    return np.concatenate(parts)


def count_tokens_per_line(text: bytes | memoryview) -> NDArray[np.int64]:
    """Return how many tokens each line has, as an (n,) int64 array.

    The lines end with a newline; the last one may do without.
    """
    if len(text) == 0:
        return np.empty(0, dtype=np.int64)
    source = np.frombuffer(text, dtype=np.uint8)
    blank = source <= _SPACE
    starts = np.flatnonzero(~blank & np.concatenate(([True], blank[:-1])))
    line_ends = np.flatnonzero(source == _NEWLINE)
    if source[-1] != _NEWLINE:
        line_ends = np.append(line_ends, len(source))
    return np.diff(np.searchsorted(starts, line_ends), prepend=0)


def _find_chunk_end(source: NDArray[np.uint8], begin: int) -> int:
    """Return where a chunk that starts at `begin` may end without cutting a token."""
    end = begin + _CHUNK_BYTES
    if end >= len(source):
        return len(source)
    blanks = np.flatnonzero(source[end : end + _MAX_TOKEN_BYTES] <= _SPACE)
    if len(blanks):
        return end + int(blanks[0])
    if end + _MAX_TOKEN_BYTES >= len(source):
        return len(source)
    # No number is so long: let the parse of the chunk find that out, and say where it begins.
    return end


def _count_cpus() -> int:
    """Return how many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _parse_chunk(chunk: NDArray[np.uint8], offset: int) -> NDArray[np.float64]:
    """Read the tokens of one chunk, which has blanks at both ends and begins at `offset` in the text."""
    # Tokens lie between the places where blanks end and begin.
    blank = chunk <= _SPACE
    edges = np.flatnonzero(blank[1:] != blank[:-1]) + 1
    starts, ends = edges[::2], edges[1::2]
    if len(starts) == 0:
        return np.empty(0)
    first = chunk[starts]
    negative = first == _MINUS
    begins = starts + (negative | (first == _PLUS))

    # The digits before the exponent and the point are a run, those between the two another.
    exponent_marks = np.flatnonzero((chunk | _LOWER_BIT) == _LOWER_E)
    mantissa_ends = _place_marks(exponent_marks, starts, ends)
    points = np.flatnonzero(chunk == _POINT)
    whole_ends = _place_marks(points, starts, mantissa_ends)
    whole_digits = whole_ends - begins
    mantissa, odd = _parse_run(chunk, whole_ends, whole_digits)
    digits, power = whole_digits, None
    if len(points):
        fraction_digits = np.maximum(mantissa_ends - whole_ends - 1, 0)
        fraction, bad = _parse_run(chunk, mantissa_ends, fraction_digits)
        digits = whole_digits + fraction_digits
        odd |= bad
        mantissa *= _INTEGER_POWERS_OF_TEN[np.minimum(fraction_digits, _MAX_MANTISSA_DIGITS)]
        mantissa += fraction
        power = -fraction_digits
    odd |= digits <= 0
    if len(exponent_marks):
        power = np.zeros(len(starts), dtype=np.int64) if power is None else power
        marked = np.flatnonzero(mantissa_ends < ends)
        exponent, bad = _parse_exponent(chunk, mantissa_ends[marked], ends[marked])
        power[marked] += exponent
        odd[marked] |= bad

    # Exact times or through exact: one rounding.
    inexact = mantissa > _MAX_EXACT_MANTISSA
    if digits.max() > _MAX_VALUE_DIGITS:
        inexact |= digits > _MAX_MANTISSA_DIGITS
        inexact |= np.maximum(whole_digits, digits - whole_digits) > _MAX_VALUE_DIGITS
    values = mantissa.astype(np.float64)
    if power is not None:
        inexact |= np.abs(power) > _MAX_EXACT_POWER
        values /= _POWERS_OF_TEN[np.clip(-power, 0, _MAX_EXACT_POWER)]
        if len(exponent_marks):
            values *= _POWERS_OF_TEN[np.clip(power, 0, _MAX_EXACT_POWER)]
    np.negative(values, out=values, where=negative)

    # Where every other token has 16 or 17 digits, but all are numbers, numpy's own reader is the quickest.
    if not odd.any() and np.count_nonzero(inexact) > len(inexact) // _MANY:
        return np.where(inexact, np.fromstring(chunk.tobytes(), sep=" "), values)
    for token_id in np.flatnonzero(odd | inexact):
        token = chunk[starts[token_id] : ends[token_id]].tobytes()
        try:
            if b"_" in token:  # a digit separator of Python, not of any mesh file
                raise ValueError(token)  # noqa: TRY301
            values[token_id] = float(token)
        except ValueError:
            raise NotANumberError(token, offset + int(starts[token_id]), int(token_id)) from None
    return values


def _place_marks(marks: NDArray[np.int64], starts: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the mark of each token that has one, the end of each other.

    `marks` is sorted. A second mark is no digit, so a run that contains one is found to be bad.
    """
    if len(marks) == 0:
        return ends
    token_ids = np.searchsorted(starts, marks, side="right") - 1
    inside = marks < ends[token_ids]
    placed = ends.copy()
    placed[token_ids[inside]] = marks[inside]
    return placed


def _parse_exponent(
    chunk: NDArray[np.uint8], marks: NDArray[np.int64], ends: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Read the exponents between the letter and the end; true: not one, or too long."""
    signs = chunk[marks + 1]
    down = signs == _MINUS
    digits = ends - marks - 1 - (down | (signs == _PLUS))
    magnitude, bad = _parse_run(chunk, ends, digits)
    # A clipped magnitude is still far outside of what is exact, and goes to `float`.
    exponent = np.minimum(magnitude, 10_000).astype(np.int64)
    return np.where(down, -exponent, exponent), bad | (digits <= 0) | (digits > _MAX_VALUE_DIGITS)


def _parse_run(
    chunk: NDArray[np.uint8], ends: NDArray[np.int64], digits: NDArray[np.int64]
) -> tuple[NDArray[np.uint64], NDArray[np.bool_]]:
    """Read runs of digits that stop at `ends`.

    The value is right for 16 digits at most. True in the second result: not digits, or more than 24.
    """
    longest = int(digits.max(initial=0))
    value, bad = _parse_word(chunk, ends, digits)
    if longest > _WORD_BYTES:
        upper, upper_bad = _parse_word(chunk, ends - _WORD_BYTES, digits - _WORD_BYTES)
        upper *= _INTEGER_POWERS_OF_TEN[_WORD_BYTES]
        value += upper
        bad |= upper_bad
    if longest > _MAX_VALUE_DIGITS:
        bad |= _parse_word(chunk, ends - 2 * _WORD_BYTES, digits - 2 * _WORD_BYTES)[1]
        bad |= digits > _MAX_RUN_DIGITS
    return value, bad


def _parse_word(
    chunk: NDArray[np.uint8], ends: NDArray[np.int64], digits: NDArray[np.int64]
) -> tuple[NDArray[np.uint64], NDArray[np.bool_]]:
    """Read the last `digits` characters, 8 at most, before each of `ends`; true: some are not digits."""
    words = np.ndarray((len(chunk) - _WORD_BYTES + 1,), dtype="<u8", buffer=chunk, strides=(1,))
    word = words[ends - _WORD_BYTES]
    word ^= _ZEROS
    word &= _KEEP_LAST.take(digits, mode="clip")
    check = word + _ABOVE_NINE
    check |= word
    check &= _TOP_BITS
    bad = check != 0
    # Digits become pairs, pairs become fours, fours become eights; the first digit is in the lowest byte.
    word *= np.uint64(2561)
    word >>= np.uint64(8)
    word &= np.uint64(0x00FF_00FF_00FF_00FF)
    word *= np.uint64(6553601)
    word >>= np.uint64(16)
    word &= np.uint64(0x0000_FFFF_0000_FFFF)
    word *= np.uint64(42949672960001)
    word >>= np.uint64(32)
    return word, bad
