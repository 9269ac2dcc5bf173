"""Objects that come with places: the parts of a file, of a `trimesh.Scene`, or of another scene.

Owns the translation of all of them to one list of shapes and placements. Must not know how a scene stores them.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry.appearance.material import Material
from ..geometry.as_mesh import HasTriangles, mesh_of_object
from ..geometry.loading.load import load_parts
from ..geometry.mesh import Mesh
from ..geometry.spheres import Shape
from .handles import ALL_BITS, Colour, colour_of_row
from .names import name_of_file
from .state import SceneState

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


def parts_of_file(path: str | os.PathLike[str]) -> Parts:
    """Return the parts of a mesh file; raise `MeshError` if it cannot be read."""
    meshes, placements = load_parts(path)
    file = Path(path).name
    shapes: list[tuple[Shape, str]] = [
        (mesh, name_of_file(file) if mesh.name == file else mesh.name) for mesh in meshes
    ]
    return Parts(shapes, [PlacedPart(*placement) for placement in placements])


def parts_of_graph(scene: HasGraph) -> Parts:
    """Return the triangle meshes of a `trimesh.Scene` that its nodes place.

    Raises
    ------
    SceneError
        There is none.
    MeshError
        A mesh cannot be used; the message names it.
    """
    parts = Parts([], [])
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
            mesh = meshes.get(id(geometry))
            if mesh is None:
                mesh = meshes[id(geometry)] = mesh_of_object(geometry, str(name))
            parts.shapes.append((dataclasses.replace(mesh, name=str(name)), str(name)))
        parts.placed.append(PlacedPart(str(node), numbers[name], make_affine(matrix)))
    if not parts.placed:
        raise SceneError("the scene has no node with a triangle mesh: rays need a surface")
    return parts


def parts_of_state(state: SceneState) -> Parts:
    """Return the parts of a scene of clbvh."""
    return Parts(
        list(zip(state.shapes, state.names, strict=True)),
        [
            PlacedPart(name, int(geometry), matrix, int(mask), colour_of_row(colour), state.material_of(number))
            for number, (name, geometry, matrix, mask, colour) in enumerate(
                zip(state.instance_names, state.geometry_ids, state.transforms, state.masks, state.colours, strict=True)
            )
        ],
    )


def make_affine(matrix: Any) -> NDArray[np.float64]:
    """Return a matrix whose last row is 0, 0, 0, 1 exactly if it is that but for rounding."""
    affine = np.array(matrix, np.float64)
    if affine.shape == (4, 4) and np.allclose(affine[3], (0, 0, 0, 1), rtol=0, atol=_AFFINE_TOLERANCE):
        affine[3] = (0, 0, 0, 1)
    return affine
