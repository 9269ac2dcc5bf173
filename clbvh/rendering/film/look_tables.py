"""How surfaces look, as the device takes it: one table for each kind of value, over all geometries; see cl/looks/."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...device.session import DeviceSession
from ...errors import SceneError
from ...geometry import Mesh
from ...geometry.appearance.appearance import Appearance
from ...geometry.appearance.material import Material, Texture
from ...geometry.smooth_normals import find_tangents, smooth_normals_by_angle
from ...geometry.spheres import Shape
from ...layouts.pack_normals import pack_normals, pack_tangents
from ...structs import LOOK, MATERIAL, TEXTURE, TEXTURE_WRAPS
from .light_tables import is_drawable_light

# A table without rows still needs a buffer.
_EMPTY_ROWS = 1

_CORNERS = 3

# The alpha of 8-bit colours that nothing shows through.
_OPAQUE = 255


class Looks(NamedTuple):
    """The shapes of a picture and how they are placed, as far as their looks depend on it.

    Attributes
    ----------
    shapes : sequence of Mesh or Spheres
    shape_ids : (n,) int
        The shape of each instance.
    colours : (n, 3) float
        Linear colours of instances, instead of those of their materials; NaN: none.
    """

    shapes: Sequence[Shape]
    shape_ids: NDArray[np.integer]
    colours: NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class LookTables:
    """The tables, by the names of the kernels' arguments.

    Attributes
    ----------
    arrays : dict of str to array
    materials : tuple of Material
        By the numbers in the tables.
    """

    arrays: dict[str, NDArray[Any]]
    materials: tuple[Material, ...]

    def upload(self, session: DeviceSession) -> dict[str, Any]:
        """Put the tables on the device; return the buffers by the names of the arguments."""
        return {name: session.upload(array) for name, array in self.arrays.items()}


def has_cutouts(shapes: Sequence[Shape]) -> bool:
    """Return whether any surface has an alpha below 1."""
    appearances = [shape.appearance for shape in shapes if shape.appearance is not None]
    # Shapes share materials.
    materials = {material for appearance in appearances for material in appearance.materials}
    return any(map(_is_cut_out, materials)) or any(
        appearance.colours is not None and bool((appearance.colours[..., 3] < _OPAQUE).any())
        for appearance in appearances
    )


def _is_cut_out(material: Material) -> bool:
    texture = material.base_colour_texture
    return material.alpha < 1.0 or (texture is not None and bool((texture.pixels[..., 3] < _OPAQUE).any()))


def make_look_tables(looks: Looks, is_light: NDArray[np.bool_], crease_angle: float) -> LookTables:
    """Return the tables of a scene.

    Parameters
    ----------
    looks : Looks
    is_light : (n,) bool
        Instances whose emitting primitives paths draw, see `find_lights`.
    crease_angle : float
        Degrees. Meshes without normals are shaded smoothly over edges that turn by less; 0: over none.
    """
    tables = _Tables()
    rows = np.zeros(len(looks.shapes), LOOK)
    for number in np.unique(looks.shape_ids).tolist():
        tables.add(looks.shapes[number], rows[number : number + 1], crease_angle)
    placed = rows[np.asarray(looks.shape_ids)]
    has_colour = ~np.isnan(looks.colours).any(axis=1)
    placed["has_colour"] = has_colour
    placed["is_light"] = is_light
    placed["colour"][has_colour] = looks.colours[has_colour]
    return tables.finish(placed)


class _Tables:
    """Tables that grow by one geometry at a time."""

    def __init__(self) -> None:
        self._parts: dict[str, list[NDArray[Any]]] = {
            "corner_normals": [], "corner_colours": [], "corner_uvs": [], "material_ids": [],
        }  # fmt: skip
        self._counts = dict.fromkeys(self._parts, 0)
        # Where the values of an array begin, by its identity: shapes that differ in their materials share them. The
        # shapes keep the arrays alive.
        self._begins: dict[tuple[str, int], int] = {}
        # Number 0 is that of shapes that have none; pictures give it the surface colour of their scene.
        self._materials = [Material()]
        self._numbers: dict[Material, int] = {}

    def add(self, shape: Shape, row: NDArray[np.void], crease_angle: float) -> None:
        """Append a geometry's values, and fill its row of `structs.LOOK`."""
        appearance: Appearance | None = shape.appearance
        for name in ("first_normal", "first_tangent", "first_colour", "first_uv", "first_material_id"):
            row[name] = -1
        if isinstance(shape, Mesh):
            self._add_normals(shape, row, crease_angle)
        if appearance is None:
            return
        if appearance.colours is not None:
            packed = np.ascontiguousarray(appearance.colours).view("<u4").reshape(-1).astype(np.uint32)
            if not isinstance(shape, Mesh):
                packed = np.repeat(packed, _CORNERS)
            row["first_colour"] = self._append("corner_colours", packed)
        if appearance.uvs is not None:
            uvs = appearance.uvs
            row["first_uv"] = self._share("corner_uvs", uvs, lambda: uvs.reshape(-1).astype(np.float32))
        if appearance.materials:
            numbers = np.array([self._number(material) for material in appearance.materials], np.int32)
            row["material_id"] = numbers[0]
            if appearance.material_ids is not None and len(numbers) > 1:
                row["first_material_id"] = self._append("material_ids", numbers[appearance.material_ids])

    def _add_normals(self, mesh: Mesh, row: NDArray[np.void], crease_angle: float) -> None:
        """Append the normals of a mesh, and its tangents if a texture bends the normals."""
        appearance = mesh.appearance
        given = appearance.normals if appearance is not None else None
        uvs = _find_bent_uvs(appearance)
        if given is None and uvs is None and crease_angle == 0.0:
            return

        def find() -> NDArray[np.float32]:
            return smooth_normals_by_angle(mesh, crease_angle) if given is None else given

        source = mesh.local_vertices if given is None else given
        row["first_normal"] = self._share("corner_normals", source, lambda: pack_normals(find().reshape(-1, _CORNERS)))
        if uvs is not None:
            tangents = find_tangents(mesh, find(), uvs).reshape(-1, _CORNERS + 1)
            row["first_tangent"] = self._append("corner_normals", pack_tangents(tangents))

    def finish(self, looks: NDArray[np.void]) -> LookTables:
        """Return the tables."""
        textures = TextureTables()
        materials = np.zeros(len(self._materials), MATERIAL)
        for number, material in enumerate(self._materials):
            _fill_material(materials[number : number + 1], material, textures)
        arrays = {"looks": looks, "materials": materials, **textures.arrays()}
        for name, parts in self._parts.items():
            dtype = np.float32 if name == "corner_uvs" else np.int32 if name == "material_ids" else np.uint32
            arrays[name] = np.concatenate(parts) if parts else np.zeros(_EMPTY_ROWS, dtype)
        return LookTables(arrays, tuple(self._materials))

    def _share(self, name: str, source: NDArray[Any], make: Callable[[], NDArray[Any]]) -> int:
        key = name, id(source)
        if key not in self._begins:
            self._begins[key] = self._append(name, make())
        return self._begins[key]

    def _append(self, name: str, values: NDArray[Any]) -> int:
        begin = self._counts[name]
        self._parts[name].append(values)
        self._counts[name] += len(values)
        return begin

    def _number(self, material: Material) -> int:
        # A file's material that equals the default one keeps its own colour.
        number = self._numbers.setdefault(material, len(self._materials))
        if number == len(self._materials):
            self._materials.append(material)
        return number


