"""Objects of trimesh: meshes with their looks, scenes with the graph of their nodes, and files that trimesh reads.

Looks are colours of vertices or faces, or texture coordinates with a material. Colours are sRGB, but for the factors of
a `PBRMaterial`, which are linear as in glTF files. Normals are not taken: those that trimesh has read cannot be told
from those that it has computed, which smooth over every edge.
"""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ...errors import MeshError
from ..appearance.appearance import Appearance
from ..appearance.material import OPAQUE, Material, Texture, copy_with_alpha
from ..appearance.srgb import srgb_to_linear
from ..mesh import Mesh
from .file_mesh import FileMesh, Problems, finish_looks, spread_colours, spread_uvs
from .file_parts import POINT, Parts, Placed, find_hidden, join_nodes

# Packages that trimesh needs for files that no reader of ours takes.
PACKAGES = {
    "3mf": "lxml networkx",
    "3dxml": "lxml networkx",
    "xaml": "lxml",
    "dae": "pycollada",
    "zae": "pycollada",
    "step": "cascadio",
    "stp": "cascadio",
}

_MAX_SHOWN = 60  # characters of a wrong value in a message

# A last row of a node's matrix that is as near to 0, 0, 0, 1 as this is that, but for rounding.
_AFFINE_TOLERANCE = 1e-6


@runtime_checkable
class HasTriangles(Protocol):
    """An object with the arrays of a triangle mesh, such as a `trimesh.Trimesh`."""

    @property
    def vertices(self) -> Any:
        """(V, 3) float."""

    @property
    def faces(self) -> Any:
        """(F, 3) int."""


@runtime_checkable
class HasGraph(Protocol):
    """An object with named geometries and a graph of the nodes that place them, such as a `trimesh.Scene`."""

    @property
    def geometry(self) -> Any:
        """The geometries by name."""

    @property
    def graph(self) -> Any:
        """The nodes; ``graph[node]`` is its (4, 4) transform and the name of its geometry."""


@contextmanager
def reading(thing: object) -> Iterator[None]:
    """Turn any error but a `MeshError` into one: objects of other libraries raise anything where they are empty."""
    try:
        yield
    except MeshError:
        raise
    except Exception as error:
        raise MeshError(f"{describe(thing)} has no triangles that can be read") from error


def describe(thing: object) -> str:
    """Return the type of a wrong value, with the value where it is short."""
    kind = type(thing)
    if kind.__module__ != "builtins":
        name = f"{kind.__module__.partition('.')[0]}.{kind.__qualname__}"
        return f"{'an' if name[0] in 'aeio' else 'a'} {name}"
    text = repr(thing)
    return f"{kind.__qualname__} {text}" if len(text) <= _MAX_SHOWN else f"a {kind.__qualname__}"


def read_trimesh(data: bytes, path: Path, problems: Problems) -> Parts[FileMesh]:
    """Return the parts of a file, as `trimesh.load_scene` reads it."""
    import trimesh  # takes 0.3 s

    suffix = path.suffix.lower().lstrip(".")
    resolver = trimesh.resolvers.FilePathResolver(str(path))
    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type=suffix, resolver=resolver, process=False)
    except ImportError as error:
        packages = PACKAGES[suffix]
        raise MeshError(
            f"a .{suffix} file is read by trimesh, which needs {packages.replace(' ', ' and ')}: run "
            "'pip install \"clbvh[formats]\"'"
        ) from error
    return _as_file_parts(read_graph(scene))


def read_graph(scene: HasGraph) -> Parts[Mesh]:
    """Return the triangle meshes of a `trimesh.Scene` that its nodes place, and these nodes; without hidden ones.

    Raises
    ------
    MeshError
        A mesh cannot be used, and the message names it; or the graph cannot be read.
    """
    loaded: Parts[Mesh] = Parts([], [])
    numbers: dict[str, int] = {}
    # One geometry under two names is converted once.
    meshes: dict[int, Mesh] = {}
    nodes = list_nodes(scene)
    with reading(scene):
        hidden = find_hidden([matrix for _, _, _, matrix in nodes])
        if hidden.all() and nodes:
            first = str(nodes[0][0])
            return Parts([Mesh.from_arrays(*POINT, name=first)], [Placed(first, 0, np.eye(4))])
        for (node, name, geometry, matrix), is_hidden in zip(nodes, hidden, strict=True):
            if is_hidden:
                continue
            if name not in numbers:
                numbers[name] = len(numbers)
                if id(geometry) not in meshes:
                    meshes[id(geometry)] = mesh_of_object(geometry, str(name))
                loaded.shapes.append(dataclasses.replace(meshes[id(geometry)], name=str(name)))
            loaded.placed.append(Placed(str(node), numbers[name], matrix))
    return loaded


