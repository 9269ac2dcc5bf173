"""glTF 2.0, as text and as GLB: the meshes of the scene, and the nodes that place them.

Owns nodes, meshes and primitives. Cameras, lights and animations are skipped: joints stand as their nodes do. Of morph
targets the base shape is read. No library is used for it: trimesh ignores compression, sparse accessors and normalised
integers, and leaves out triangle fans, all without a word.

Khronos Group, "glTF 2.0 Specification", 2021: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ..local_frame import rotation_matrix
from ..mesh import check_face_count
from .file_mesh import FileMesh, Problems
from .file_parts import POINT, Parts, Piece, Placed, drop_loose_vertices, find_hidden, join_pieces
from .gltf_data import GltfData, get_list, get_object, refuse_compression
from .gltf_looks import GltfLooks
from .gltf_skins import Skin, pose_piece, read_skin
from .polygons import cut_fans

_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_MODE_COUNT = 7  # the modes below are points and lines

# Extensions that a file may require without any effect on its triangles.
_HARMLESS = re.compile(
    r"KHR_(mesh_quantization|node_visibility)|"
    r"[A-Z]+_(materials?|textures?|lights?|techniques|environments?|xmp|animation|audio)_\w+"
)
_COMPRESSIONS = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
_DRACO = _COMPRESSIONS[0]
_INSTANCING, _VISIBILITY = "EXT_mesh_gpu_instancing", "KHR_node_visibility"

# Rounding of writers that is no projection, in the last row of a matrix.
_AFFINE_TOLERANCE = 1e-6


def read_gltf(data: bytes, file: Path, problems: Problems) -> Parts[FileMesh]:
    """Return the meshes of the scene, each once, and the nodes that place them, in the order of the nodes.

    The primitives of a mesh follow each other. Of a list of points that meshes share, each has those that its faces
    refer to.
    """
    gltf = GltfData(data, file)
    _check_extensions(gltf)
    nodes = list(_walk_nodes(gltf))
    matrices = {node.number: node.matrix for node in nodes}
    drawn = [node for node in nodes if node.mesh is not None]
    # Where skins are, their joints decide.
    hidden = find_hidden([np.eye(4) if node.skin is not None else node.matrix for node in drawn])
    shown = [node for node, is_hidden in zip(drawn, hidden, strict=True) if not (is_hidden or node.is_hidden)]
    if drawn and not shown:
        return Parts([FileMesh("", *POINT)], [Placed(drawn[0].name, 0, np.eye(4))])
    sources = dict.fromkeys((node.mesh, node.skin) for node in shown)
    face_count, users = _count_faces_and_users(gltf, (mesh for mesh, _ in sources))
    check_face_count(face_count, sum(map(gltf.count_items, users)))
    numbers: dict[tuple[Any, Any], int] = {}
    parts: Parts[FileMesh] = Parts([], [])
    points: dict[int, NDArray[np.float64]] = {}
    reader = GltfLooks(gltf, problems)
    for node in shown:
        mesh_name = _read_name(gltf.item("meshes", node.mesh))
        source = node.mesh, node.skin
        if source not in numbers:
            numbers[source] = len(numbers)
            skin = None if node.skin is None else read_skin(gltf, node.skin, node.matrix, matrices)
            pieces = list(_read_primitives(gltf, node.mesh, points, reader, skin))
            mesh = join_pieces(mesh_name or node.name, pieces)
            is_shared = any(users[positions] > 1 for _, _, positions, _, _ in _triangle_primitives(gltf, node.mesh))
            parts.shapes.append(drop_loose_vertices(mesh) if is_shared else mesh)
        matrix = np.eye(4)
        if node.skin is None:
            matrix[:3] = node.matrix[:3]  # `_read_matrix` has seen that the last row is almost that
        parts.placed.append(Placed(node.name or mesh_name, numbers[source], matrix))
    return parts


class _Node(NamedTuple):
    """A node of the scene, the indices of its mesh and skin, and its matrix from its own coordinates to the scene's."""

    number: int
    name: str
    mesh: Any
    skin: Any
    matrix: NDArray[np.float64]
    is_hidden: bool


