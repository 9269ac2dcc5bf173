"""Makes a `Scene` of anything that can be drawn: a scene, a path, a tree or a mesh."""

from __future__ import annotations

import os
from typing import TypeAlias

from ..bvh import Bvh
from ..geometry import MeshLike, Spheres, as_mesh
from ..scene.parts import HasGraph
from .scene import MeshSource, Scene
from .scene_file import open_scene

SceneLike: TypeAlias = Scene | HasGraph | Bvh | Spheres | MeshLike
"""Anything to draw: a `Scene`, the path or name of one, a `trimesh.Scene`, a `Bvh`, `Spheres`, or a `MeshLike`."""


def as_scene(source: SceneLike) -> Scene:
    """Return the scene that a user means.

    Parameters
    ----------
    source : Scene, str, path, trimesh.Scene, Bvh, Mesh, Spheres, trimesh.Trimesh or (vertices, faces)
        A scene; the path or name of one, or the path of a mesh file; a scene of trimesh; the mesh of a tree; or one
        geometry.

    Raises
    ------
    SceneError
        The scene file is missing, or has an unknown key or an invalid value; or a scene of trimesh cannot be used.
    MeshError
        The source has another type, or it is no valid mesh.
    """
    if isinstance(source, Scene):
        return source
    if isinstance(source, str | os.PathLike):
        return open_scene(source)
    if isinstance(source, Bvh):
        return Scene(MeshSource(mesh=source.mesh))
    if isinstance(source, HasGraph):
        scene = Scene()
        scene.add_scene(source)
        return scene
    if isinstance(source, Spheres):
        scene = Scene()
        scene.place(scene.add(source))
        return scene
    others = "a clbvh.Scene, the path or name of one, a trimesh.Scene, a clbvh.Bvh, clbvh.Spheres"
    return Scene(MeshSource(mesh=as_mesh(source, or_else=others)))
