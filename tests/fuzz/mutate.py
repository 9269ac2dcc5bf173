"""Damage to files, at random and from a seed: in their bytes, their numbers, their lines, and their JSON values."""

import re
import struct
from collections.abc import Sequence
from copy import deepcopy
from random import Random
from typing import Any

MAX_BYTES = 1 << 16  # repeated parts must not grow from mutation to mutation

# Mostly one: further ones hide behind the first that makes a file unreadable.
_MUTATION_COUNTS = (1, 1, 1, 2, 4)
_MAX_BITS = 8
_MAX_PART = 200  # bytes that are cut out, repeated or moved at once
_MAX_COPIES = 40

_NUMBER = re.compile(rb"[-+]?[0-9]+(?:\.[0-9]*)?(?:[eE][-+]?[0-9]+)?")
_NUMBERS = (
    b"0 -0 -1 1 2 3 4 255 256 65536 1e9 100000000 0.5 2147483647 2147483648 -2147483649 4294967296 "
    b"9223372036854775807 -9223372036854775809 1e38 -3.5e38 1e308 -1e308 1e-400 1e400 nan NaN inf -inf -Infinity "
    b"0x7fffffff 1_000 1.5.2 --1 + true"
).split()
_NUMBERS += [b"9" * 30, b"9" * 400, b"9" * 5000, b"[" * 3000, b""]
_WORDS = (
    rb"""v f v_ f_ vn_ / // solid_ endsolid facet_normal_ vertex_ endfacet OFF COFF list # { } [ ] " ' = , : null"""
)
_WORDS = [word.replace(b"_", b" ") for word in _WORDS.split()]
_WORDS += [b"ply\n", b"end_header\n", b"element face 5\n", b"property list uchar int x\n", b"[[object]]\n", b"[view]\n"]
_WORDS += [b"\\\n", b"\\\r\n", b"# \\\n", b"\n", b"\r", b"\r\n", b" ", b"\t", b"\0", b"\xff", b"\xef\xbb\xbf"]
_WORDS += [b"\xc2\x85", b"\nv\n", b"\nf\n", b"[" * 3000, b"{" * 3000]
_INTEGERS = [0, 1, 2, 3, 4, 7, 8, 127, 128, 255, 256, 32767, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1]
_INTEGERS += [2**63 - 1, 2**63, 2**64 - 1]
_FLOATS = [0.0, -1.0, 1e-45, 3.4e38, -3.4e38, float("inf"), float("-inf"), float("nan")]
_VALUES: list[Any] = [
    *(None, True, False, 0, 1, 2, 3, 5, -1, 4, 255, 65536, 10**8, 2**31, 2**63, 10**30, -(2**63), 0.5, 1e300, -1e-300),
    *(float("nan"), float("inf"), "", "x", "0", "../a", "data:,", "data:;base64,AAAA", [], [0], [[]], {}, {"a": 1}),
    *(5120, 5121, 5122, 5123, 5125, 5126, "SCALAR", "VEC3", "MAT4", [1e300] * 3, [0] * 4, [1e30] * 16),
]
_KEYS = ["mesh", "children", "matrix", "rotation", "scale", "translation", "sparse", "indices", "mode", "byteStride"]
_KEYS += ["byteOffset", "normalized", "bufferView", "count", "uri", "buffer", "extensions", "extensionsRequired"]
_KEYS += ["scene"]


def mutate(content: bytes, generator: Random, donors: Sequence[bytes]) -> bytes:
    """Return the bytes after one to four mutations; parts of `donors` may be put in."""
    for _ in range(generator.choice(_MUTATION_COUNTS)):
        content = generator.choice(_MUTATIONS)(content, generator, donors)[:MAX_BYTES]
    return content


def mutate_json(document: Any, generator: Random) -> Any:
    """Return a JSON document after one to four changes of single values, keys and items."""
    for _ in range(generator.choice(_MUTATION_COUNTS)):
        places = list(_list_places(document))
        if not places:
            return document
        _change_value(*generator.choice(places), generator)
    return document


