"""Mesh files that are written: vertices and faces, as PLY, OBJ or STL.

By ourselves, not by trimesh: its PLY has float32, in which survey coordinates lose half a metre, and its OBJ has 8
decimals, in which a mesh of 1e-9 is a point.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from ..support.files import as_path, write_atomically

_PLY_HEADER = """ply
format binary_little_endian 1.0
element vertex {}
property double x
property double y
property double z
element face {}
property list uchar int vertex_indices
end_header
"""
_PLY_FACE = np.dtype([("count", "u1"), ("vertices", "<i4", 3)])
_STL_FACE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_STL_HEADER_BYTES = 80


def write_mesh(
    path: str | os.PathLike[str],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    find_normals: Callable[[], NDArray[np.float64]],
) -> None:
    """Write a mesh file, whose format is that of its suffix; see `Mesh.save`."""
    target = as_path(path)
    write = _WRITERS.get(target.suffix.lower())
    if write is None:
        raise ConfigError(f"{target}: the name of a mesh file must end in {', '.join(_WRITERS)}")
    write_atomically(target, lambda file: write(file, vertices, faces, find_normals))


def _write_obj(file: BinaryIO, vertices: NDArray[np.float64], faces: NDArray[np.int32], _: object) -> None:
    # Python writes the fewest digits that name the number.
    file.writelines(f"v {x} {y} {z}\n".encode() for x, y, z in vertices.tolist())
    file.writelines(f"f {a} {b} {c}\n".encode() for a, b, c in (faces + 1).tolist())


def _write_ply(file: BinaryIO, vertices: NDArray[np.float64], faces: NDArray[np.int32], _: object) -> None:
    file.write(_PLY_HEADER.format(len(vertices), len(faces)).encode())
    file.write(vertices.astype("<f8").data)
    rows = np.empty(len(faces), _PLY_FACE)
    rows["count"], rows["vertices"] = 3, faces
    file.write(rows.data)


def _write_stl(
    file: BinaryIO,
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    find_normals: Callable[[], NDArray[np.float64]],
) -> None:
    rows = np.zeros(len(faces), _STL_FACE)
    rows["normal"], rows["corners"] = find_normals(), vertices[faces]
    file.write(bytes(_STL_HEADER_BYTES) + len(faces).to_bytes(4, "little"))
    file.write(rows.data)


_WRITERS = {".obj": _write_obj, ".ply": _write_ply, ".stl": _write_stl}
