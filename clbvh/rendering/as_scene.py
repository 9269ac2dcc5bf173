"""Makes a `Scene` of anything that can be drawn: a scene, a path, a tree or a mesh."""

from __future__ import annotations

import os
from typing import TypeAlias

from ..bvh import Bvh
from ..geometry import MeshLike, as_mesh
from .scene import MeshSource, Scene
from .scene_file import open_scene

SceneLike: TypeAlias = Scene | Bvh | MeshLike
"""Anything that can be drawn: a `Scene`, the path or name of one, a `Bvh`, or a `MeshLike`."""


def as_scene(source: SceneLike) -> Scene:
    """Return the scene that a user means.

    Parameters
    ----------
    source : Scene, str, path, Bvh, Mesh, trimesh.Trimesh or (vertices, faces)
        A scene; the path or name of one, or the path of a mesh file; the mesh of a tree; or a mesh.

    Raises
    ------
    SceneError
        The scene file is missing, or has an unknown key or an invalid value.
    MeshError
        The source has another type, or it is no valid mesh.
    """
    if isinstance(source, Scene):
        return source
    if isinstance(source, str | os.PathLike):
        return open_scene(source)
    if isinstance(source, Bvh):
        return Scene(MeshSource(mesh=source.mesh))
    return Scene(MeshSource(mesh=as_mesh(source, or_else="a clbvh.Scene, the path or name of one, a clbvh.Bvh")))
