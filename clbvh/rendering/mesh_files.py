"""Mesh files become a scene: one file, or several that are placed as they are."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from ..errors import SceneError
from ..geometry.loading.several_parts import may_have_parts
from ..geometry.up import RULED_SUFFIXES
from ..support.resources import find_folder
from .camera import DEFAULT_UP
from .mesh_source import MeshSource
from .scene import Scene
from .upright import AUTO


def open_mesh_file(path: str | os.PathLike[str]) -> Scene:
    """Return the scene of one mesh file.

    The parts of an OBJ, GLB or glTF file with several of them are geometries and instances with the file's names, and
    are loaded now. Any other file is one mesh, which is loaded when it is needed. The scene's `up` is y for glTF files,
    and otherwise guessed.

    Raises
    ------
    MeshError
        The parts cannot be loaded.
    """
    one_mesh = Scene(MeshSource(path=os.fspath(path)), up=AUTO)
    if not may_have_parts(path):
        return one_mesh
    scene = _empty_scene([path])
    instances = scene.add_scene(path)
    # Names without faces are no parts.
    return scene if len(instances) > 1 else one_mesh


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
        if Path(path).suffix.lower() == ".toml" or _is_shipped(path):
            raise SceneError(f"{path}: several files make a scene if all of them are meshes: draw a scene file alone")
    if len(paths) == 1:
        return open_mesh_file(paths[0])
    scene = _empty_scene(paths)
    for path in paths:
        scene.add_scene(path)
    return scene


def _is_shipped(path: str | os.PathLike[str]) -> bool:
    """Return whether this is the name of a shipped scene, and not of a file."""
    is_name = Path(path).name == os.fspath(path) and not Path(path).exists()
    return is_name and (find_folder("scenes") / f"{os.fspath(path)}.toml").is_file()


def _empty_scene(paths: Sequence[str | os.PathLike[str]]) -> Scene:
    """Return a scene whose `up` is that of files: by the rule of their format, or to be guessed."""
    has_rule = all(Path(path).suffix.lower() in RULED_SUFFIXES for path in paths)
    return Scene(up=DEFAULT_UP if has_rule else AUTO)
