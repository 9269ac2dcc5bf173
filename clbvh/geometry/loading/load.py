"""The public loader: recognises the format of a file, calls its reader, and completes error messages.

Owns the table of readers. The readers get bytes and return vertices and faces as the file has them.
"""

from __future__ import annotations

import dataclasses
import importlib
import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...errors import MeshError
from ...support.files import read_errors_as, read_regular
from ..mesh import Mesh
from ..smooth_normals import flatten
from .file_mesh import OFF_KEYWORD, FileMesh, PointCloudError, Problems, decode_text, find_stl_end, has_stl_triangles
from .file_parts import Parts, Placed, join_few, join_nodes, split_parts
from .trimesh import PACKAGES

# The module of each format's reader; it is imported by the first file of its kind.
_READERS = {"ply": "ply", "obj": "obj", "off": "off", "stl": "stl", "glb": "gltf", "gltf": "gltf"}
_READERS |= dict.fromkeys(PACKAGES, "trimesh")
# The first bytes of a file of each format.
_BEGINNINGS = {
    "ply": re.compile(rb"ply\s"),
    "glb": re.compile(rb"glTF"),
    "gltf": re.compile(rb"\s*\{"),
    "off": OFF_KEYWORD,
    "stl": re.compile(rb"\s*solid\s", re.IGNORECASE),
    "obj": re.compile(rb"\s*(?:#[^\n]*\n\s*)*(?:mtllib|usemtl|o|g|s|v|vn|vt)[ \t]"),
}


def load_mesh(path: str | os.PathLike[str]) -> Mesh:
    """Load a mesh from a file.

    Parameters
    ----------
    path : str or path
        A PLY, OBJ, STL, OFF, GLB or glTF file. The format is recognised by the content; by the name only where the
        content leaves it open. A 3MF, DAE, ZAE, 3DXML, XAML or STEP file is read by trimesh, which needs other
        packages for it; the message names them.

    Returns
    -------
    Mesh
        Faces in the file's order. Polygons are cut into fans around their first corners, and concave ones that a fan
        would reach out of into ears. Nothing is merged, except corners of an STL file whose coordinates are equal bit
        for bit, and degenerate triangles are kept. Normals, texture coordinates, colours, materials and textures become
        its `appearance`.

        A file of several parts is one mesh whose `parts` name them. Those of a GLB or glTF file are the nodes with
        triangles, in the order of the nodes and moved to their positions in the scene, however often they place a mesh,
        without those that a scale of 0 hides; where a node's matrix mirrors, corners are listed backwards, so that
        fronts stay fronts. Those of an OBJ file are its objects (`o`), or its groups (`g`) if no object is named; one
        that is continued further below is a part there once more.

    Warns
    -----
    AppearanceWarning
        Some of the looks cannot be used: a texture is missing, for example. Or something is left out: numbers or bytes
        that the file has beyond what it declares, faces with fewer than three corners.

    Raises
    ------
    MeshError
        The file is missing, not a regular one, cut off or not a mesh, needs more memory than is free, uses something
        that is not read, has no faces, a face index without a vertex, or a coordinate that is not finite.

    Notes
    -----
    On two x86-64 cores, 871,306 triangles take 0.4 s from an ASCII PLY file, 0.05 s from a binary one, 0.5 s from
    binary STL, 1 s from OFF and 1.7 s from OBJ. Looks add up to 0.1 s, but 1.1 s for OBJ.

    Examples
    --------
    >>> import tempfile
    >>> import clbvh
    >>> import trimesh
    >>> from pathlib import Path
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = Path(folder.name, "box.stl")
    >>> _ = trimesh.creation.box().export(path)
    >>> mesh = clbvh.load_mesh(path)
    >>> mesh.face_count, len(mesh.vertices)
    (12, 8)
    >>> folder.cleanup()
    """
    return _load(path, join_nodes).shapes[0]


def load_parts(path: str | os.PathLike[str]) -> Parts[Mesh]:
    """Load the parts of a file as meshes of their own, with their names and places.

    Parameters
    ----------
    path : str or path
        See `load_mesh`. GLB and glTF files have a mesh for each of theirs, and a node for each of the scene's;
        OBJ files have a mesh for each object, or for each group if no object is named. Other files are one mesh.

    Returns
    -------
    Parts of Mesh
        Without the parts that have no faces. What the nodes make of the meshes is what `load_mesh` reads, but for
        vertices that no face of a part refers to, which are left out. A mesh without a name has the file's, with its
        suffix; its node has it without.

    Raises
    ------
    MeshError
        See `load_mesh`.
    """
    return _load(path, split_parts)


