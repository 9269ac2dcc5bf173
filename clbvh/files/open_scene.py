"""A `Scene` and a `View` of anything that can be drawn: a scene, a path, a name, a tree or a mesh."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

from ..bvh import Bvh
from ..errors import SceneError
from ..geometry import MeshLike, Spheres, load_mesh
from ..geometry.as_mesh import HasGraph, spheres_of_file
from ..geometry.loading.file_mesh import PointCloudError
from ..scene.scene import Scene
from ..scene.state import SAVED_SCENE
from ..support.archive import begins_with_member
from ..support.folders import find_folder
from ..views.view import View

SCENE_SUFFIX = ".toml"

SceneLike: TypeAlias = Scene | Bvh | Spheres | MeshLike
"""Anything to draw: a `Scene`, the path or name of one, a `Bvh`, `Spheres`, or a `MeshLike`."""


def as_scene(source: SceneLike | list[str]) -> tuple[Scene, View]:
    """Return the scene that a user means, and its view, which is that of a scene file.

    Parameters
    ----------
    source : SceneLike or list of str
        A list of paths of mesh files is a scene of them all.

    Raises
    ------
    SceneError
        The scene file is missing, or has an unknown key or an invalid value; or a scene of trimesh cannot be used.
    MeshError
        The source has another type, or it is no valid mesh.
    """
    if isinstance(source, Scene):
        return source, View()
    if isinstance(source, str | os.PathLike):
        return open_scene(source)
    if isinstance(source, list) and source and all(isinstance(each, str | os.PathLike) for each in source):
        return _open_mesh_files(source)
    if isinstance(source, HasGraph):
        return Scene(source), View()
    scene = Scene()
    scene.place(scene.add(source.mesh if isinstance(source, Bvh) else source))  # type: ignore[arg-type]
    return scene, View()


def open_scene(source: str | os.PathLike[str]) -> tuple[Scene, View]:
    """Return the scene of a path or a name, and its view; a saved scene is recognised by its content.

    Parameters
    ----------
    source : str or path
        A scene file (``.toml``), the name of a shipped scene (``knot``), a mesh file, or a file that `Scene.save` or
        `save_scene` wrote.

    Raises
    ------
    SceneError
        The scene file is missing, or has an unknown key or an invalid value.
    MeshError
        An object of the scene cannot be loaded.

    Examples
    --------
    >>> import clbvh
    >>> scene, view = clbvh.open_scene("knot")
    >>> scene.instances, view.width, view.height
    ((Instance(0, 'knot', of='knot'),), 800, 450)
    >>> len(clbvh.open_scene("meadow")[0].instances)
    10001
    """
    try:
        text = os.fspath(source)
    except TypeError as error:
        raise SceneError(f"a scene is opened by the name or path of one, not {source!r}") from error
    if (file := find_scene_file(text)) is not None:
        from .scene_file import read_scene_file  # most pictures are of mesh files

        return read_scene_file(file)
    if begins_with_member(text, SAVED_SCENE):
        from ..scene.serialize import read_scene
        from .scene_file import view_of_plain

        state, settings = read_scene(text)
        try:
            return Scene.from_state(state), view_of_plain(settings)
        except SceneError as error:
            raise SceneError(f"{text}: {error}") from error
    if not Path(text).exists() and Path(text).name == text and not Path(text).suffix:
        names = sorted(path.stem for path in find_folder("scenes").glob(f"*{SCENE_SUFFIX}"))
        raise SceneError(f"{text}: no such file, and no shipped scene: these are {', '.join(names)}")
    return Scene(text), View()


def open_points(paths: Sequence[str], radius: float) -> Scene:
    """Return a scene of files of points, as spheres of a radius.

    Raises
    ------
    SceneError
        A file has faces.
    MeshError
        A file cannot be read, or the radius is not above 0.
    """
    scene = Scene()
    for path in paths:
        try:
            load_mesh(path)
        except PointCloudError as error:
            scene.place(scene.add(spheres_of_file(error, path, radius)))
            continue
        raise SceneError(f"{path}: the file has faces: a radius is for points alone")
    return scene


def _open_mesh_files(paths: list[str]) -> tuple[Scene, View]:
    """Return a scene of several mesh files, each placed as it is."""
    if len(paths) == 1:
        return open_scene(paths[0])
    scene = Scene()
    for path in paths:
        if Path(path).suffix.lower() == SCENE_SUFFIX or find_scene_file(os.fspath(path)):
            raise SceneError(f"{path}: several files make a scene if all of them are meshes: draw a scene file alone")
        scene.add_parts(Scene(path))
    return scene, View()


def find_scene_file(name: str) -> Path | None:
    """Return the scene file of this path, or of a shipped scene of this name; None for anything else."""
    if name.endswith(SCENE_SUFFIX):
        return Path(name)
    shipped = find_folder("scenes") / f"{name}{SCENE_SUFFIX}"
    is_name = Path(name).name == name and not Path(name).exists()
    return shipped if is_name and shipped.is_file() else None
