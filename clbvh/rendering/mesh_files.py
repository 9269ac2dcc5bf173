"""Mesh files become a scene: one file, or several that are placed as they are."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from ..errors import SceneError
from ..geometry.loading.several_parts import may_have_parts
from .mesh_source import MeshSource
from .scene import Scene


def open_mesh_file(path: str | os.PathLike[str]) -> Scene:
    """Return the scene of one mesh file.

    The parts of an OBJ, GLB or glTF file with several of them are geometries and instances with the file's names, and
    are loaded now. Any other file is one mesh, which is loaded when it is needed.

    Raises
    ------
    MeshError
        The parts cannot be loaded.
    """
    if not may_have_parts(path):
        return Scene(MeshSource(path=os.fspath(path)))
    scene = Scene()
    instances = scene.add_scene(path)
    if len(instances) > 1:
        return scene
    # Names without faces are no parts.
    return Scene(MeshSource(path=os.fspath(path)))


def open_mesh_files(paths: Sequence[str | os.PathLike[str]]) -> Scene:
    """Return a scene of several mesh files, each placed as it is; their parts keep their names.

    Raises
    ------
    SceneError
        There is no path, or one is that of a scene file.
    MeshError
        A file cannot be loaded.
    """
    if not paths:
        raise SceneError("a scene of mesh files needs at least one of them")
    for path in paths:
        if Path(path).suffix.lower() == ".toml":
            raise SceneError(f"{path}: several files make a scene if all of them are meshes: draw a scene file alone")
    if len(paths) == 1:
        return open_mesh_file(paths[0])
    scene = Scene()
    for path in paths:
        scene.add_scene(path)
    return scene
