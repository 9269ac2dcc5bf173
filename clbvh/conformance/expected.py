"""The stored answers: a digest for each part of an answer, and a short mark for each row, which finds a difference."""

from __future__ import annotations

import base64
import hashlib
import zlib
from collections.abc import Iterable
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from ..errors import InternalError
from .cases import Case

EXPECTED_PATH = Path(__file__).with_name("expected.json")

_DIGEST_BYTES = 16

# The form of each kind of number in which it is digested, whatever the machine's own is.
_STORED_DTYPES = {"b": "u1", "i": "<i4", "u": "u1", "f": "<f8"}


class Expected(Struct, frozen=True):
    """What is stored of one part of an answer.

    Attributes
    ----------
    digest : str
        Hexadecimal BLAKE2 of all its bytes: 128 bits.
    marks : str
        One byte of each row's CRC-32, in base64. One different row in 256 has the same mark.
    """

    digest: str
    marks: str

    @classmethod
    def of(cls, values: NDArray) -> Expected:
        """Return what would be stored of a part."""
        rows = np.ascontiguousarray(values, _STORED_DTYPES[values.dtype.kind])
        if rows.dtype.kind == "f":
            # A driver may give a zero either sign: llvmpipe subtracts from zero to negate.
            rows = rows + 0.0
        marks = bytes(zlib.crc32(row.tobytes()) & 0xFF for row in rows)
        digest = hashlib.blake2b(f"{rows.shape}".encode() + rows.tobytes(), digest_size=_DIGEST_BYTES)
        return cls(digest.hexdigest(), base64.b64encode(marks).decode())

    def find_difference(self, values: NDArray) -> int | None:
        """Return None if a part is equal, else the first row that differs, or -1 if no mark tells which."""
        given = Expected.of(values)
        if given.digest == self.digest:
            return None
        pairs = zip(base64.b64decode(self.marks), base64.b64decode(given.marks), strict=False)
        return next((row for row, (wanted, mark) in enumerate(pairs) if wanted != mark), -1)


# By case, query and part.
ExpectedAnswers = dict[str, dict[str, dict[str, Expected]]]


class _Stored(Struct):
    """The stored file: the digests of the cases by name, and the answers."""

    cases: dict[str, str]
    answers: ExpectedAnswers


def digest_of(case: Case) -> str:
    """Return the digest of a case's mesh, rays and points: answers compare only where these are equal."""
    digest = hashlib.blake2b(np.ascontiguousarray(case.faces, "<i8").tobytes(), digest_size=_DIGEST_BYTES)
    for values in (case.vertices, *case.rays, case.points):
        digest.update(np.ascontiguousarray(values, "<f8").tobytes())
    return digest.hexdigest()


def load_expected() -> tuple[dict[str, str], ExpectedAnswers]:
    """Return the digests of the cases by name, and the stored answers.

    Raises
    ------
    InternalError
        The stored file is missing or damaged.
    """
    try:
        stored = msgspec.json.decode(EXPECTED_PATH.read_bytes(), type=_Stored)
    except (OSError, msgspec.DecodeError) as error:
        raise InternalError(f"{EXPECTED_PATH}: the stored answers cannot be read ({error}): reinstall clbvh") from error
    return stored.cases, stored.answers


def store_expected(cases: Iterable[Case], answers: ExpectedAnswers) -> None:
    """Replace the stored answers."""
    stored = msgspec.json.encode(_Stored({case.name: digest_of(case) for case in cases}, answers))
    EXPECTED_PATH.write_bytes(msgspec.json.format(stored, indent=1) + b"\n")
