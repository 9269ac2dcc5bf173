"""Scene files: TOML tables become a `Scene`; unknown keys and values of the wrong type become errors that name them."""

from __future__ import annotations

import math
import os
import tomllib
from pathlib import Path
from typing import Any

from ..errors import ConfigError, SceneError
from ..scene.serialize import is_saved_scene
from ..support.regular_file import read_regular
from ..support.resources import find_folder
from .scene import Light, MeshSource, Scene, Transform
from .vectors import Vector

SCENE_SUFFIX = ".toml"

_TABLES = ("mesh", "transform", "camera", "light", "image")

_MAX_FILE_BYTES = 1 << 20  # a scene has a few hundred
_MAX_INTEGER = 2**63 - 1  # of TOML 1.0; Python's reader has no limit
_MAX_SHOWN = 80  # characters of a wrong value in a message


def open_scene(source: str | os.PathLike[str]) -> Scene:
    """Return the scene of a path or a name; a file that `Scene.save` wrote is recognised by its content.

    Parameters
    ----------
    source : str or path
        A scene file (``.toml``), the name of a shipped scene (``knot``), the name of a known mesh (``bunny``), or a
        mesh file.

    Raises
    ------
    SceneError
        The scene file is missing, or has an unknown key or an invalid value.

    Examples
    --------
    >>> import clbvh
    >>> scene = clbvh.open_scene("knot")
    >>> scene.mesh.shape, scene.width, scene.height
    ('knot', 800, 450)
    """
    try:
        text = os.fspath(source)
    except TypeError as error:
        raise SceneError(f"a scene is a Scene, or the name or path of one, not {source!r}") from error
    if text.endswith(SCENE_SUFFIX):
        return read_scene(Path(text))
    if is_saved_scene(text):
        return Scene.load(text)
    shipped = find_folder("scenes") / f"{text}{SCENE_SUFFIX}"
    if not Path(text).exists() and Path(text).name == text and not Path(text).suffix:
        if shipped.is_file():
            return read_scene(shipped)
        names = sorted(path.stem for path in shipped.parent.glob(f"*{SCENE_SUFFIX}"))
        raise SceneError(f"{text}: no such file, and no shipped scene: these are {', '.join(names)}")
    return Scene(MeshSource(path=text))


def read_scene(path: Path) -> Scene:
    """Read a scene file; `docs/scenes.md` lists its keys.

    Raises
    ------
    SceneError
        The file is missing, not a regular one, not TOML, or has an unknown key or an invalid value, which the message
        names.
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
        return _make_scene(tables, path.parent)
    except ConfigError as error:
        raise SceneError(f"{path}: {error}") from error
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None


def _make_scene(tables: dict[str, Any], folder: Path) -> Scene:
    """Make a scene from the tables of a scene file; missing keys have their defaults."""
    _refuse_unknown(tables, _TABLES, "the scene")
    if "mesh" not in tables:
        raise SceneError("the scene has no [mesh] table: it needs a path, a name or a shape")
    for name in _TABLES:
        if not isinstance(tables.get(name, {}), dict):
            raise SceneError(f"'{name}' must be a table: write [{name}] on a line of its own")
    mesh, transform, camera, light, image = (_Table(name, tables.get(name, {})) for name in _TABLES)

    values: dict[str, Any] = {
        "mesh": _make_mesh_source(mesh, folder),
        "transform": Transform(
            **_given(
                scale=transform.number("scale"),
                rotate=transform.vector("rotate"),
                translate=transform.vector("translate"),
            )
        ),
        "light": Light(
            **_given(
                direction=light.vector("direction"),
                colour=light.vector("colour"),
                sky=light.vector("sky"),
                ground=light.vector("ground"),
            )
        ),
        "eye": camera.vector("eye"),
        "look_at": camera.vector("look_at"),
        "up": camera.vector("up"),
        "fov": camera.number("fov"),
        "shading": image.text("shading"),
        "surface": image.vector("surface"),
        "background": image.gradient("background"),
        "width": image.integer("width"),
        "height": image.integer("height"),
    }
    for table in (transform, camera, light, image):
        table.refuse_rest()
    return Scene(**_given(**values))


def _make_mesh_source(table: _Table, folder: Path) -> MeshSource:
    path, name, shape = table.text("path"), table.text("name"), table.text("shape")
    source: dict[str, Any] = {"path": None if path is None else str(folder / path), "name": name, "shape": shape}
    if shape is None:
        table.refuse_rest()
        return MeshSource(**source)
    numbers = _given(triangles=table.integer("triangles"), seed=table.integer("seed"))
    return MeshSource(**source, **numbers, options=table.rest_as_numbers())


def _given(**values: Any) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _refuse_unknown(given: Any, known: tuple[str, ...], where: str) -> None:
    for key in given:
        if key not in known:
            raise SceneError(f"{where} has an unknown key '{key}'; known are {', '.join(known)}")


class _Table:
    """One table of a scene file; every getter removes its key, so the keys that are left are unknown."""

    def __init__(self, name: str, values: dict[str, Any]) -> None:
        self._name = name
        self._values = dict(values)
        self._known: list[str] = []

    def text(self, key: str) -> str | None:
        return self._take(key, "a text", lambda value: isinstance(value, str))

    def integer(self, key: str) -> int | None:
        return self._take(key, "a whole number", _is_integer)

    def number(self, key: str) -> float | None:
        return self._take(key, "a finite number", _is_number)

    def vector(self, key: str) -> Vector | None:
        value = self._take(key, "three finite numbers", _is_vector)
        return None if value is None else tuple(float(part) for part in value)  # type: ignore[return-value]

    def gradient(self, key: str) -> tuple[Vector, Vector] | None:
        """Take one colour, or two: top and bottom."""
        value = self._take(
            key,
            "a colour of three numbers, or two of them: top and bottom",
            lambda value: (
                _is_vector(value) or (isinstance(value, list) and len(value) == 2 and all(map(_is_vector, value)))
            ),
        )
        if value is None:
            return None
        top, bottom = (value, value) if _is_vector(value) else value
        return tuple(map(float, top)), tuple(map(float, bottom))  # type: ignore[return-value]

    def rest_as_numbers(self) -> dict[str, float]:
        """Take all keys that are left; each value must be a number."""
        return {key: self.number(key) or 0.0 for key in list(self._values)}

    def refuse_rest(self) -> None:
        """Raise `SceneError` for a key that was not taken."""
        _refuse_unknown(self._values, tuple(self._known), f"[{self._name}]")

    def _take(self, key: str, expected: str, is_valid: Any) -> Any:
        self._known.append(key)
        if key not in self._values:
            return None
        value = self._values.pop(key)
        if not is_valid(value):
            raise SceneError(f"[{self._name}] {key} must be {expected}, not {_show(value)}")
        return value


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) <= _MAX_INTEGER


def _is_number(value: Any) -> bool:
    return _is_integer(value) or (isinstance(value, float) and math.isfinite(value))


def _is_vector(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(map(_is_number, value))


def _show(value: Any) -> str:
    """Return the beginning of a wrong value."""
    try:
        return repr(value)[:_MAX_SHOWN]
    except ValueError:  # Python does not print integers of many thousand digits
        return "a number of many digits"
