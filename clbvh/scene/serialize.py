"""A scene as one file. Its content is not trusted: a damaged or forged file is refused, whatever sizes it claims.

The file, all numbers little-endian:

    bytes   field
    8       MAGIC
    4       format version, uint32
    4       zero
    8       bytes of the text T, a multiple of 8, uint64
    8       bytes of the arrays A, a multiple of 8, uint64
    16      digest of everything behind the header
    16      digest of the header so far
    T       the text: JSON in UTF-8, with spaces at its end
    A       the arrays, each with zeros up to a multiple of 8 bytes

The text is one object:

    geometries   a list of {kind: "mesh", name, shape_name, vertices: V, faces: F}
                        and {kind: "spheres", name, shape_name, count: n}
                        either with `appearance`, if it has one, see `read_appearance`; a mesh of several parts with
                        `parts`: a list of [name, begin, end]
    textures     a list of {name, width: w, height: h, is_srgb, wrap}
    materials    those of instances, if they have any of their own: a list, see `read_materials`
    instances    {count: n, names: a list of n texts}
    settings     an object of the caller

The arrays are, in this order: of each texture pixels (h, w, 4) uint8; of each mesh vertices (V, 3) float64 and faces
(F, 3) int32, of each spheres centres (n, 3) float64 and radii (n,) float64, each followed by the arrays of its
appearance; then of all instances transforms (n, 4, 4) float64, colours (n, 3) float64 with
NaN for those without, geometry ids (n,) int32, masks (n,) uint32 and, with `materials`, material ids (n,) int32, -1
for those without. Local coordinates and trees are not stored: they
follow from the arrays.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import MeshError, SceneError
from ..geometry.appearance.appearance import Appearance, check_fit
from ..geometry.appearance.material import Material, Texture
from ..geometry.mesh import Mesh
from ..geometry.spheres import Shape, Spheres
from ..support.files import as_path, check_target, open_regular, read_errors_as, write_atomically
from ..support.memory import check_memory
from .names import UniqueNames
from .state import SceneState
from .transforms import check_transforms

# The first byte is not text, and the line ends reveal a transfer that changed them (as in PNG).
MAGIC = b"\x8bSCN\r\n\x1a\n"
FORMAT_VERSION = 1

_DIGEST_BYTES = 16
_FACTS = struct.Struct("<8sIIQQ16s")
_HEADER_BYTES = _FACTS.size + _DIGEST_BYTES
_ALIGNMENT = 8
_MESH, _SPHERES = "mesh", "spheres"
_REMEDY = "save the scene again"


def write_scene(path: str | os.PathLike[str], state: SceneState, settings: dict[str, Any]) -> None:
    """Write a scene into a file, which appears complete or not at all.

    Parameters
    ----------
    path : str or path
        A file of this name is replaced.
    state : SceneState
    settings : dict
        Of texts, finite numbers, lists and dicts.

    Raises
    ------
    ConfigError
        The folder does not exist, the path is a folder, or is no path at all.
    """
    target = as_path(path)
    check_target(target)
    textures = list_textures((shape.appearance for shape in state.shapes), state.materials)
    document: dict[str, Any] = {
        "geometries": [_describe(shape, name, textures) for shape, name in zip(state.shapes, state.names, strict=True)],
        "textures": [describe_texture(texture) for texture in textures],
        "instances": {"count": state.instance_count, "names": state.instance_names},
        "settings": settings,
    }
    if state.materials:
        document["materials"] = describe_materials(state.materials, textures)
    text = json.dumps(document, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % _ALIGNMENT)
    digest, array_bytes = hashlib.sha256(text), 0
    for chunk in _list_chunks(state):
        digest.update(chunk)
        array_bytes += len(chunk)
    facts = _FACTS.pack(MAGIC, FORMAT_VERSION, 0, len(text), array_bytes, digest.digest()[:_DIGEST_BYTES])

    def write(file: BinaryIO) -> None:
        file.write(facts)
        file.write(_digest(facts))
        file.write(text)
        for chunk in _list_chunks(state):
            file.write(chunk)

    write_atomically(target, write)


def is_saved_scene(path: str | os.PathLike[str]) -> bool:
    """Return whether a file begins as those of `write_scene` do; False if it cannot be read."""
    try:
        with open_regular(Path(path)) as file:
            return file.read(len(MAGIC)) == MAGIC
    except (OSError, ValueError):
        return False


def read_scene(path: str | os.PathLike[str]) -> tuple[SceneState, dict[str, Any]]:
    """Return the scene of a file that `write_scene` wrote, and the settings that its caller gave.

    Raises
    ------
    SceneError
        The file cannot be read, is not a saved scene, has another format, is damaged or cut off, needs more memory than
        is free, or its content makes no scene. The message names the file and the first fault.

    Notes
    -----
    Memory for twice the file, whatever sizes it claims.
    """
    with read_errors_as(SceneError, path), open_regular(Path(path)) as file:
        text_bytes, digest = _check_header(file, path)
        size = os.fstat(file.fileno()).st_size - _HEADER_BYTES
        check_memory(f"{path}: a scene of {size:,} bytes", 2 * size, SceneError)
        content = np.empty(size, np.uint8)
        if file.readinto(content.data) != size:
            raise _damaged(path)
    if _digest(content.data) != digest:
        raise _damaged(path)
    try:
        return _parse(content[:text_bytes].tobytes(), content[text_bytes:])
    except (SceneError, MeshError) as error:
        raise SceneError(f"{path}: the file is whole, but makes no scene: {error}: {_REMEDY}") from error


def get_item(table: object, key: str, kind: type) -> Any:
    """Return an item of an object of JSON; raise `SceneError` if it is missing or of another type."""
    if not isinstance(table, dict) or key not in table:
        raise SceneError(f"its text has no '{key}'")
    value: Any = table[key]
    is_right = isinstance(value, kind) and (kind is bool or not isinstance(value, bool))
    if not is_right or (kind is int and value < 0):
        raise SceneError(f"its text has a wrong '{key}'")
    return value


def _check_header(file: BinaryIO, path: str | os.PathLike[str]) -> tuple[int, bytes]:
    """Check the header and the file's size; return the bytes of the text and the digest of the rest."""
    header = file.read(_HEADER_BYTES)
    if not header.startswith(MAGIC):
        raise SceneError(f"{path}: this is not a saved scene")
    if len(header) < _HEADER_BYTES:
        raise _damaged(path)
    facts = header[: _FACTS.size]
    _, version, zero, text_bytes, array_bytes, digest = _FACTS.unpack(facts)
    if version != FORMAT_VERSION:
        raise SceneError(
            f"{path}: the scene is saved in format {version}, and this version of clbvh reads format {FORMAT_VERSION}: "
            f"{_REMEDY}"
        )
    size = os.fstat(file.fileno()).st_size
    if (
        header[_FACTS.size :] != _digest(facts)
        or zero != 0
        or text_bytes % _ALIGNMENT
        or size != _HEADER_BYTES + text_bytes + array_bytes
    ):
        raise _damaged(path)
    return text_bytes, digest


