"""Shapes with their placements: the parts of a file, of a `trimesh.Scene`, or of another scene.

Owns their translation to one list of shapes and placements, or to one mesh with parts. Must not know how a
scene stores them.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..errors import SceneError
from ..geometry.as_mesh import spheres_of_file
from ..geometry.loading.file_mesh import PointCloudError
from ..geometry.loading.file_parts import Parts, Placed, multiplies
from ..geometry.loading.trimesh import HasGraph, join_graph, read_graph
from ..geometry.mesh import Mesh
from ..geometry.spheres import Shape
from .names import name_of_file

# Shapes with their names, and placements that are not checked yet.
NamedParts = Parts[tuple[Shape, str]]


def parts_of_file(path: str | os.PathLike[str], load: Callable[[str | os.PathLike[str]], Parts[Mesh]]) -> NamedParts:
    """Return the parts of a mesh file; raise `MeshError` if it cannot be read.

    The file suffix in a shape's name tells the up axis.

    Parameters
    ----------
    path : str or path
    load : function
        `load_parts`, or `load_placed`, which joins the parts unless that would multiply the triangles.
    """
    file = Path(path)
    try:
        loaded = load(path)
    except PointCloudError as error:
        name = name_of_file(file.name)
        return Parts([(spheres_of_file(error, path), name)], [Placed(name, 0, np.eye(4))])
    shapes: list[tuple[Shape, str]] = [
        (mesh, name_of_file(file.name))
        if mesh.name == file.name
        else (dataclasses.replace(mesh, name=f"{mesh.name}{file.suffix}"), mesh.name)
        for mesh in loaded.shapes
    ]
    return Parts(shapes, loaded.placed)


def parts_of_graph(scene: HasGraph, *, joins: bool = False) -> NamedParts:
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
    if not loaded.placed:
        raise SceneError("the scene has no node with a triangle mesh: rays need a surface")
    if joins and not multiplies(loaded):
        mesh = join_graph(loaded)
        loaded = Parts([mesh], [Placed(mesh.name, 0, np.eye(4))])
    return Parts([(mesh, mesh.name) for mesh in loaded.shapes], loaded.placed)