def list_nodes(scene: HasGraph) -> list[tuple[Any, Any, Any, NDArray[np.float64]]]:
    """Return the nodes that place triangle meshes: the node, the name of its geometry, that, and the transform.

    Raises
    ------
    MeshError
        The graph cannot be read.
    """
    nodes = []
    with reading(scene):
        for node in scene.graph.nodes_geometry:
            matrix, name = scene.graph[node]
            geometry = scene.geometry[name]
            if isinstance(geometry, HasTriangles) and len(geometry.faces):  # no path, nor points
                nodes.append((node, name, geometry, _make_affine(matrix)))
    return nodes


def _as_file_parts(loaded: Parts[Mesh]) -> Parts[FileMesh]:
    meshes = [FileMesh(mesh.name, mesh.vertices, mesh.faces, mesh.appearance) for mesh in loaded.shapes]
    return Parts(meshes, loaded.placed)


def join_graph(loaded: Parts[Mesh]) -> Mesh:
    """Return the meshes of all nodes of a `trimesh.Scene` as one mesh, whose parts are the nodes.

    Raises
    ------
    MeshError
        There is no node, or its transform is not affine, or the coordinates are not finite.
    """
    if not loaded.placed:
        raise MeshError("the scene has no node with a triangle mesh: rays need a surface")
    for node in loaded.placed:
        if not np.array_equal(node.matrix[3:], [[0, 0, 0, 1]]):
            raise MeshError(f"the transform of {node.name!r} must be a (4, 4) matrix with the last row 0, 0, 0, 1")
    joined = join_nodes(_as_file_parts(loaded))
    name, ranges = ("Scene", joined.parts) if len(joined.parts) > 1 else (joined.parts[0].name, ())
    return Mesh.from_arrays(joined.vertices, joined.faces, name=name, appearance=joined.appearance, parts=ranges)


def _make_affine(matrix: Any) -> NDArray[np.float64]:
    """Return a matrix whose last row is 0, 0, 0, 1 exactly if it is that but for rounding."""
    affine = np.array(matrix, np.float64)
    if affine.shape == (4, 4) and np.allclose(affine[3], (0, 0, 0, 1), rtol=0, atol=_AFFINE_TOLERANCE):
        affine[3] = (0, 0, 0, 1)
    return affine


def mesh_of_object(thing: HasTriangles, name: str) -> Mesh:
    """Return the mesh of an object such as a `trimesh.Trimesh`, with its colours, textures and materials.

    Raises
    ------
    MeshError
        It is no valid mesh.
    """
    mesh = Mesh.from_arrays(thing.vertices, thing.faces, name=name)
    appearance = read_trimesh_looks(thing, mesh.faces, name)
    return mesh if appearance is None else dataclasses.replace(mesh, appearance=appearance)


_MAX_BYTE = 255


def read_trimesh_looks(mesh: Any, faces: NDArray[np.integer], name: str) -> Appearance | None:
    """Return the looks of an object's triangles, None if it says nothing of them.

    Looks that cannot be used become one `AppearanceWarning`.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        Or anything else; what it has in `visual` is read.
    faces : (F, 3) int
        The triangles, checked.
    name : str
        Of the object, for the warning.
    """
    visual: Any = getattr(mesh, "visual", None)
    kind = getattr(visual, "kind", None)
    if kind is None:
        return None
    problems = Problems()
    looks: dict[str, NDArray] = {}
    materials: list[Material] = []
    with problems.drop("the colours"):
        if kind == "vertex":
            looks["colours"] = spread_colours(_as_colours(visual.vertex_colors), faces)
        elif kind == "face":
            colours = _as_colours(visual.face_colors)
            if len(colours) != len(faces):
                raise MeshError(f"there are {len(colours):,} for {len(faces):,} faces")
            looks["colours"] = np.repeat(colours[:, None], 3, axis=1)
    if kind == "texture":
        if getattr(visual, "uv", None) is not None:
            with problems.drop("the texture coordinates"):
                looks["uvs"] = spread_uvs(np.asarray(visual.uv, np.float64)[:, :2], faces)
        with problems.drop("the material"):
            several = list(getattr(visual.material, "materials", None) or [])
            if several and visual.face_materials is not None:
                ids = np.asarray(visual.face_materials).astype(np.int32)
                if len(ids) != len(faces) or not 0 <= ids.min() <= ids.max() < len(several):
                    raise MeshError("its numbers do not fit the faces")
                looks["material_ids"] = ids
            textures: dict[tuple[int, bool, bool], Texture] = {}
            materials = [_make_material(one, textures) for one in several or [visual.material]]
    problems.warn(name)
    return finish_looks(looks, materials)


