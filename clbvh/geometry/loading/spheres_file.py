"""Files of spheres: NPZ archives of numpy, and CSV tables.

Owns the two formats. An archive is read member by member, with sizes checked before memory is taken; pickled objects
are never unpacked. What the numbers may be, `Spheres` checks.
"""

from __future__ import annotations

import io
import os
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ...support.archive import read_member
from ...support.files import read_errors_as, read_regular
from ...support.memory import check_memory
from .file_mesh import decode_text

SPHERES_SUFFIXES = (".npz", ".csv")

_CENTRES, _RADII = "centres", "radii"
_WITH_RADII = 4  # columns of a table: x, y, z, radius

# A line of text takes this many bytes at least ("1,2,3" and its end); of that and its floats while it is parsed.
_LEAST_LINE_BYTES = 6
_BYTES_PER_LINE = 100


def read_spheres(path: str | os.PathLike[str]) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Read the centres and the radii of spheres.

    Parameters
    ----------
    path : str or path
        An NPZ archive with the arrays ``centres`` (n, 3) and ``radii`` (n,), or a CSV table of x, y, z and radius.
        Lines that begin with ``#`` are skipped, and so is the first line if it has names instead of numbers. The radii
        may be left out.

    Returns
    -------
    centres : (n, 3) float64
    radii : (n,) float64, or None
        None where the file has none.

    Raises
    ------
    MeshError
        The file is missing, not a regular one, of another kind, damaged, or needs more memory than is free.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix not in SPHERES_SUFFIXES:
        raise MeshError(f"{path}: the name of a file of spheres must end in {' or '.join(SPHERES_SUFFIXES)}")
    with read_errors_as(MeshError, path):
        data = read_regular(file)
    try:
        return _read_archive(data) if suffix == ".npz" else _read_table(data)
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from error
    except Exception as error:  # damage that the libraries report in their own ways
        raise MeshError(f"{path}: the file of spheres is damaged or cut off") from error


def _read_archive(data: bytes) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    if not data:
        raise MeshError("the file is empty")
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = archive.namelist()
        if f"{_CENTRES}.npy" not in names:
            raise MeshError(f"the archive has no array '{_CENTRES}'")
        centres = _read_numbers(archive, _CENTRES)
        radii = _read_numbers(archive, _RADII) if f"{_RADII}.npy" in names else None
    if centres.ndim != 2 or centres.shape[1] != 3:
        raise MeshError(f"{_CENTRES} must have shape (n, 3), not {centres.shape}")
    if radii is not None and radii.shape != centres.shape[:1]:
        raise MeshError(f"{_RADII} must have shape ({len(centres)},), one for each centre, not {radii.shape}")
    return centres, radii


def _read_numbers(archive: zipfile.ZipFile, name: str) -> NDArray[np.float64]:
    check_memory("a file of spheres", 3 * archive.getinfo(f"{name}.npy").file_size, MeshError)
    with np.errstate(over="ignore", invalid="ignore"):  # a wider dtype, a signalling NaN: refused by the spheres
        return read_member(archive, name).astype(np.float64, order="C")


def _read_table(data: bytes) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    check_memory("a file of spheres", len(data) // _LEAST_LINE_BYTES * _BYTES_PER_LINE, MeshError)
    lines = [line for line in decode_text(data).decode().splitlines() if line.strip() and not line.startswith("#")]
    if lines and not _are_numbers(lines[0]):
        del lines[0]
    if not lines:
        raise MeshError("the table has no spheres")
    columns = lines[0].count(",") + 1
    if columns not in (_WITH_RADII - 1, _WITH_RADII):
        raise MeshError(f"a line of the table must be x, y, z and a radius, not '{lines[0][:40]}'")
    for number, line in enumerate(lines):
        if line.count(",") + 1 != columns:
            raise MeshError(f"sphere {number} must have {columns} numbers like the first one, not '{line[:40]}'")
        if not _are_numbers(line):
            raise MeshError(f"sphere {number} must be {columns} numbers, not '{line[:40]}'")
    values = np.loadtxt(lines, np.float64, delimiter=",", comments=None, ndmin=2)
    return np.ascontiguousarray(values[:, :3]), values[:, 3].copy() if columns == _WITH_RADII else None


def _are_numbers(line: str) -> bool:
    try:
        return bool([float(word) for word in line.split(",")])
    except ValueError:
        return False