def _read_name(item: dict[str, Any]) -> str:
    name = item.get("name")
    return name if isinstance(name, str) else ""


def _check_extensions(gltf: GltfData) -> None:
    for name in get_list(gltf.document, "extensionsRequired"):
        if name in _COMPRESSIONS:
            raise refuse_compression(name)
        if not isinstance(name, str) or not _HARMLESS.fullmatch(name):
            raise MeshError(f"the file requires the glTF extension {str(name)[:80]!r}, which is not read")


def _walk_nodes(gltf: GltfData) -> Iterator[_Node]:
    """Yield the nodes of the scene, depth first; each node is visited once."""
    nodes = get_list(gltf.document, "nodes")
    if not nodes and not get_list(gltf.document, "scenes"):
        # A file without a scene is a library of meshes.
        for number in range(len(get_list(gltf.document, "meshes"))):
            yield _Node(-1, "", number, None, np.eye(4), False)
    is_visited = np.zeros(len(nodes), np.bool_)
    stack = [(root, np.eye(4), False) for root in reversed(_find_roots(gltf))]
    while stack:
        index, parent, is_hidden = stack.pop()
        node = gltf.item("nodes", index)
        if is_visited[index]:
            raise MeshError(f"nodes[{index}] has two parents or is one of its own, but the nodes of glTF are trees")
        is_visited[index] = True
        extensions = get_object(node, "extensions")
        if _INSTANCING in extensions:
            raise MeshError(f"nodes[{index}] is drawn many times by {_INSTANCING}, which is not read")
        is_hidden = is_hidden or get_object(extensions, _VISIBILITY).get("visible", True) is False
        with np.errstate(over="ignore", invalid="ignore"):  # coordinates that are not finite are refused later
            matrix = parent @ _read_matrix(node, index)
        mesh, skin = (node.get(key) for key in ("mesh", "skin"))
        for kind, other in (("meshes", mesh), ("skins", skin)):
            if other is not None:
                gltf.item(kind, other)
        yield _Node(index, _read_name(node), mesh, skin, matrix, is_hidden)
        stack += [(child, matrix, is_hidden) for child in reversed(get_list(node, "children"))]


def _find_roots(gltf: GltfData) -> list[Any]:
    """Return the top nodes of the scene: the default one, or the first; without scenes, all nodes without a parent."""
    if get_list(gltf.document, "scenes"):
        return get_list(gltf.item("scenes", gltf.document.get("scene", 0)), "nodes")
    count = len(get_list(gltf.document, "nodes"))
    nodes = [gltf.item("nodes", index) for index in range(count)]
    children = {child for node in nodes for child in get_list(node, "children") if isinstance(child, int)}
    return [index for index in range(count) if index not in children]


def _read_matrix(node: dict[str, Any], index: int) -> NDArray[np.float64]:
    """Return the (4, 4) transform of a node relative to its parent."""
    matrix = np.eye(4)
    if "matrix" in node:
        matrix = _read_vector(node, "matrix", np.eye(4).ravel()).reshape(4, 4).T  # column by column
        if not np.allclose(matrix[3], (0, 0, 0, 1), rtol=0, atol=_AFFINE_TOLERANCE):
            raise MeshError(f"nodes[{index}] has a matrix that is no affine transform")
        return matrix
    rotation = _read_vector(node, "rotation", np.array([0.0, 0.0, 0.0, 1.0]))
    length = float(np.hypot.reduce(rotation))
    if length == 0:
        raise MeshError(f"nodes[{index}] has a rotation of length 0")
    x, y, z, w = rotation / length
    matrix[:3, :3] = rotation_matrix(x, y, z, w) * _read_vector(node, "scale", np.ones(3))
    matrix[:3, 3] = _read_vector(node, "translation", np.zeros(3))
    return matrix


