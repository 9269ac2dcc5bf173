"""NPZ archives of numpy, member by member. Their sizes are not trusted, and no object is unpickled."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, BinaryIO
from zipfile import ZIP_STORED, ZipFile

import numpy as np
from numpy.typing import NDArray

from ..errors import MeshError
from .files import open_regular

_NAME_AT = 30  # bytes before the name of the first member

# Readers of an array's header, by the version of numpy's format.
_HEADER_READERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def begins_with_member(path: str | os.PathLike[str], name: str) -> bool:
    """Return whether a file is an archive whose first array has this name; False if it cannot be read."""
    expected = f"{name}.npy".encode()
    try:
        with open_regular(Path(path)) as file:
            head = file.read(_NAME_AT + len(expected))
    except (OSError, ValueError):
        return False
    return head.startswith(b"PK\3\4") and head[_NAME_AT:] == expected


def read_member(archive: ZipFile, name: str) -> NDArray[Any]:
    """Return an array of numbers; its size is that of the archive's directory, not that of its header."""
    with archive.open(f"{name}.npy") as file:
        shape, is_fortran, dtype = _HEADER_READERS[np.lib.format.read_magic(file)](file)
        if dtype.kind not in "iuf":
            raise MeshError(f"{name} must be numbers, not {dtype}")
        values = np.frombuffer(file.read(), dtype)
    if values.size != math.prod(shape):
        raise MeshError(f"{name} has {values.size:,} numbers instead of {math.prod(shape):,}: the archive is cut off")
    return values.reshape(shape, order="F" if is_fortran else "C")


def read_members(file: BinaryIO) -> dict[str, NDArray[Any]]:
    """Return all arrays of an archive that `numpy.savez` wrote, without compression: no more bytes than the file has.

    Raises
    ------
    MeshError
        It is compressed, arrays share bytes, or one has no numbers. Damage raises what `zipfile` and numpy do.
    """
    size = os.fstat(file.fileno()).st_size
    with ZipFile(file) as archive:
        members = archive.infolist()
        is_packed = any(member.compress_type != ZIP_STORED for member in members)
        if is_packed or sum(member.file_size for member in members) > size:
            raise MeshError("its arrays are packed, or larger than the file")
        names = [member.filename.removesuffix(".npy") for member in members]
        return {name: read_member(archive, name) for name in names}
