"""The `[[material]]` tables of a scene file become `Material` values by their labels, with their textures read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

from ..errors import MeshError, SceneError
from ..geometry.appearance.material import Material
from ..geometry.appearance.texture import Texture
from ..geometry.loading.texture_files import decode_image
from ..support.regular_file import read_regular
from .toml_table import TomlTable

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
