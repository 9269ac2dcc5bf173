"""Appearances in the file of a scene: their numbers and names in its text, their arrays behind those of their shape.

Owns the keys of appearances, materials and textures. Nothing that is read is trusted. Textures are stored once, however
many materials and shapes share one.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from typing import Any

from numpy.typing import NDArray

from ..errors import MeshError, SceneError
from ..geometry.appearance.appearance import Appearance
from ..geometry.appearance.material import Material
from ..geometry.appearance.texture import Texture

# Takes the next array of a file, of a shape and a dtype.
Take = Callable[[tuple[int, ...], str], NDArray[Any]]

# The arrays of an appearance in the order of the file: the shapes behind the first axis, of triangles, and the dtypes.
_ARRAYS: dict[str, tuple[tuple[int, ...], str]] = {
    "normals": ((3, 3), "<f4"),
    "uvs": ((3, 2), "<f4"),
    "colours": ((3, 4), "|u1"),
    "material_ids": ((), "<i4"),
}
_SPHERE_COLOURS = (4,)
_TEXTURE_FIELDS = tuple(each.name for each in dataclasses.fields(Material) if each.name.endswith("_texture"))
_FIELDS = {each.name for each in dataclasses.fields(Material)}


def list_textures(appearances: Iterable[Appearance | None], others: Iterable[Material] = ()) -> list[Texture]:
    """Return the textures of appearances and of other materials, each once, in the order of their first uses."""
    materials = (material for appearance in appearances if appearance is not None for material in appearance.materials)
    return list(dict.fromkeys(texture for material in chain(materials, others) for texture in material.textures))


def describe_texture(texture: Texture) -> dict[str, Any]:
    """Return what the text says of a texture, whose pixels are an array."""
    return {
        "name": str(texture.name),
        "width": texture.width,
        "height": texture.height,
        "is_srgb": texture.is_srgb,
        "wrap": list(texture.wrap),
    }


def read_texture(table: Any, take: Take) -> Texture:
    """Return a texture; raise `SceneError` or `MeshError` if the text describes none."""
    keys = {"name", "width", "height", "is_srgb", "wrap"}
    if not isinstance(table, dict) or set(table) != keys or not isinstance(table["name"], str):
        raise SceneError("its text has a texture that is none")
    sides = (table["height"], table["width"])
    if not all(isinstance(side, int) and not isinstance(side, bool) and side > 0 for side in sides):
        raise SceneError("its text has a texture without pixels")
    return Texture(table["name"], take((*sides, 4), "|u1"), table["is_srgb"], table["wrap"])


def describe_appearance(appearance: Appearance, textures: list[Texture]) -> dict[str, Any]:
    """Return what the text says of an appearance: the names of its arrays, and its materials."""
    return {
        "arrays": [name for name in _ARRAYS if getattr(appearance, name) is not None],
        "materials": describe_materials(appearance.materials, textures),
    }


def describe_materials(materials: Iterable[Material], textures: list[Texture]) -> list[dict[str, Any]]:
    """Return what the text says of materials."""
    numbers = {texture: number for number, texture in enumerate(textures)}
    return [_describe_material(material, numbers) for material in materials]


def read_materials(tables: Any, textures: Sequence[Texture]) -> tuple[Material, ...]:
    """Return materials; raise `SceneError` if the text describes none."""
    if not isinstance(tables, list):
        raise SceneError("its text has materials that are no list")
    return tuple(_read_material(each, textures) for each in tables)


def list_appearance_arrays(appearance: Appearance | None) -> Iterator[tuple[NDArray[Any], str]]:
    """Yield the arrays of an appearance and their dtypes in the file."""
    for name, (_, dtype) in _ARRAYS.items():
        if appearance is not None and (values := getattr(appearance, name)) is not None:
            yield values, dtype


def read_appearance(
    table: Any, prim_count: int, take: Take, textures: list[Texture], *, has_corners: bool
) -> Appearance:
    """Return an appearance; raise `SceneError` or `MeshError` if the text describes none of such a shape."""
    if not isinstance(table, dict) or set(table) != {"arrays", "materials"}:
        raise SceneError("its text has an appearance that is none")
    names = table["arrays"]
    if not isinstance(names, list) or not all(isinstance(name, str) and name in _ARRAYS for name in names):
        raise SceneError("its text has an appearance with unknown arrays")
    if not has_corners and not {"colours", "material_ids"}.issuperset(names):
        raise SceneError("its text has spheres with arrays of corners")
    materials = read_materials(table["materials"], textures)
    arrays = {}
    for name, (shape, dtype) in _ARRAYS.items():
        if name in names:
            is_sphere_colour = name == "colours" and not has_corners
            arrays[name] = take((prim_count, *(_SPHERE_COLOURS if is_sphere_colour else shape)), dtype)
    return Appearance(**arrays, materials=materials)


def _describe_material(material: Material, numbers: dict[Texture, int]) -> dict[str, Any]:
    """Return the values that differ from those of a material without arguments."""
    described = {}
    for each in dataclasses.fields(Material):
        if (value := getattr(material, each.name)) != each.default:
            described[each.name] = numbers[value] if isinstance(value, Texture) else value
    return described


def _read_material(table: Any, textures: Sequence[Texture]) -> Material:
    if not isinstance(table, dict) or not set(table) <= _FIELDS:
        raise SceneError("its text has a material that is none")
    values = dict(table)
    for name in _TEXTURE_FIELDS:
        if name in values:
            number = values[name]
            if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < len(textures):
                raise SceneError(f"a material has the texture {str(number)[:20]}, but there are {len(textures)}")
            values[name] = textures[number]
    try:
        return Material(**values)
    except MeshError as error:
        raise SceneError(f"a material of its text cannot be used: {error}") from error
