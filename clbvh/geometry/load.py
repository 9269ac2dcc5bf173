"""A mesh file to a mesh: finds the format, reads it, and says what is wrong with it.

PLY, OBJ, STL and OFF have readers of their own, which keep the file's face order and digits and hold every count
against the file's size; scene graphs (glTF and what else trimesh knows) come through trimesh and are flattened here.
"""

from __future__ import annotations

import dataclasses
import itertools
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import MeshError
from .mesh import Mesh
from .obj import read_obj
from .off import KEYWORD as OFF_KEYWORD
from .off import read_off
from .ply import read_ply
from .stl import is_stl, read_stl

if TYPE_CHECKING:
    import trimesh

_READERS = {"ply": read_ply, "obj": read_obj, "off": read_off, "stl": read_stl}
_GLB_LENGTH = slice(8, 12)  # bytes of a GLB file that hold its size
_PRIMITIVE_SUFFIX_LENGTH = 7  # what trimesh appends to a node's name for each of several primitives
_SNIFF_BYTES = 1 << 16
_OBJ_VERTEX = re.compile(rb"^[ \t]*v[ \t]+[-+.\d]", re.MULTILINE)


def load_mesh(path: str | os.PathLike[str]) -> Mesh:
    """Load a mesh from a file.

    Parameters
    ----------
    path : str or path
        A PLY, OBJ, STL, OFF, GLB or glTF file, or another that trimesh reads. Its content decides about the format;
        its name only where the content leaves it open.

    Returns
    -------
    Mesh
        Faces in the file's order, polygons cut into triangles in place; nothing merged, degenerate triangles kept. A
        scene's parts follow each other, moved to where the scene has them.

    Raises
    ------
    MeshError
        The file is missing, cut off or not a mesh, has no faces, a face index that is no vertex, or a coordinate
        that is not finite.

    Notes
    -----
    An ASCII PLY file of 871,306 triangles (37 MB) takes about 0.25 s on two cores, the binary one 0.05 s.
    """
    file = Path(path)
    source = str(path)
    data = _read_bytes(file, source)
    file_format = _find_format(data, file.suffix.lower().lstrip("."))
    vertices: NDArray[np.floating]
    faces: NDArray[np.integer]
    if file_format in _READERS:
        vertices, faces = _READERS[file_format](data, source)
    else:
        vertices, faces = _read_with_trimesh(data, file, file_format, source)
    if len(faces) == 0:
        raise MeshError(
            f"{source}: the file has {len(vertices):,} vertices but no faces: rays need a surface, not a point cloud"
        )
    return dataclasses.replace(Mesh.from_arrays(vertices, faces, name=source), name=file.name)


def _read_bytes(file: Path, source: str) -> bytes:
    try:
        data = file.read_bytes()
    except FileNotFoundError as error:
        raise MeshError(f"{source}: no such file") from error
    except IsADirectoryError as error:
        raise MeshError(f"{source}: this is a folder, not a mesh file") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise MeshError(f"{source}: the file cannot be read: {reason}") from error
    if not data:
        raise MeshError(f"{source}: the file is empty")
    return data


def _find_format(data: bytes, suffix: str) -> str:
    """Return the name of the format: what the content says, or else what the file is called."""
    if re.match(rb"ply\s", data):
        return "ply"
    if data.startswith(b"glTF"):
        return "glb"
    if OFF_KEYWORD.match(data):
        return "off"
    if suffix not in _READERS and data.lstrip().startswith(b"{"):
        return "gltf"
    if is_stl(data):
        return "stl"
    if suffix != "obj" and (suffix in _READERS or not suffix) and _OBJ_VERTEX.search(data, 0, _SNIFF_BYTES):
        return "obj"
    return suffix


def _read_with_trimesh(
    data: bytes, file: Path, file_format: str, source: str
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read a scene graph and flatten it."""
    if file_format == "glb" and int.from_bytes(data[_GLB_LENGTH], "little") != len(data):
        raise MeshError(
            f"{source}: the file is cut off or damaged: its header declares "
            f"{int.from_bytes(data[_GLB_LENGTH], 'little'):,} bytes, but it has {len(data):,}"
        )
    # Imported here: it takes 0.3 s, and the formats above do without.
    import io

    import trimesh

    if file_format not in trimesh.exchange.load.mesh_formats():
        known = "PLY, OBJ, STL, OFF, GLB and glTF"
        raise MeshError(f"{source}: not a mesh file of a known kind: {known} are read")
    try:
        scene = trimesh.load_scene(
            io.BytesIO(data),
            file_type=file_format,
            resolver=trimesh.resolvers.FilePathResolver(str(file)),
            process=False,
            skip_materials=True,
        )
    except Exception as error:
        words = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise MeshError(f"{source}: the {file_format.upper()} file is damaged or incomplete ({words})") from error
    nodes = list(scene.graph.nodes_geometry)
    if file_format in ("glb", "gltf"):
        nodes = _restore_order(nodes, scene.graph.transforms.parents)
    return _flatten(scene, nodes, source)


def _restore_order(nodes: list[str], parents: dict[str, str]) -> list[str]:
    """Return glTF nodes in the order of the file.

    trimesh goes through siblings from the last to the first, but through the primitives of one node, which become
    nodes called after it, from the first to the last.
    """

    def find_owner(node: str) -> str:
        parent = parents.get(node, "")
        is_primitive = node.startswith(f"{parent}_") and len(node) == len(parent) + _PRIMITIVE_SUFFIX_LENGTH
        return parent if is_primitive else node

    blocks = [list(block) for _, block in itertools.groupby(nodes, key=find_owner)]
    return [node for block in reversed(blocks) for node in block]


def _flatten(scene: trimesh.Scene, nodes: list[str], source: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Move the parts of a scene to their places and put them one behind the other."""
    import trimesh

    all_vertices = [np.empty((0, 3))]
    all_faces = [np.empty((0, 3), dtype=np.int64)]
    vertex_count = face_count = 0
    for node in nodes:
        transform, name = scene.graph[node]
        part = scene.geometry[name]
        if not isinstance(part, trimesh.Trimesh):
            continue
        faces = np.asarray(part.faces, dtype=np.int64)
        # Checked here, because behind another part a wrong index would name a vertex of that one.
        wrong = (faces < 0) | (faces >= len(part.vertices))
        if wrong.any():
            row, corner = np.argwhere(wrong)[0]
            raise MeshError(
                f"{source}: face {face_count + row}, in part '{name}', refers to vertex {faces[row, corner]}, "
                f"but the part has {len(part.vertices)} vertices (0 to {len(part.vertices) - 1})"
            )
        # A mirror turns triangles inside out; their winding is turned back.
        if np.linalg.det(transform[:3, :3]) < 0:
            faces = faces[:, ::-1]
        with np.errstate(all="ignore"):  # what is not finite is found, and named, later
            all_vertices.append(part.vertices @ transform[:3, :3].T + transform[:3, 3])
        all_faces.append(faces + vertex_count)
        vertex_count += len(part.vertices)
        face_count += len(faces)
    return np.concatenate(all_vertices), np.concatenate(all_faces)