def _parse(text: bytes, data: NDArray[np.uint8]) -> tuple[SceneState, dict[str, Any]]:
    """Return the scene of a file whose digests are right; nothing else is trusted."""
    try:
        document = json.loads(text.decode())
    except (ValueError, RecursionError) as error:
        raise SceneError(f"its text is no JSON ({error})") from error
    arrays = _Arrays(data)
    shapes: list[Shape] = []
    geometries = get_item(document, "geometries", list)
    # Scenes that were saved before there were looks have no such list.
    tables = get_item(document, "textures", list) if "textures" in document else []
    textures = [read_texture(table, arrays.take) for table in tables]
    names = UniqueNames("a geometry")
    for table in geometries:
        shapes.append(_read_shape(table, arrays, textures))
        names.check(name := get_item(table, "name", str))
        names.add(name)

    instances = get_item(document, "instances", dict)
    count = get_item(instances, "count", int)
    transforms = arrays.take((count, 4, 4), "<f8")
    colours = arrays.take((count, 3), "<f8")
    geometry_ids = arrays.take((count,), "<i4")
    masks = arrays.take((count,), "<u4")
    materials = read_materials(document.get("materials", []), textures)
    material_ids = arrays.take((count,), "<i4") if materials else np.full(count, -1)
    arrays.check_end()
    instance_names = UniqueNames("an instance")
    for name in get_item(instances, "names", list):
        instance_names.check(name)
        instance_names.add(name)
    if len(instance_names) != count:
        raise SceneError(f"it has {len(instance_names):,} names for {count:,} instances")
    wrong = np.flatnonzero((geometry_ids < 0) | (geometry_ids >= len(shapes)))
    if len(wrong):
        raise SceneError(f"instance {wrong[0]} is of geometry {geometry_ids[wrong[0]]}, but it has {len(shapes):,}")
    is_colour = np.isfinite(colours).all(axis=1) | np.isnan(colours).all(axis=1)
    if not is_colour.all():
        raise SceneError(f"the colour of instance {np.argmin(is_colour)} is not three finite numbers")
    if len(set(materials)) < len(materials):
        raise SceneError("two of its materials are equal")
    wrong = np.flatnonzero((material_ids < -1) | (material_ids >= len(materials)))
    if len(wrong):
        raise SceneError(f"instance {wrong[0]} has material {material_ids[wrong[0]]}, but it has {len(materials):,}")
    state = SceneState(
        shapes=tuple(shapes),
        names=tuple(names),
        geometry_ids=geometry_ids.astype(np.int32),
        transforms=check_transforms(transforms, lambda index: f"the transform of instance {index}"),
        masks=masks.astype(np.uint32),
        instance_names=tuple(instance_names),
        colours=colours.astype(np.float64),
        materials=materials,
        material_ids=material_ids.astype(np.int32),
    )
    return state, get_item(document, "settings", dict)