def _list_places(value: Any) -> Any:
    """Yield each container within a JSON value, with each of its keys or indices."""
    stack = [value]
    while stack:
        holder = stack.pop()
        for key in holder.keys() if isinstance(holder, dict) else range(len(holder)):
            yield holder, key
            if isinstance(holder[key], dict | list):
                stack.append(holder[key])


def _change_value(holder: Any, key: Any, generator: Random) -> None:
    match generator.randrange(6):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, list):
            holder[key:key] = [deepcopy(holder[key]) for _ in range(generator.randint(1, _MAX_COPIES))]
        case 1:
            holder[generator.choice(_KEYS)] = deepcopy(holder[key])
        case 2 if isinstance(holder, dict):
            holder[generator.choice(_KEYS)] = deepcopy(generator.choice(_VALUES))
        case 3 if isinstance(holder[key], int):
            holder[key] += generator.choice((-1, 1, 4, 100))
        case _:
            holder[key] = deepcopy(generator.choice(_VALUES))


def _cut(content: bytes, generator: Random) -> tuple[int, int]:
    """Return the begin and end of a part."""
    begin = generator.randint(0, len(content))
    return begin, min(len(content), begin + generator.randint(0, _MAX_PART))


def _flip_bits(content, generator, donors):
    flipped = bytearray(content)
    for _ in range(generator.randint(1, _MAX_BITS) if content else 0):
        flipped[generator.randrange(len(flipped))] ^= 1 << generator.randrange(8)
    return bytes(flipped)


def _truncate(content, generator, donors):
    return content[: generator.randint(0, len(content))]


def _remove_part(content, generator, donors):
    begin, end = _cut(content, generator)
    return content[:begin] + content[end:]


def _repeat_part(content, generator, donors):
    begin, end = _cut(content, generator)
    copies = generator.choice((1, 1, 2, generator.randint(1, _MAX_COPIES)))
    return content[:end] + copies * content[begin:end] + content[end:]


def _splice(content, generator, donors):
    donor = generator.choice(donors)
    begin, end = _cut(donor, generator)
    at, behind = _cut(content, generator)
    return content[:at] + donor[begin:end] + content[generator.choice((at, behind)) :]


def _replace_number(content, generator, donors):
    """Replace a decimal number of a text; one of the first ten half of the time, where headers have their counts."""
    numbers = list(_NUMBER.finditer(content, 0, MAX_BYTES))
    if not numbers:
        return content
    number = generator.choice(generator.choice((numbers, numbers[:10])))
    return content[: number.start()] + generator.choice(_NUMBERS) + content[number.end() :]


def _replace_word(content, generator, donors):
    """Overwrite a binary number, mostly a whole one, mostly at a multiple of its size."""
    code = generator.choice("<<<>") + generator.choice("BHIQBHIQfd")
    if code[1] in "fd":
        word = struct.pack(code, generator.choice(_FLOATS))
    else:
        word = struct.pack(code, generator.choice(_INTEGERS) % (1 << 8 * struct.calcsize(code)))
    at = generator.randrange(len(content) + 1)
    at -= at % len(word) if generator.random() < 0.7 else 0
    return content[:at] + word + content[at + len(word) :]


def _insert_word(content, generator, donors):
    at = generator.randint(0, len(content))
    word = generator.choice(_WORDS) if generator.random() < 0.8 else generator.randbytes(generator.randint(1, 8))
    return content[:at] + word + content[at:]


def _change_lines(content, generator, donors):
    lines = content.splitlines(keepends=True)
    if not lines:
        return content
    at, other = generator.randrange(len(lines)), generator.randrange(len(lines))
    match generator.randrange(4):
        case 0:
            del lines[at]
        case 1:
            lines.insert(other, lines[at])
        case 2:
            lines[at], lines[other] = lines[other], lines[at]
        case 3:
            words = lines[at].split()
            lines[at] = b" ".join(generator.sample(words, generator.randint(0, len(words)))) + b"\n"
    return b"".join(lines)


_MUTATIONS = [
    *(_flip_bits, _truncate, _remove_part, _repeat_part, _splice, _replace_number, _replace_number),
    *(_replace_word, _replace_word, _insert_word, _change_lines),
]
