"""Scene files: TOML tables become a `Scene`; unknown keys and values of the wrong type become errors that name them."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..errors import ConfigError, SceneError
from ..support.files import read_regular
from .cameras.projection import AUTO, Projection, name_of, read_projection
from .cut import Cut
from .object_tables import given, read_mesh_source, read_objects, read_transform
from .objects import SceneObject, load_objects
from .scene import Scene
from .settings import Light, Wireframe
from .toml_tables import NO_MATERIALS, TomlTable, read_materials, refuse_unknown, take_material
from .vectors import Vector

_OBJECTS, _MATERIALS = "object", "material"
_TABLES = ("mesh", "transform", "camera", "light", "environment", "image")

_MAX_FILE_BYTES = 1 << 20  # a scene has a few hundred


@dataclass(frozen=True)
class SceneFile:
    """A scene file that was read and checked, with the textures of its materials, but no other file that it names.

    Attributes
    ----------
    path : Path
    scene : Scene
        Without the objects.
    objects : tuple of SceneObject
        Empty where the scene has one mesh of its own.
    """

    path: Path
    scene: Scene
    objects: tuple[SceneObject, ...]


def read_scene(path: Path) -> Scene:
    """Read a scene file, and load its objects; `docs/scenes.md` lists its keys. A single `[mesh]` is loaded later.

    Raises
    ------
    SceneError
        The file is missing, not a regular one, not TOML, or has an unknown key or an invalid value, which the message
        names.
    MeshError
        An object cannot be loaded.
    """
    file = parse_scene(path)
    if not file.objects:
        return file.scene
    try:
        load_objects(file.scene, file.objects)
    except (ConfigError, SceneError) as error:
        raise SceneError(f"{path}: {error}") from error
    return file.scene


def parse_scene(path: Path) -> SceneFile:
    """Read a scene file and check its values; see `read_scene`.

    Raises
    ------
    SceneError
        See `read_scene`.
    """
    try:
        text = read_regular(path, max_bytes=_MAX_FILE_BYTES).decode()
    except FileNotFoundError as error:
        raise SceneError(f"{path}: no such scene file") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise SceneError(f"{path}: the scene file cannot be read: {reason}") from error
    try:
        tables = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also of numbers of many digits, and of lists within lists
        raise SceneError(f"{path}: not a TOML file: {error}") from error
    try:
        return _make_scene(tables, path)
    except ConfigError as error:
        raise SceneError(f"{path}: {error}") from error
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None


def _make_scene(tables: dict[str, Any], path: Path) -> SceneFile:
    """Make a scene from the tables of a scene file; missing keys have their defaults."""
    refuse_unknown(tables, (_TABLES[0], _OBJECTS, _MATERIALS, *_TABLES[1:]), "the scene")
    if "mesh" not in tables and _OBJECTS not in tables:
        raise SceneError("the scene has no [mesh] table and no [[object]]: it needs a path, a name or a shape")
    for name in _TABLES:
        if not isinstance(tables.get(name, {}), dict):
            raise SceneError(f"'{name}' must be a table: write [{name}] on a line of its own")
    mesh, transform, camera, light, environment, image = (
        TomlTable(f"[{name}]", tables.get(name, {})) for name in _TABLES
    )

    materials = read_materials(tables[_MATERIALS], path.parent) if _MATERIALS in tables else NO_MATERIALS
    values: dict[str, Any] = {}
    objects: tuple[SceneObject, ...] = ()
    if _OBJECTS in tables:
        for name in ("mesh", "transform"):
            if name in tables:
                raise SceneError(f"a scene of [[object]] tables has no [{name}]: write it into the objects")
        objects = read_objects(tables[_OBJECTS], path.parent, materials)
    else:
        material = take_material(mesh, materials)
        values = {"mesh": read_mesh_source(mesh, path.parent, material), "transform": read_transform(transform)}
    for take, names in (
        (camera.vector, ("eye", "look_at")),
        (camera.text, ("frame", "view")),
        (camera.number, ("fov", "aperture", "focus_distance")),
        (image.text, ("shading", "tone_curve")),
        (image.integer, ("samples", "seed", "max_bounces", "width", "height")),
        (image.number, ("smooth", "exposure", "clamp")),
        (image.flag, ("ground", "transparent")),
    ):
        values |= {name: take(name) for name in names}
    values |= {
        "light": Light(**given(**{name: light.vector(name) for name in ("direction", "colour", "sky", "ground")})),
        "up": camera.vector_or_text("up", AUTO),
        "cut": _read_cut(camera),
        "wireframe": _read_wireframe(image),
        "projection": _read_projection(camera),
        "surface": image.vector("surface"),
        "background": image.gradient("background"),
        "environment": None if (panorama := environment.text("path")) is None else str(path.parent / panorama),
        "environment_rotation": environment.number("rotation"),
        "environment_strength": environment.number("strength"),
    }
    for table in (transform, camera, light, environment, image):
        table.refuse_rest()
    if values["projection"] is not None and values["fov"] is not None:
        raise SceneError("[camera] fov is that of a perspective camera: take it out, or the kind")
    return SceneFile(path, Scene(**given(**values)), objects)


def _read_cut(camera: TomlTable) -> Cut | None:
    """Return the cut of a camera."""
    plane, box = camera.rows("cut_plane", 3, 2), camera.rows("cut_box", 3, 2)
    if plane is not None and box is not None:
        raise SceneError("[camera] has a cut_plane or a cut_box, not both")
    if plane is not None:
        return Cut("plane", *map(_as_vector, plane))
    return None if box is None else Cut("box", *map(_as_vector, box))


def _read_wireframe(image: TomlTable) -> Wireframe | None:
    """Return the lines of a picture: there are some if their width or their colour is given."""
    values = given(width=image.number("wireframe_width"), colour=image.vector("wireframe_colour"))
    return Wireframe(**values) if values else None


def _as_vector(row: list[float]) -> Vector:
    x, y, z = row
    return x, y, z


def _read_projection(camera: TomlTable) -> Projection | None:
    """Return the projection of a camera; None for perspective."""
    projection = read_projection(camera.text("kind"))
    values = given(height=camera.number("height"), angle=camera.number("angle"))
    for name in values:
        if not hasattr(projection, name):
            raise SceneError(f"a camera of the kind {name_of(projection)} has no {name}")
    return projection and replace(projection, **values)