class _Arrays:
    """Takes one array after the other from the bytes of a file, and never more than there are."""

    def __init__(self, data: NDArray[np.uint8]) -> None:
        self._data = data
        self._begin = 0

    def take(self, shape: tuple[int, ...], dtype: str) -> NDArray[Any]:
        """Return the next array, a view."""
        size = np.dtype(dtype).itemsize
        for side in shape:  # Python's integers, which do not overflow
            size *= side
        end = self._begin + size
        if end > len(self._data):
            raise SceneError(f"its text tells of arrays of {end:,} bytes and more, but it has {len(self._data):,}")
        array = self._data[self._begin : end].view(dtype).reshape(shape)
        self._begin = end + -end % _ALIGNMENT
        return array

    def check_end(self) -> None:
        """Raise `SceneError` unless all bytes are taken."""
        if self._begin != len(self._data):
            raise SceneError(f"its text tells of arrays of {self._begin:,} bytes, but it has {len(self._data):,}")


def _read_shape(table: object, arrays: _Arrays, textures: list[Texture]) -> Shape:
    shape = _read_bare_shape(table, arrays)
    if isinstance(table, dict) and "appearance" in table:
        is_mesh, count = isinstance(shape, Mesh), shape.prim_count
        appearance = read_appearance(table["appearance"], count, arrays.take, textures, has_corners=is_mesh)
        check_fit(appearance, count, str(shape.name), has_corners=is_mesh)
        object.__setattr__(shape, "appearance", appearance)  # nobody else has the shape yet
    return shape


def _read_bare_shape(table: object, arrays: _Arrays) -> Shape:
    kind, name = get_item(table, "kind", str), get_item(table, "shape_name", str)
    if kind == _MESH:
        vertices = arrays.take((get_item(table, "vertices", int), 3), "<f8")
        faces = arrays.take((get_item(table, "faces", int), 3), "<i4")
        parts = get_item(table, "parts", list) if isinstance(table, dict) and "parts" in table else ()
        return Mesh.from_arrays(vertices, faces, name=name, parts=parts)
    if kind == _SPHERES:
        count = get_item(table, "count", int)
        return Spheres(arrays.take((count, 3), "<f8"), arrays.take((count,), "<f8"), name=name)
    raise SceneError(f"it has a geometry of the unknown kind {kind[:20]!r}")


def _describe(shape: Shape, name: str, textures: list[Texture]) -> dict[str, Any]:
    described: dict[str, Any] = {"name": name, "shape_name": str(shape.name)}
    if isinstance(shape, Mesh):
        described |= {"kind": _MESH, "vertices": len(shape.vertices), "faces": shape.face_count}
        if shape.parts:
            described["parts"] = shape.parts
    else:
        described |= {"kind": _SPHERES, "count": shape.prim_count}
    if shape.appearance is not None:
        described["appearance"] = describe_appearance(shape.appearance, textures)
    return described


def _list_chunks(state: SceneState) -> Iterator[memoryview | bytes]:
    """Yield the bytes of all arrays in the order of the file."""
    for array, dtype in _list_arrays(state):
        data = np.ascontiguousarray(array, dtype)
        # Not by `memoryview.cast`, which refuses an array without rows.
        yield data.reshape(-1).view(np.uint8).data
        yield bytes(-data.nbytes % _ALIGNMENT)


def _list_arrays(state: SceneState) -> Iterator[tuple[NDArray[Any], str]]:
    for texture in list_textures((shape.appearance for shape in state.shapes), state.materials):
        yield texture.pixels, "|u1"
    for shape in state.shapes:
        if isinstance(shape, Mesh):
            yield shape.vertices, "<f8"
            yield shape.faces, "<i4"
        else:
            yield shape.centres, "<f8"
            yield shape.radii, "<f8"
        yield from list_appearance_arrays(shape.appearance)
    yield state.transforms, "<f8"
    yield state.colours, "<f8"
    yield state.geometry_ids, "<i4"
    yield state.masks, "<u4"
    if state.materials:
        yield state.material_ids, "<i4"


def _damaged(path: str | os.PathLike[str]) -> SceneError:
    return SceneError(f"{path}: the file is damaged or was cut off: {_REMEDY}")


def _digest(data: bytes | memoryview) -> bytes:
    return hashlib.sha256(data).digest()[:_DIGEST_BYTES]


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
