"""Mesh files that are written: vertices, faces and their looks, as PLY, OBJ or STL.

By ourselves, not by trimesh: its PLY has float32, in which survey coordinates lose half a metre, and its OBJ has 8
decimals, in which a mesh of 1e-9 is a point.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from typing import Any, BinaryIO, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import AppearanceWarning
from ..support.files import check_target, write_atomically
from .appearance.appearance import Appearance
from .appearance.material import OPAQUE, Material
from .write_points import write_ply

# A `Mesh`, whose module imports this one.
Mesh: TypeAlias = Any

_STL_FACE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_STL_HEADER_BYTES = 80
_MAX_BYTE = 255

# Materials that tint no colours.
_PLAIN = (Material(), Material(base_colour=(1.0, 1.0, 1.0)))


def write_mesh(path: str | os.PathLike[str], mesh: Mesh) -> None:
    """Write a mesh file, whose format is that of its suffix; see `Mesh.save`."""
    target = check_target(path, "a mesh file", _WRITERS)
    write = _WRITERS[target.suffix.lower()]
    lost: list[str] = []
    if any(material not in _PLAIN for material in _looks_of(mesh).materials):
        lost.append("materials")
    write_atomically(target, lambda file: write(file, mesh, lost))
    if lost:
        text = f"{target}: the file does not keep {' and '.join(lost)}: clbvh.Scene(mesh).save(...) does"
        warnings.warn(text, AppearanceWarning, stacklevel=3)  # where `Mesh.save` was called


def _looks_of(mesh: Mesh) -> Appearance:
    return mesh.appearance or Appearance()


def _at_vertices(mesh: Mesh, values: NDArray[Any] | None) -> NDArray[Any] | None:
    """Return values of corners, (F, 3, k), as those of vertices, (V, k); None where a vertex has several, or none."""
    if values is None:
        return None
    of_vertices = np.zeros((len(mesh.vertices), values.shape[2]), values.dtype)
    of_vertices[mesh.faces] = values
    return of_vertices if (of_vertices[mesh.faces] == values).all() else None


def _write_ply(file: BinaryIO, mesh: Mesh, lost: list[str]) -> None:
    looks = _looks_of(mesh)
    vertex: dict[str, NDArray[Any]] = dict(zip("xyz", mesh.vertices.T, strict=True))
    face: dict[str, NDArray[Any]] = {"vertex_indices": mesh.faces.astype(np.int32)}
    if (normals := _at_vertices(mesh, looks.normals)) is not None:
        vertex |= zip(("nx", "ny", "nz"), normals.T, strict=True)
    elif looks.normals is not None:
        lost.append("normals that differ at a vertex")
    if looks.colours is not None:
        channels = ("red", "green", "blue", "alpha")
        if (colours := _at_vertices(mesh, looks.colours)) is not None:
            vertex |= zip(channels, colours.T, strict=True)
        elif (looks.colours == looks.colours[:, :1]).all():
            face |= zip(channels, looks.colours[:, 0].T, strict=True)
        else:
            lost.append("colours that differ at a vertex and within a face")
    if looks.uvs is not None:
        face["texcoord"] = looks.uvs.reshape(-1, 6)
    if mesh.parts:
        lost.append("parts")
    write_ply(file, {"vertex": vertex, "face": face})


def _write_obj(file: BinaryIO, mesh: Mesh, lost: list[str]) -> None:
    looks, rows = _looks_of(mesh), mesh.vertices
    colours = _at_vertices(mesh, looks.colours)
    if colours is not None:
        rows = np.concatenate((rows, colours[:, :3] / _MAX_BYTE), axis=1)
    elif looks.colours is not None:
        lost.append("colours that differ at a vertex")
    if looks.colours is not None and (looks.colours[..., 3] != OPAQUE).any():
        lost.append("alpha")
    # Python writes the fewest digits that name the number.
    file.writelines(f"v {' '.join(map(repr, row))}\n".encode() for row in rows.tolist())
    ids = [(mesh.faces + 1).astype(object)]
    for keyword, values in (("vt", looks.uvs), ("vn", looks.normals)):
        if values is None:
            ids.append(np.full(mesh.faces.shape, ""))
            continue
        different, numbers = np.unique(values.reshape(-1, values.shape[2]), axis=0, return_inverse=True)
        file.writelines(f"{keyword} {' '.join(map(str, row))}\n".encode() for row in different.tolist())
        ids.append((numbers.reshape(mesh.faces.shape) + 1).astype(object))
    has_more = looks.uvs is not None or looks.normals is not None
    corners = np.stack(ids, axis=-1).tolist()
    begins = {part.begin: part.name for part in mesh.parts}
    for face, (a, b, c) in enumerate(corners):
        if face in begins:
            file.write(f"o {begins[face]}\n".encode())
        words = ("/".join(map(str, corner if has_more else corner[:1])) for corner in (a, b, c))
        file.write(f"f {' '.join(words)}\n".encode())


def _write_stl(file: BinaryIO, mesh: Mesh, lost: list[str]) -> None:
    looks = _looks_of(mesh)
    lost += [name for name in ("normals", "colours") if getattr(looks, name) is not None]
    lost += ["texture coordinates"] * (looks.uvs is not None) + ["parts"] * bool(mesh.parts)
    rows = np.zeros(len(mesh.faces), _STL_FACE)
    rows["normal"], rows["corners"] = mesh.face_normals, mesh.vertices[mesh.faces]
    file.write(bytes(_STL_HEADER_BYTES) + len(mesh.faces).to_bytes(4, "little"))
    file.write(rows.data)


_WRITERS: dict[str, Callable[[BinaryIO, Mesh, list[str]], None]] = {
    ".obj": _write_obj,
    ".ply": _write_ply,
    ".stl": _write_stl,
}
