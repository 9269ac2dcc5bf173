"""A scene as one file. Its content is not trusted: a damaged or forged file is refused, whatever sizes it claims.

The file is an NPZ archive of numpy without compression. Its first member is a text, the fields of `_Text` as JSON in
UTF-8; the others are arrays:

    texture_0, ...                                  the pixels of textures
    geometry_0_vertices, geometry_0_faces           of a mesh
    geometry_0_centres, geometry_0_radii            of spheres
    geometry_0_normals, geometry_0_uvs, ...         of the `Appearance` of geometry 0
    transforms, colours, geometry_ids, masks, material_ids      of all instances, as `SceneState` has them
    settings_...                                    those of the caller's settings that are arrays

Local coordinates and trees are not stored: they follow from the arrays. Each member has a checksum, and no two of them
share bytes of the file.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from ..errors import MeshError, SceneError, shorten_message
from ..geometry.appearance.appearance import Appearance
from ..geometry.appearance.material import Material, Texture
from ..geometry.mesh import Mesh
from ..geometry.spheres import Shape, Spheres
from ..support.archive import begins_with_member, read_members
from ..support.files import open_regular, read_errors_as, write_atomically
from ..support.memory import check_memory
from .names import Named
from .state import SAVED_SCENE, SceneState
from .transforms import check_transforms

FORMAT_VERSION = 1

_Kind = Literal["mesh", "spheres"]
# Class and arrays of each kind of shape.
_KINDS: dict[_Kind, tuple[type[Shape], tuple[str, str]]] = {
    "mesh": (Mesh, ("vertices", "faces")),
    "spheres": (Spheres, ("centres", "radii")),
}
_LOOKS_ARRAYS = "normals", "uvs", "colours", "material_ids"
# Shape of a row, and dtype, of each array over all instances.
_INSTANCE_ARRAYS: dict[str, tuple[tuple[int, ...], type]] = {
    "transforms": ((4, 4), np.float64),
    "colours": ((3,), np.float64),
    "geometry_ids": ((), np.int32),
    "masks": ((), np.uint32),
    "material_ids": ((), np.int32),
}
_SETTING = "settings_"


@cache
def material_table(texture: Any, name: str = "name") -> Any:
    """Return a class with the fields of `Material`, but another type of textures; `name` is the key of its name."""
    types = get_type_hints(Material)
    fields = [
        (field.name, texture | None if field.name.endswith("_texture") else types[field.name], field.default)
        for field in dataclasses.fields(Material)[1:]
    ]
    return msgspec.defstruct(
        "Material", [("name", str, msgspec.field(name=name)), *fields], kw_only=True, forbid_unknown_fields=True
    )


def material_of_table(table: Any, read_texture: Callable[[str, Any], Texture]) -> Material:
    """Return the material of a table; `read_texture` returns the texture of a field of this name and value."""
    values = msgspec.structs.asdict(table)
    for name, value in values.items():
        if name.endswith("_texture") and value is not None:
            values[name] = read_texture(name, value)
    return Material(**values)


class _Texture(Struct, forbid_unknown_fields=True):
    name: str
    is_srgb: bool
    wrap: tuple[str, str]
    filter: str = "linear"


_Material = material_table(Annotated[int, Meta(ge=0)])


class _Geometry(Struct, forbid_unknown_fields=True):
    kind: _Kind
    name: str
    shape_name: str
    parts: list[tuple[str, int, int]]
    materials: list[_Material]  # type: ignore[valid-type]


class _Text(Struct, forbid_unknown_fields=True):
    format: int
    geometries: list[_Geometry]
    textures: list[_Texture]
    materials: list[_Material]  # type: ignore[valid-type]  # of instances
    instance_names: list[str]
    settings: dict[str, Any]


def write_scene(path: str | os.PathLike[str], state: SceneState, settings: dict[str, Any]) -> None:
    """Write a scene into a file, which appears complete or not at all.

    Parameters
    ----------
    path : str or path
        A file of this name is replaced.
    state : SceneState
    settings : dict
        Values are texts, numbers, lists and dicts; arrays at the top level alone.

    Raises
    ------
    ConfigError
        The folder does not exist, the path is a folder, or is no path at all.
    """
    looks = [shape.appearance or Appearance() for shape in state.shapes]
    materials = chain(*(look.materials for look in looks), state.materials)
    textures = dict.fromkeys(texture for material in materials for texture in material.textures)
    numbers = dict(zip(textures, range(len(textures)), strict=True))
    arrays: dict[str, Any] = {f"texture_{number}": texture.pixels for texture, number in numbers.items()}
    geometries = []
    for number, (shape, name, look) in enumerate(zip(state.shapes, state.names, looks, strict=True)):
        kind: _Kind = "mesh" if isinstance(shape, Mesh) else "spheres"
        shape_arrays = {array: getattr(shape, array) for array in _KINDS[kind][1]}
        shape_arrays |= {array: getattr(look, array) for array in _LOOKS_ARRAYS}
        arrays |= {f"geometry_{number}_{array}": values for array, values in shape_arrays.items() if values is not None}
        parts: list[tuple[str, int, int]] = [*shape.parts] if isinstance(shape, Mesh) else []
        described = [_describe(material, numbers) for material in look.materials]
        geometries.append(_Geometry(kind, name, str(shape.name), parts, described))
    text = _Text(
        FORMAT_VERSION,
        geometries,
        [_Texture(str(texture.name), texture.is_srgb, texture.wrap, texture.filter) for texture in textures],
        [_describe(material, numbers) for material in state.materials],
        list(state.instance_names),
        {name: value for name, value in settings.items() if not isinstance(value, np.ndarray)},
    )
    arrays |= {name: getattr(state, name) for name in _INSTANCE_ARRAYS}
    arrays |= {_SETTING + name: value for name, value in settings.items() if isinstance(value, np.ndarray)}
    first = {SAVED_SCENE: np.frombuffer(json.dumps(text, default=msgspec.structs.asdict).encode(), np.uint8)}
    write_atomically(path, lambda file: np.savez(file, **first | arrays))


def _describe(material: Material, numbers: dict[Texture, int]) -> dict[str, Any]:
    """Return the name of a material, and the values that differ from those of a material without arguments."""
    values = {field.name: getattr(material, field.name) for field in dataclasses.fields(Material)}
    changed = {name: value for name, value in values.items() if name == "name" or value != getattr(Material, name)}
    return {name: numbers[value] if isinstance(value, Texture) else value for name, value in changed.items()}


def read_scene(path: str | os.PathLike[str]) -> tuple[SceneState, dict[str, Any]]:
    """Return the scene of a file that `write_scene` wrote, and the settings that its caller gave.

    Raises
    ------
    SceneError
        The file cannot be read, is not a saved scene, has another format, is damaged or cut off, needs more memory than
        is free, or its content makes no scene. The message names the file and the first fault.

    Notes
    -----
    Takes memory for twice the file, whatever sizes it claims.
    """
    with read_errors_as(SceneError, path), open_regular(Path(path)) as file:
        size = os.fstat(file.fileno()).st_size
        if not begins_with_member(path, SAVED_SCENE):
            raise SceneError(f"{path}: this is not a saved scene")
        check_memory(f"{path}: a scene of {size:,} bytes", 2 * size, SceneError)
        try:
            return _read(read_members(file))
        except Exception as error:  # of zipfile, numpy, json and msgspec, and our own
            detail = shorten_message(error)
            fault = f"the file is damaged or was cut off ({type(error).__name__}: {detail})"
            if isinstance(error, SceneError | MeshError | msgspec.ValidationError):
                fault = f"the file makes no scene: {detail}"
            raise SceneError(f"{path}: {fault}: save the scene again") from error


def _read(arrays: dict[str, NDArray[Any]]) -> tuple[SceneState, dict[str, Any]]:
    values = json.loads(arrays[SAVED_SCENE].tobytes())
    version = values.get("format") if isinstance(values, dict) else None
    if version != FORMAT_VERSION:
        raise SceneError(f"it has the format {version!r}, and this version of clbvh reads format {FORMAT_VERSION}")
    text = msgspec.convert(values, _Text)
    # An array is dropped once it is used, so that a large scene does not need memory for both.
    textures = [
        Texture(entry.name, arrays.pop(f"texture_{number}"), entry.is_srgb, entry.wrap, entry.filter)
        for number, entry in enumerate(text.textures)
    ]

    def make_materials(tables: list[Any]) -> tuple[Material, ...]:
        return tuple(material_of_table(table, lambda _, number: textures[number]) for table in tables)

    shapes: list[Shape] = []
    for number, geometry in enumerate(text.geometries):
        kind, array_names = _KINDS[geometry.kind]
        shape_arrays = [arrays.pop(f"geometry_{number}_{name}") for name in array_names]
        looks: dict[str, Any] = {name: arrays.pop(f"geometry_{number}_{name}", None) for name in _LOOKS_ARRAYS}
        looks["materials"] = make_materials(geometry.materials)
        if kind is Mesh:
            appearance = Appearance(**looks)
            looks = {"appearance": None if appearance.is_empty else appearance, "parts": geometry.parts}
        else:
            del looks["normals"], looks["uvs"]
        shapes.append(kind.from_arrays(*shape_arrays, name=geometry.shape_name, **looks))
    instances = {name: arrays[name] for name in _INSTANCE_ARRAYS}
    _check_instances(instances, len(text.instance_names), len(shapes), len(text.materials))
    names_of = {
        "a geometry": tuple(geometry.name for geometry in text.geometries),
        "an instance": tuple(text.instance_names),
    }
    for what, names in names_of.items():
        taken = Named[None](what)
        for name in names:
            taken[taken.check(name)] = None
    state = SceneState(
        shapes=tuple(shapes),
        names=names_of["a geometry"],
        instance_names=names_of["an instance"],
        materials=make_materials(text.materials),
        **instances,
    )
    settings = {name.removeprefix(_SETTING): array for name, array in arrays.items() if name.startswith(_SETTING)}
    return state, text.settings | settings


def _check_instances(arrays: dict[str, NDArray[Any]], count: int, geometry_count: int, material_count: int) -> None:
    for name, (shape, dtype) in _INSTANCE_ARRAYS.items():
        if arrays[name].shape != (count, *shape) or arrays[name].dtype != dtype:
            raise SceneError(f"its array '{name}' does not fit {count:,} instances: {arrays[name].shape}")
    arrays["transforms"] = check_transforms(arrays["transforms"], lambda index: f"the transform of instance {index}")
    colours = arrays["colours"]
    is_colour = np.isfinite(colours).all(axis=1) | np.isnan(colours).all(axis=1)
    if not is_colour.all():
        raise SceneError(f"the colour of instance {np.argmin(is_colour)} is not three finite numbers")
    for name, least, most in (("geometry_ids", 0, geometry_count), ("material_ids", -1, material_count)):
        wrong = np.flatnonzero((arrays[name] < least) | (arrays[name] >= most))
        if len(wrong):
            raise SceneError(f"instance {wrong[0]} has {arrays[name][wrong[0]]} among its {name}, of {most:,}")
