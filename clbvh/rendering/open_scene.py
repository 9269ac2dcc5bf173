"""A `Scene` of anything that can be drawn: a scene, a path, a name, a tree or a mesh."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

from ..bvh import Bvh
from ..errors import SceneError
from ..geometry import MeshLike, Spheres, as_mesh
from ..geometry.loading.load import may_have_parts
from ..scene.parts import HasGraph
from ..scene.serialize import is_saved_scene
from ..support.folders import find_folder
from .cameras.projection import AUTO, DEFAULT_UP
from .guesses import RULED_SUFFIXES
from .scene import Scene
from .sources import MeshSource

SCENE_SUFFIX = ".toml"

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


def open_scene(source: str | os.PathLike[str]) -> Scene:
    """Return the scene of a path or a name; a file that `Scene.save` wrote is recognised by its content.

    Parameters
    ----------
    source : str or path
        A scene file (``.toml``), the name of a shipped scene (``knot``), the name of a known mesh (``bunny``), a mesh
        file, or a file that `Scene.save` wrote. Objects of a scene file, and the parts of an OBJ, GLB or glTF file with
        several of them, are loaded now; a single mesh is loaded when it is needed.

    Raises
    ------
    SceneError
        The scene file is missing, or has an unknown key or an invalid value.
    MeshError
        An object of the scene cannot be loaded.

    Examples
    --------
    >>> import clbvh
    >>> scene = clbvh.open_scene("knot")
    >>> scene.mesh.shape, scene.width, scene.height
    ('knot', 800, 450)
    >>> len(clbvh.open_scene("meadow").instances)
    10001
    """
    try:
        text = os.fspath(source)
    except TypeError as error:
        raise SceneError(f"a scene is a Scene, or the name or path of one, not {source!r}") from error
    if text.endswith(SCENE_SUFFIX):
        return _read_scene_file(Path(text))
    if is_saved_scene(text):
        return Scene.load(text)
    if (shipped := _find_shipped(text)) is not None:
        return _read_scene_file(shipped)
    if not Path(text).exists() and Path(text).name == text and not Path(text).suffix:
        names = sorted(path.stem for path in find_folder("scenes").glob(f"*{SCENE_SUFFIX}"))
        raise SceneError(f"{text}: no such file, and no shipped scene: these are {', '.join(names)}")
    return open_mesh_file(text)


def _read_scene_file(path: Path) -> Scene:
    from .scene_file import read_scene  # most pictures are of mesh files

    return read_scene(path)


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
        if Path(path).suffix.lower() == SCENE_SUFFIX or _find_shipped(os.fspath(path)):
            raise SceneError(f"{path}: several files make a scene if all of them are meshes: draw a scene file alone")
    if len(paths) == 1:
        return open_mesh_file(paths[0])
    scene = _empty_scene(paths)
    for path in paths:
        scene.add_scene(path)
    return scene


def _find_shipped(name: str) -> Path | None:
    """Return the file of a shipped scene; None if this is the name of a file, or of no scene."""
    shipped = find_folder("scenes") / f"{name}{SCENE_SUFFIX}"
    is_name = Path(name).name == name and not Path(name).exists()
    return shipped if is_name and shipped.is_file() else None


def _empty_scene(paths: Sequence[str | os.PathLike[str]]) -> Scene:
    """Return a scene whose `up` is that of files: by the rule of their format, or to be guessed."""
    has_rule = all(Path(path).suffix.lower() in RULED_SUFFIXES for path in paths)
    return Scene(up=DEFAULT_UP if has_rule else AUTO)