def load_placed(path: str | os.PathLike[str]) -> Parts[Mesh]:
    """Load a file as a scene of it is best made.

    Returns
    -------
    Parts of Mesh
        The mesh that `load_mesh` reads, in its place; but what `load_parts` reads where the nodes of a GLB or glTF file
        place more than twice the triangles that its meshes have.

    Raises
    ------
    MeshError
        See `load_mesh`.
    """
    return _load(path, join_few)


# What is made of the meshes that a reader returns: one mesh, or several and their nodes.
_Arrange = Callable[[FileMesh | Parts[FileMesh]], FileMesh | Parts[FileMesh]]


def _load(path: str | os.PathLike[str], arrange: _Arrange) -> Parts[Mesh]:
    """Load a file; every error becomes a `MeshError` that names it."""
    try:
        file, source = Path(path), str(path)
    except TypeError as error:
        raise MeshError(f"a mesh file is named by a str or a path, not by {path!r}") from error
    try:
        return _make_parts(file, source, _read(file, source, arrange))
    except MemoryError as error:
        raise MeshError(f"{source}: there is not enough free memory to read the file") from error


def _read(file: Path, source: str, arrange: _Arrange) -> Parts[FileMesh]:
    """Return what the reader of the file's format has read; looks that cannot be used become one warning."""
    with read_errors_as(MeshError, source):
        data = read_regular(file)
    if not data or data.isspace():
        raise MeshError(f"{source}: the file is empty")
    try:
        data = data if len(data) == find_stl_end(data) else decode_text(data)
    except MeshError as error:
        raise MeshError(f"{source}: {error}") from error
    file_format = _find_format(data, file.suffix.lower().lstrip("."))
    if file_format not in _READERS:
        raise MeshError(
            f"{source}: not a mesh file of a known kind: PLY, OBJ, STL, OFF, GLB and glTF are read, and by trimesh "
            f"3MF, DAE and STEP; of others give what trimesh.load, meshio.read or pyvista.read returns"
        )
    problems = Problems()
    try:
        name = _READERS[file_format]
        reader = getattr(importlib.import_module(f".{name}", __package__), f"read_{name}")
        read = arrange(reader(data, file, problems))
    except MeshError as error:
        raise MeshError(f"{source}: {error}") from error
    except MemoryError:
        raise
    except Exception as error:  # numbers that are none, and other damage that no reader looks for
        raise MeshError(f"{source}: the {file_format.upper()} file is damaged or incomplete") from error
    problems.warn(source)
    return Parts([read], [Placed("", 0, np.eye(4))]) if isinstance(read, FileMesh) else read


def _find_format(data: bytes, suffix: str) -> str:
    """Return the name of the format, by the content or else by the suffix."""
    if len(data) == find_stl_end(data):
        return "stl"
    content = next((name for name, beginning in _BEGINNINGS.items() if beginning.match(data)), "")
    return content or ("stl" if suffix not in _READERS and has_stl_triangles(data) else suffix)


def _make_parts(file: Path, source: str, read: Parts[FileMesh]) -> Parts[Mesh]:
    """Return the meshes that have faces, and their nodes."""
    if not any(len(read.shapes[node.shape].faces) for node in read.placed):
        clouds = [mesh for mesh in read.shapes if len(mesh.vertices)]
        if not clouds:
            raise MeshError(f"{source}: the file has no triangles")
        error = PointCloudError(
            f"{source}: the file has {sum(len(mesh.vertices) for mesh in clouds):,} vertices but no faces: a point "
            "cloud, which clbvh.Scene takes as spheres"
        )
        error.cloud = clouds[0]
        raise error
    loaded: Parts[Mesh] = Parts([], [])
    numbers: dict[int, int] = {}
    stem = file.stem or file.name
    for number, mesh in enumerate(read.shapes):
        if len(mesh.faces):
            numbers[number] = len(numbers)
            name = mesh.name.strip() or file.name
            where = f"{source}: {name}" if len(read.shapes) > 1 else source
            loaded.shapes.append(_make_mesh(mesh, where, name, stem))
    for name, number, matrix, _ in read.placed:
        if number in numbers:
            label = name.strip() or read.shapes[number].name.strip() or stem
            loaded.placed.append(Placed(label, numbers[number], matrix))
    return loaded


def _make_mesh(read: FileMesh, source: str, name: str, stem: str) -> Mesh:
    # Names that can be printed.
    parts = [(part.strip().encode("utf-8", "replace").decode() or stem, begin, end) for part, begin, end in read.parts]
    mesh = Mesh.from_arrays(
        read.vertices, read.faces, name=source, appearance=read.appearance, parts=parts if len(parts) > 1 else ()
    )
    appearance = mesh.appearance if read.flat_faces is None else flatten(mesh, read.flat_faces)
    return dataclasses.replace(mesh, name=name, appearance=appearance)
