"""Tables of points that are written: binary PLY files, and LAS files by the optional library laspy."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from ..support.files import check_target, write_atomically

_TYPES = {"f8": "double", "f4": "float", "i4": "int", "u4": "uint", "u1": "uchar", "u2": "ushort"}

# A coordinate of LAS is a 32-bit number of these steps from the least one.
_LAS_STEPS = 2**30

POINT_SUFFIXES = (".ply", ".las", ".laz")


def write_points(path: str | os.PathLike[str], columns: Mapping[str, NDArray[Any]]) -> None:
    """Write points to a ``.ply``, ``.las`` or ``.laz`` file; see `Hits.save`.

    Parameters
    ----------
    columns : mapping of str to (n,) array
        x, y and z, and more values of each point.
    """
    target = check_target(path, "a file of points", POINT_SUFFIXES)
    suffix = target.suffix.lower()
    if suffix == ".ply":
        write_atomically(target, lambda file: write_ply(file, {"vertex": columns}))
    else:
        las, is_compressed = _make_las(columns), suffix == ".laz"
        if is_compressed:
            from laspy import LazBackend

            if not LazBackend.detect_available():
                raise ConfigError("LAZ files need lazrs: run 'pip install \"clbvh[formats]\"', or write a .las file")
        write_atomically(target, lambda file: las.write(file, do_compress=is_compressed))


def write_ply(file: BinaryIO, elements: Mapping[str, Mapping[str, NDArray[Any]]]) -> None:
    """Write a binary PLY file of elements by name, each of columns of one length by name.

    A column of numbers is a property of their type, and one of (n, k) numbers a list of k of them.
    """
    lines, tables = ["ply", "format binary_little_endian 1.0"], []
    for element, columns in elements.items():
        lines.append(f"element {element} {len(next(iter(columns.values())))}")
        fields: list[Any] = []
        for name, values in columns.items():
            dtype, kind = values.dtype.newbyteorder("<"), _TYPES[values.dtype.str[1:]]
            if values.ndim == 1:
                lines.append(f"property {kind} {name}")
                fields.append((name, dtype))
            else:
                lines.append(f"property list uchar {kind} {name}")
                fields += [(f"{name} count", "u1"), (name, dtype, values.shape[1:])]
        table = np.empty(len(values), fields)
        for name, values in columns.items():
            table[name] = values
            if values.ndim > 1:
                table[f"{name} count"] = values.shape[1]
        tables.append(table)
    file.write("\n".join([*lines, "end_header", ""]).encode())
    for table in tables:
        file.write(table.data)


def _make_las(columns: Mapping[str, NDArray[Any]]) -> Any:
    """Return the points as laspy has them: a coordinate is rounded to 2^-30 of the largest side of their box."""
    try:
        import laspy
    except ImportError as error:
        raise ConfigError(f"LAS files need laspy: run 'pip install \"clbvh[formats]\"' ({error})") from error
    header = laspy.LasHeader(point_format=6, version="1.4")
    points = np.stack([columns[axis] for axis in "xyz"], axis=1)
    if len(points):
        header.offsets = points.min(axis=0)
        header.scales = np.full(3, max(float(np.ptp(points, axis=0).max()) / _LAS_STEPS, np.finfo(float).tiny))
    more = {name: values for name, values in columns.items() if name not in "xyz"}
    header.add_extra_dims([laspy.ExtraBytesParams(name, values.dtype) for name, values in more.items()])
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    for name, values in more.items():
        las[name] = values
    return las
