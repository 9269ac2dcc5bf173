"""Objects that come with places: the parts of a file, of a `trimesh.Scene`, or of another scene.

Owns the translation of all of them to one list of shapes and placements, or to one mesh with parts. Must not know how a
scene stores them.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Protocol, cast, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry.appearance.material import Material
from ..geometry.as_mesh import HasTriangles, mesh_of_object
from ..geometry.loading.file_mesh import FileMesh
from ..geometry.loading.file_parts import FileNode, FileParts, join_nodes, multiplies
from ..geometry.loading.load import LoadedParts
from ..geometry.mesh import Mesh
from ..geometry.spheres import Shape
from .handles import ALL_BITS, Colour, shorten
from .names import name_of_file
from .transforms import check_transform

# A last row of a node's matrix that is as near to 0, 0, 0, 1 as this is that, but for rounding.
_AFFINE_TOLERANCE = 1e-6


@runtime_checkable
class HasGraph(Protocol):
    """An object with named geometries and a graph of the nodes that place them, such as a `trimesh.Scene`."""

    @property
    def geometry(self) -> Any:
        """The geometries by name."""

    @property
    def graph(self) -> Any:
        """The nodes; ``graph[node]`` is its (4, 4) transform and the name of its geometry."""


class PlacedPart(NamedTuple):
    """A shape, by its index, placed by a (4, 4) float64 matrix that is not checked yet."""

    name: str
    shape: int
    matrix: NDArray[np.float64]
    mask: int = ALL_BITS
    colour: Colour | None = None
    material: Material | None = None


class Parts(NamedTuple):
    """Shapes with their names, and placements."""

    shapes: list[tuple[Shape, str]]
    placed: list[PlacedPart]


def parts_of_file(path: str | os.PathLike[str], load: Callable[[str | os.PathLike[str]], LoadedParts]) -> Parts:
    """Return the parts of a mesh file; raise `MeshError` if it cannot be read.

    By the end of the names of shapes one knows which direction is up.

    Parameters
    ----------
    path : str or path
    load : function
        `load_parts`, or `load_placed` for a file as a scene of it is best made.
    """
    loaded = load(path)
    file = Path(path)
    shapes: list[tuple[Shape, str]] = [
        (mesh, name_of_file(file.name))
        if mesh.name == file.name
        else (dataclasses.replace(mesh, name=f"{mesh.name}{file.suffix}"), mesh.name)
        for mesh in loaded.meshes
    ]
    return Parts(shapes, [PlacedPart(*node) for node in loaded.nodes])


def parts_of_graph(scene: HasGraph) -> Parts:
    """Return the triangle meshes of a `trimesh.Scene` that its nodes place.

    Raises
    ------
    SceneError
        There is none.
    MeshError
        A mesh cannot be used; the message names it.
    """
    shapes: list[tuple[Shape, str]] = []
    placed: list[PlacedPart] = []
    numbers: dict[str, int] = {}
    # One geometry under two names is converted once.
    meshes: dict[int, Mesh] = {}
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        geometry = scene.geometry[name]
        if not isinstance(geometry, HasTriangles) or len(geometry.faces) == 0:
            continue  # a path, or points
        if name not in numbers:
            numbers[name] = len(numbers)
            if id(geometry) not in meshes:
                meshes[id(geometry)] = mesh_of_object(geometry, str(name))
            shapes.append((dataclasses.replace(meshes[id(geometry)], name=str(name)), str(name)))
        placed.append(PlacedPart(str(node), numbers[name], make_affine(matrix)))
    if not placed:
        raise SceneError("the scene has no node with a triangle mesh: rays need a surface")
    return Parts(shapes, placed)


def whole_of_graph(scene: HasGraph, *, always_one: bool = False) -> Parts:
    """Return a `trimesh.Scene` as one of clbvh is best made of it: as `load_placed` does for files.

    Parameters
    ----------
    scene : trimesh.Scene
    always_one : bool
        Whether it is one mesh, whose parts are the nodes, however many triangles they place.

    Raises
    ------
    SceneError, MeshError
        See `parts_of_graph`; or the transform of a node is singular.
    """
    parts = parts_of_graph(scene)
    shapes = cast(list[tuple[Mesh, str]], parts.shapes)
    meshes = [FileMesh(name, mesh.vertices, mesh.faces, mesh.appearance) for mesh, name in shapes]
    nodes = [
        FileNode(part.name, part.shape, check_transform(part.matrix, f"the transform of {shorten(part.name)}"))
        for part in parts.placed
    ]
    listed = FileParts(meshes, nodes)
    if multiplies(listed) and not always_one:
        return parts
    joined = join_nodes(listed)
    name, ranges = ("Scene", joined.parts) if len(joined.parts) > 1 else (joined.parts[0].name, ())
    mesh = Mesh.from_arrays(joined.vertices, joined.faces, name=name, appearance=joined.appearance, parts=ranges)
    return Parts([(mesh, name)], [PlacedPart(name, 0, np.eye(4))])


def make_affine(matrix: Any) -> NDArray[np.float64]:
    """Return a matrix whose last row is 0, 0, 0, 1 exactly if it is that but for rounding."""
    affine = np.array(matrix, np.float64)
    if affine.shape == (4, 4) and np.allclose(affine[3], (0, 0, 0, 1), rtol=0, atol=_AFFINE_TOLERANCE):
        affine[3] = (0, 0, 0, 1)
    return affine