def has_normal_maps(shapes: Sequence[Shape]) -> bool:
    """Return whether a texture bends the normals of any mesh."""
    return any(isinstance(shape, Mesh) and _find_bent_uvs(shape.appearance) is not None for shape in shapes)


def _find_bent_uvs(appearance: Appearance | None) -> NDArray[np.float32] | None:
    """Return texture coordinates by which a texture bends normals, None if none does."""
    if appearance is None or all(material.normal_texture is None for material in appearance.materials):
        return None
    return appearance.uvs


def _fill_material(row: NDArray[np.void], material: Material, textures: TextureTables) -> None:
    row["base_colour"], row["emission"] = material.base_colour, material.emission
    for name in ("alpha", "metallic", "roughness", "ior", "transmission", "normal_scale"):
        row[name] = getattr(material, name)
    row["is_light"] = is_drawable_light(material)
    row["alpha_cutoff"] = -1.0 if material.alpha_cutoff is None else material.alpha_cutoff
    for name in ("base_colour_texture", "metallic_roughness_texture", "emission_texture", "normal_texture"):
        row[name] = textures.number(getattr(material, name))


class TextureTables:
    """Textures, each once."""

    def __init__(self) -> None:
        self._numbers: dict[int, int] = {}  # by the identity of a texture, which `_textures` keeps alive
        self._textures: list[Texture] = []

    def number(self, texture: Texture | None) -> int:
        """Return the number of a texture, -1 for None."""
        if texture is None:
            return -1
        if id(texture) not in self._numbers:
            self._numbers[id(texture)] = len(self._textures)
            self._textures.append(texture)
        return self._numbers[id(texture)]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the tables by the names of the kernels' arguments.

        Raises
        ------
        SceneError
            The textures have more texels than the device counts.
        """
        rows = np.zeros(max(len(self._textures), 1), TEXTURE)
        counts = [texture.pixels.shape[0] * texture.pixels.shape[1] for texture in self._textures]
        most = np.iinfo(np.int32).max
        if sum(counts) > most:
            raise SceneError(f"the textures have {sum(counts):,} pixels, and the device counts up to {most:,}")
        first = 0
        for row, texture, count in zip(rows, self._textures, counts, strict=False):
            row["first_texel"], row["is_srgb"] = first, texture.is_srgb
            row["height"], row["width"] = texture.pixels.shape[:2]
            row["wrap"] = [TEXTURE_WRAPS[wrap] for wrap in texture.wrap]
            first += count
        texels = [np.ascontiguousarray(texture.pixels).view("<u4").reshape(-1) for texture in self._textures]
        return {
            "textures": rows,
            "texels": np.concatenate(texels).astype(np.uint32) if texels else np.zeros(1, np.uint32),
            "decoded_srgb": _decode_srgb(),
        }


def _decode_srgb() -> NDArray[np.float32]:
    """Return (256,) float32: the linear value of each 8-bit sRGB value (IEC 61966-2-1)."""
    encoded = np.arange(256) / 255.0
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4).astype(np.float32)