def _as_colours(values: Any) -> NDArray[np.uint8]:
    colours = np.asarray(values)
    if colours.dtype != np.uint8 or colours.ndim != 2 or colours.shape[1] not in (3, 4):
        raise MeshError(f"they are {colours.dtype} of shape {colours.shape}, not uint8 of shape (n, 4)")
    return copy_with_alpha(colours)


def _make_material(material: Any, textures: dict[tuple[int, bool, bool], Texture]) -> Material:
    """Return a material of a `PBRMaterial`, or of a `SimpleMaterial`."""

    def texture(image: Any, *, is_srgb: bool = True, is_opaque: bool = True) -> Texture | None:
        if image is None:
            return None
        key = id(image), is_srgb, is_opaque
        if key not in textures:
            pixels = np.array(image.convert("RGBA"))
            if is_opaque:
                pixels[..., 3] = OPAQUE
            textures[key] = Texture(str(getattr(material, "name", None) or "texture"), pixels, is_srgb)
        return textures[key]

    name = str(getattr(material, "name", None) or "")
    if not hasattr(material, "baseColorFactor"):
        diffuse = _as_shares(getattr(material, "diffuse", None), (1.0, 1.0, 1.0, 1.0))
        red, green, blue = (float(value) for value in srgb_to_linear(diffuse[:3]))
        gloss = max(0.0, float(getattr(material, "glossiness", None) or 0.0))
        return Material(
            name,
            (red, green, blue),
            alpha=diffuse[3],
            roughness=(2 / (gloss + 2)) ** 0.25 if gloss > 0 else Material.roughness,  # as in MTL files
            base_colour_texture=texture(getattr(material, "image", None), is_opaque=False),
        )
    factor = _as_shares(material.baseColorFactor, (1.0, 1.0, 1.0, 1.0))
    light = _as_shares(getattr(material, "emissiveFactor", None), (0.0, 0.0, 0.0))
    mode = getattr(material, "alphaMode", None) or "OPAQUE"
    cutoff = getattr(material, "alphaCutoff", None)
    return Material(
        name,
        (factor[0], factor[1], factor[2]),
        alpha=1.0 if mode == "OPAQUE" else factor[3],
        alpha_cutoff=None if mode != "MASK" else 0.5 if cutoff is None else float(cutoff),
        metallic=_as_share(getattr(material, "metallicFactor", None)),
        roughness=_as_share(getattr(material, "roughnessFactor", None)),
        emission=(light[0], light[1], light[2]),
        base_colour_texture=texture(getattr(material, "baseColorTexture", None), is_opaque=mode == "OPAQUE"),
        metallic_roughness_texture=texture(getattr(material, "metallicRoughnessTexture", None), is_srgb=False),
        emission_texture=texture(getattr(material, "emissiveTexture", None)),
        normal_texture=texture(getattr(material, "normalTexture", None), is_srgb=False),
    )


def _as_shares(values: Any, default: tuple[float, ...]) -> list[float]:
    """Return numbers from 0 to 1, as many as the default has; whole numbers are shares of 255."""
    if values is None:
        return list(default)
    array = np.asarray(values)
    shares = array / _MAX_BYTE if array.dtype.kind in "iu" and array.dtype.itemsize == 1 else array.astype(np.float64)
    shares = np.append(shares, default[len(shares) :])
    if len(shares) < len(default) or not np.isfinite(shares).all():
        raise MeshError(f"it has the colour {values}")
    return [float(share) for share in np.clip(shares, 0, 1)[: len(default)]]


def _as_share(value: Any) -> float:
    return 1.0 if value is None else min(1.0, max(0.0, float(value)))
