"""Tables of a TOML file: values are taken key by key, and the keys that are left are unknown; materials.

Owns the checks of types and their messages.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

from ..errors import MeshError, SceneError
from ..geometry.appearance.material import Material, Texture
from ..geometry.loading.texture_files import decode_image
from ..support.files import read_regular
from .vectors import Vector

_MAX_INTEGER = 2**63 - 1  # of TOML 1.0; Python's reader has no limit
_MAX_SHOWN = 80  # characters of a wrong value in a message


class TomlTable:
    """A table and its name; every getter removes its key and returns None where the key is missing.

    Parameters
    ----------
    name : str
        As messages show it: ``[camera]``.
    values : dict
        As `tomllib` reads it; not changed.

    Raises
    ------
    SceneError
        From each getter: the value has another type.
    """

    def __init__(self, name: str, values: dict[str, Any]) -> None:
        self.name = name
        self._values = dict(values)
        self._known: list[str] = []

    def __contains__(self, key: str) -> bool:
        """Whether the key is there, and not taken yet."""
        return key in self._values

    def text(self, key: str) -> str | None:
        """Take a text."""
        return self._take(key, "a text", lambda value: isinstance(value, str))

    def flag(self, key: str) -> bool | None:
        """Take true or false."""
        return self._take(key, "true or false", lambda value: isinstance(value, bool))

    def integer(self, key: str) -> int | None:
        """Take a whole number that TOML can hold."""
        return self._take(key, "a whole number", _is_integer)

    def number(self, key: str) -> float | None:
        """Take a finite number."""
        return self._take(key, "a finite number", _is_number)

    def vector(self, key: str) -> Vector | None:
        """Take three finite numbers."""
        value = self._take(key, "three finite numbers", _is_vector)
        return None if value is None else tuple(map(float, value))  # type: ignore[return-value]

    def vector_or_text(self, key: str, text: str) -> Vector | str | None:
        """Take three finite numbers, or one text."""
        value = self._take(key, f'three finite numbers, or "{text}"', lambda value: _is_vector(value) or value == text)
        return tuple(map(float, value)) if isinstance(value, list) else value  # type: ignore[return-value]

    def number_or_vector(self, key: str) -> float | Vector | None:
        """Take a finite number, or three."""
        value = self._take(key, "a finite number, or three", lambda value: _is_number(value) or _is_vector(value))
        return tuple(map(float, value)) if isinstance(value, list) else value  # type: ignore[return-value]

    def gradient(self, key: str) -> tuple[Vector, Vector] | None:
        """Take one colour, or two: top and bottom."""
        value = self._take(
            key,
            "a colour of three numbers, or two of them: top and bottom",
            lambda value: _is_vector(value) or (_is_list(value, 2) and all(map(_is_vector, value))),
        )
        if value is None:
            return None
        top, bottom = (value, value) if _is_vector(value) else value
        return tuple(map(float, top)), tuple(map(float, bottom))  # type: ignore[return-value]

    def integers(self, key: str, count: int) -> tuple[int, ...] | None:
        """Take this many whole numbers."""
        value = self._take(
            key, f"{count} whole numbers", lambda value: _is_list(value, count) and all(map(_is_integer, value))
        )
        return None if value is None else tuple(value)

    def rows(self, key: str, columns: int, row_count: int | None = None) -> list[list[float]] | None:
        """Take a list of rows of finite numbers, this many per row, and this many rows."""
        return self._take(
            key,
            f"{'a list of' if row_count is None else row_count} rows of {columns} finite numbers",
            lambda value: (
                isinstance(value, list)
                and (row_count is None or len(value) == row_count)
                and all(_is_list(row, columns) and all(map(_is_number, row)) for row in value)
            ),
        )

    def numbers(self, key: str) -> float | list[float] | None:
        """Take a finite number, or a list of them."""
        return self._take(
            key,
            "a finite number, or a list of them",
            lambda value: _is_number(value) or (isinstance(value, list) and all(map(_is_number, value))),
        )

    def table(self, key: str) -> TomlTable | None:
        """Take a table."""
        value = self._take(key, "a table", lambda value: isinstance(value, dict))
        return None if value is None else TomlTable(f"{self.name.rstrip(']')}.{key}]", value)

    def rest_as_numbers(self, keys: Iterable[str]) -> dict[str, float]:
        """Take numbers by some keys, as far as they are there, and refuse all others."""
        keys = tuple(keys)
        refuse_unknown(self._values, (*self._known, *keys), self.name)
        return {key: number for key in keys if (number := self.number(key)) is not None}

    def refuse_rest(self) -> None:
        """Raise `SceneError` for a key that was not taken."""
        refuse_unknown(self._values, self._known, self.name)

    def _take(self, key: str, expected: str, is_valid: Callable[[Any], bool]) -> Any:
        self._known.append(key)
        if key not in self._values:
            return None
        value = self._values.pop(key)
        if not is_valid(value):
            raise SceneError(f"{self.name} {key} must be {expected}, not {_show(value)}")
        return value


def refuse_unknown(given: Iterable[str], known: Iterable[str], where: str) -> None:
    """Raise `SceneError` for the first key that is not known."""
    known = list(known)
    for key in given:
        if key not in known:
            raise SceneError(f"{where} has an unknown key '{key}'; known are {', '.join(known)}")


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) <= _MAX_INTEGER


def _is_number(value: Any) -> bool:
    return _is_integer(value) or (isinstance(value, float) and math.isfinite(value))


def _is_list(value: Any, length: int) -> bool:
    return isinstance(value, list) and len(value) == length


def _is_vector(value: Any) -> bool:
    return _is_list(value, 3) and all(map(_is_number, value))


def _show(value: Any) -> str:
    """Return the beginning of a wrong value."""
    try:
        return repr(value)[:_MAX_SHOWN]
    except ValueError:  # Python does not print integers of many thousand digits
        return "a number of many digits"


Materials: TypeAlias = Mapping[str, Material]
"""Materials by their labels."""

NO_MATERIALS: Materials = MappingProxyType({})

_NUMBERS = ("alpha", "alpha_cutoff", "metallic", "roughness", "ior", "transmission", "normal_scale")
_COLOURS = ("base_colour", "emission")
# Whether their pixels are colours, which are sRGB, or numbers.
_TEXTURES = {
    "base_colour_texture": True,
    "metallic_roughness_texture": False,
    "emission_texture": True,
    "normal_texture": False,
}


def read_materials(tables: Any, folder: Path) -> Materials:
    """Return the materials of a scene file.

    Parameters
    ----------
    tables : list of dict
        The value of the key ``material``, as `tomllib` reads it.
    folder : Path
        Of the scene file: paths of textures count from there.

    Raises
    ------
    SceneError
        A material without a label, or with that of another; an unknown key or an invalid value; a texture that cannot
        be read.
    """
    if not isinstance(tables, list) or not tables or not all(isinstance(values, dict) for values in tables):
        raise SceneError("materials are tables of their own: write [[material]] above the keys of each")
    textures: dict[tuple[Path, bool], Texture] = {}
    materials: dict[str, Material] = {}
    for number, values in enumerate(tables, 1):
        table = TomlTable(f"[material {number}]", values)
        label = table.text("label")
        if label is None or not label.strip():
            raise SceneError(f"{table.name} needs a label, by which objects name it")
        if label in materials:
            raise SceneError(f"{table.name} has the label '{label}' of another material: labels are given once")
        materials[label] = _read_material(label, table, folder, textures)
    return materials


def take_material(table: TomlTable, materials: Materials) -> Material | None:
    """Take the material of an object or a mesh: the label of one of the scene file, or none."""
    label = table.text("material")
    if label is None:
        return None
    if label not in materials:
        known = ", ".join(f"'{name}'" for name in materials) or "none"
        raise SceneError(
            f"{table.name} has the material '{label}', but no [[material]] has this label: there are {known}"
        )
    return materials[label]


def _read_material(label: str, table: TomlTable, folder: Path, textures: dict[tuple[Path, bool], Texture]) -> Material:
    values: dict[str, Any] = {name: table.number(name) for name in _NUMBERS}
    values |= {name: table.vector(name) for name in _COLOURS}
    names = {name: table.text(name) for name in _TEXTURES}
    table.refuse_rest()
    for name, file in names.items():
        if file is not None:
            key = folder / file, _TEXTURES[name]
            if key not in textures:
                textures[key] = _read_texture(*key, f"{table.name} {name}")
            values[name] = textures[key]
    try:
        return Material(label, **{name: value for name, value in values.items() if value is not None})
    except MeshError as error:
        raise SceneError(f"{table.name} '{label}': {error}") from None


def _read_texture(path: Path, is_srgb: bool, where: str) -> Texture:
    """Return the texture of a file; raise `SceneError` if it cannot be read."""
    try:
        return Texture(path.name, decode_image(read_regular(path)), is_srgb)
    except FileNotFoundError:
        raise SceneError(f"{where}: {path}: no such file") from None
    except OSError as error:
        raise SceneError(f"{where}: {path}: the file cannot be read: {error.strerror or error}") from None
    except Exception as error:  # decoders raise anything
        raise SceneError(f"{where}: {path}: the file cannot be used as a texture: {error}") from None
