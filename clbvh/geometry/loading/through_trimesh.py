"""STL, glTF and all other formats that trimesh reads, as one mesh.

Adds to trimesh that a file which was cut off is refused, and that a scene is flattened in the order of its file.
"""

from __future__ import annotations

import io
import itertools
import logging
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ..mesh import Mesh

_GLB_LENGTH = slice(8, 12)  # bytes of a GLB file that hold its size
_STL_COUNT = slice(80, 84)  # bytes of a binary STL file that hold the number of its triangles
_STL_TRIANGLE_BYTES = 50
_PRIMITIVE_SUFFIX_LENGTH = 7  # trimesh appends it to a node's name for each of several primitives


def read_through_trimesh(data: bytes, file: Path, file_format: str) -> tuple[NDArray[np.floating], NDArray[np.integer]]:
    """Return the vertices (V, 3) and faces (F, 3) of all parts of a file, concatenated."""
    declared_bytes = int.from_bytes(data[_GLB_LENGTH], "little")
    if file_format == "glb" and declared_bytes != len(data):
        raise MeshError(f"the file is cut off or damaged: it declares {declared_bytes:,} bytes, but has {len(data):,}")
    declared_count = _count_stl_triangles(data) if file_format == "stl" else None

    # Imported here: it takes 0.3 s, and most files do not need it.
    import trimesh

    if file_format not in trimesh.exchange.load.mesh_formats():
        raise MeshError("not a mesh file of a known kind: PLY, OBJ, STL, OFF, GLB and glTF are read")
    log = logging.getLogger("trimesh")
    level = log.level
    log.setLevel(logging.CRITICAL)  # it would print a traceback for a normal that is not a number
    try:
        scene = trimesh.load_scene(
            io.BytesIO(data),
            file_type=file_format,
            resolver=trimesh.resolvers.FilePathResolver(str(file)),
            process=False,
            skip_materials=True,
        )
    finally:
        log.setLevel(level)
    nodes = list(scene.graph.nodes_geometry)
    if file_format in ("glb", "gltf"):
        nodes = _restore_order(nodes, scene.graph.transforms.parents)

    vertices, faces = [], []
    for node in nodes:
        transform, name = scene.graph[node]
        part = scene.geometry[name]
        if isinstance(part, trimesh.Trimesh) and len(part.faces):
            # Checked here: once concatenated, a wrong index could refer to a vertex of another part.
            Mesh.from_arrays(part.vertices, part.faces, name=f"part '{name}'")
            part = part.copy().apply_transform(transform)  # flips the winding where it mirrors
            vertices.append(part.vertices)
            faces.append(part.faces)
    count = sum(map(len, faces))
    if declared_count not in (None, count):
        raise MeshError(f"the file is cut off or damaged: it has {declared_count:,} triangles, but {count:,} are whole")
    return trimesh.util.append_faces(vertices, faces)


def is_binary_stl(data: bytes) -> bool:
    """Return whether the size is the one that the header of a binary STL file would declare."""
    return len(data) == _STL_COUNT.stop + int.from_bytes(data[_STL_COUNT], "little") * _STL_TRIANGLE_BYTES


def _count_stl_triangles(data: bytes) -> int:
    """Return the number of triangles that an STL file declares."""
    count = int.from_bytes(data[_STL_COUNT], "little")
    if not is_binary_stl(data):
        count = len(re.findall(rb"\bfacet\s+normal\b", data, re.IGNORECASE))
        if count == 0:
            raise MeshError("the file is cut off or not an STL file: it has no facets, nor the size it declares")
    return count


def _restore_order(nodes: list[str], parents: dict[str, str]) -> list[str]:
    """Return glTF nodes in the order of the file.

    trimesh lists siblings from the last to the first, but the primitives of one node, which become nodes named after
    it, from the first to the last.
    """

    def find_owner(node: str) -> str:
        parent = parents.get(node, "")
        is_primitive = node.startswith(f"{parent}_") and len(node) == len(parent) + _PRIMITIVE_SUFFIX_LENGTH
        return parent if is_primitive else node

    blocks = [list(block) for _, block in itertools.groupby(nodes, key=find_owner)]
    return [node for block in reversed(blocks) for node in block]
