"""Shapes with their placements: the parts of a file, of a `trimesh.Scene`, or of another scene.

Owns their translation to one list of shapes and placements, or to one mesh with parts. Must not know how a
scene stores them.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry.appearance.material import Material
from ..geometry.loading.file_parts import FileNode, LoadedParts, multiplies
from ..geometry.loading.trimesh import HasGraph, join_graph, read_graph
from ..geometry.spheres import Shape
from .handles import ALL_BITS, Colour
from .names import name_of_file


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

    The file suffix in a shape's name tells the up axis.

    Parameters
    ----------
    path : str or path
    load : function
        `load_parts`, or `load_placed`, which joins the parts unless that would multiply the triangles.
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


def parts_of_graph(scene: HasGraph, *, joins: bool = False) -> Parts:
    """Return the triangle meshes of a `trimesh.Scene` that its nodes place.

    Parameters
    ----------
    scene : trimesh.Scene
    joins : bool
        True: joins the meshes into one whose parts are the nodes, unless that would multiply the triangles, as
        `load_placed` does for files.

    Raises
    ------
    SceneError
        No node places a triangle mesh.
    MeshError
        A mesh cannot be used; the message names it.
    """
    loaded = read_graph(scene)
    if not loaded.nodes:
        raise SceneError("the scene has no node with a triangle mesh: rays need a surface")
    if joins and not multiplies(loaded):
        mesh = join_graph(loaded)
        loaded = LoadedParts([mesh], [FileNode(mesh.name, 0, np.eye(4))])
    return Parts([(mesh, mesh.name) for mesh in loaded.meshes], [PlacedPart(*node) for node in loaded.nodes])