def _read_vector(node: dict[str, Any], key: str, default: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return as many finite numbers as the default has."""
    if key not in node:
        return default
    try:
        values = np.array(node[key], np.float64)
    except (TypeError, ValueError, OverflowError):
        values = np.empty(0)
    if values.shape != default.shape or not np.isfinite(values).all():
        raise MeshError(f"the {key} of a node must be {len(default)} finite numbers, not {str(node[key])[:80]}")
    return values


def _count_faces_and_users(gltf: GltfData, meshes: Iterable[Any]) -> tuple[int, Counter[Any]]:
    """Return the number of triangles of meshes, and how many of them use a list of points; nothing is read for it."""
    face_count, users = 0, Counter[Any]()
    for mesh in meshes:
        lists: dict[Any, int] = {}
        for _, mode, positions, indices, _ in _triangle_primitives(gltf, mesh):
            lists[positions] = gltf.count_items(positions)
            corner_count = lists[positions] if indices is None else gltf.count_items(indices)
            face_count += corner_count // 3 if mode == _TRIANGLES else corner_count
        users.update(lists.keys())
    return face_count, users


def _triangle_primitives(gltf: GltfData, mesh: int) -> Iterator[tuple[str, int, Any, Any, dict[str, Any]]]:
    """Yield place, mode, the accessors of positions and indices, and the object of each primitive that has triangles.

    The indices are None for a primitive that draws its points in their order.
    """
    for number, primitive in enumerate(get_list(gltf.item("meshes", mesh), "primitives")):
        where = f"meshes[{mesh}].primitives[{number}]"
        if not isinstance(primitive, dict):
            raise MeshError(f"{where} must be an object, not {str(primitive)[:20]!r}")
        mode = primitive.get("mode", _TRIANGLES)
        if mode not in range(_MODE_COUNT):
            raise MeshError(f"{where} has the mode {str(mode)[:20]}, but glTF has 0 to {_MODE_COUNT - 1}")
        positions, indices = get_object(primitive, "attributes").get("POSITION"), primitive.get("indices")
        if mode < _TRIANGLES or positions is None:
            continue
        accessors = [positions] if indices is None else [positions, indices]
        if _DRACO in get_object(primitive, "extensions") and not all(map(gltf.has_data, accessors)):
            raise refuse_compression(_DRACO)
        yield where, mode, positions, indices, primitive


def _read_primitives(
    gltf: GltfData, mesh: int, points: dict[int, NDArray[np.float64]], reader: GltfLooks, skin: Skin | None
) -> Iterator[Piece]:
    """Yield the primitives of a mesh; the points of an accessor are read once, and kept."""
    for where, mode, positions, indices, primitive in _triangle_primitives(gltf, mesh):
        if positions not in points:
            points[positions] = gltf.read_vectors(positions, (3,))
        count = len(points[positions])
        faces = _cut(np.arange(count) if indices is None else gltf.read_indices(indices), mode, where)
        # Checked here: once concatenated, a wrong index could refer to a vertex of another part.
        if len(faces) and faces.max() >= count:
            face, corner = np.argwhere(faces >= count)[0]
            raise MeshError(
                f"{where}: face {face} refers to vertex {faces[face, corner]}, but there are {count} vertices "
                f"(0 to {count - 1})"
            )
        piece = Piece(points[positions], faces, reader.read(primitive, points[positions], faces))
        yield piece if skin is None else pose_piece(gltf, primitive, piece, skin, where)


def _cut(corners: NDArray[np.int64], mode: int, where: str) -> NDArray[np.integer]:
    """Return the triangles (F, 3) of a primitive's corners (n,)."""
    if mode == _TRIANGLES:
        if len(corners) % 3:
            raise MeshError(f"{where} has {len(corners):,} corners, but triangles need a multiple of 3")
        return corners.reshape(-1, 3)
    if len(corners) < 3:
        return np.empty((0, 3), np.int64)
    if mode == _FAN:
        return cut_fans(corners, np.array([len(corners)]))
    strip = np.lib.stride_tricks.sliding_window_view(corners, 3).copy()
    # Every second triangle of a strip is wound the other way round.
    strip[1::2, 1:] = strip[1::2, :0:-1]
    return strip
