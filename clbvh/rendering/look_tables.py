"""How surfaces look and what light they emit, as the device takes it: tables over all geometries.

One table for each kind of value, see cl/looks/; of the light, primitives that emit, by their power, see
cl/film/lights.cl.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry import Mesh
from ..geometry.appearance.appearance import Appearance, find_flat_normals
from ..geometry.appearance.material import OPAQUE, Material, Texture
from ..geometry.appearance.srgb import LUMINANCE, srgb_to_linear
from ..geometry.joined_shapes import JoinedMeshes, batch_small
from ..geometry.smooth_normals import MOST_SMOOTHED, find_tangents, smooth_normals_by_angle, smooth_small
from ..geometry.spheres import Shape
from ..layouts.pack_normals import pack_normals, pack_tangents
from ..structs import FLAT_FACE, LIGHT, LIGHT_CHOICE, LOOK, MATERIAL, TEXTURE, TEXTURE_WRAPS

# Spheres that a map stretches by more than this share are no lights that paths draw, as their area is not a sphere's.
_MOST_STRETCH = 1e-4

_MOST_LIGHTS = 2**24

# Rows of a table that kernels number.
_MOST_ROWS = np.iinfo(np.int32).max


@dataclass(frozen=True, eq=False)
class LightTables:
    """The tables of the light.

    Attributes
    ----------
    arrays : dict of str to array
        By the names of the kernels' arguments.
    power : float
        Sum of luminance times area, in local units.
    count : int
        Emitting primitives.
    """

    arrays: dict[str, NDArray[Any]]
    power: float
    count: int


def _emits_light(shape: Shape) -> NDArray[np.bool_]:
    """Return (m,) bool: whether each material of a shape emits light that paths may draw.

    That light is the same everywhere on the surface, and the surface is all there: the points of a light are drawn
    without regard to textures and alpha.
    """
    materials = () if shape.appearance is None else shape.appearance.materials
    return np.array([_is_drawable_light(each) for each in materials], bool)


def _is_drawable_light(material: Material) -> bool:
    """Return whether the light of a material depends neither on textures nor on alpha."""
    return any(material.emission) and material.emission_texture is None and material.is_opaque


def has_whole_colours(appearance: Appearance | None) -> bool:
    """Return whether no corner is transparent."""
    return appearance is None or appearance.colours is None or bool((appearance.colours[..., 3] == OPAQUE).all())


def find_lights(
    shapes: Sequence[Shape], geometry_ids: NDArray[np.integer], to_local: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return (n,) bool: the instances whose emitting primitives are in the tables; see `make_light_tables`."""
    emits = np.array([_emits_light(shape).any() and has_whole_colours(shape.appearance) for shape in shapes], bool)
    emits = emits[np.asarray(geometry_ids)]
    for number in np.flatnonzero(emits):
        if not isinstance(shapes[geometry_ids[number]], Mesh):
            stretches = np.linalg.svd(to_local[number, :3, :3], compute_uv=False)
            emits[number] = stretches[0] - stretches[2] <= _MOST_STRETCH * stretches[0]
    return emits


def make_light_tables(
    shapes: Sequence[Shape], geometry_ids: NDArray[np.integer], to_local: NDArray[np.float64]
) -> LightTables:
    """Return the tables of a scene.

    Parameters
    ----------
    shapes : sequence of Mesh or Spheres
    geometry_ids : (n,) int
        The shape of each instance.
    to_local : (n, 4, 4) float64
        From each instance's coordinates to the local ones of pictures.

    Raises
    ------
    SceneError
        More primitives emit light than the tables hold.
    """
    numbers = np.flatnonzero(find_lights(shapes, geometry_ids, to_local))
    listed = [_list_lights(shapes[geometry_ids[number]], to_local[number]) for number in numbers]
    lights, areas = map(np.concatenate, zip((np.zeros(0, LIGHT), np.zeros(0)), *listed, strict=True))
    if len(lights) > _MOST_LIGHTS:
        raise SceneError(f"{len(lights):,} primitives emit light, and there is room for {_MOST_LIGHTS:,}")
    luminances = lights["emission"].astype(np.float64) @ LUMINANCE
    powers = areas * luminances
    power = float(powers.sum())
    lights["density"] = luminances / power if power > 0 else 0
    # A table without rows still needs a buffer.
    arrays = {
        "lights": lights if len(lights) else np.zeros(1, LIGHT),
        "light_choices": make_alias_table(powers if power > 0 else np.ones(1)),
    }
    return LightTables(arrays, power, len(lights) if power > 0 else 0)


def _list_lights(shape: Shape, place: NDArray[np.float64]) -> tuple[NDArray[np.void], NDArray[np.float64]]:
    """Return the emitting primitives of an instance, and their areas in local units."""
    appearance = shape.appearance
    assert appearance is not None
    ids = np.zeros(shape.prim_count, np.int64) if appearance.material_ids is None else appearance.material_ids
    chosen = np.flatnonzero(_emits_light(shape)[ids])
    lights = np.zeros(len(chosen), LIGHT)
    lights["emission"] = np.array([material.emission for material in appearance.materials])[ids[chosen]]
    linear, shift = place[:3, :3], place[:3, 3]
    if isinstance(shape, Mesh):
        corners = shape.vertices[shape.faces[chosen]] @ linear.T + shift
        ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        normals = np.cross(ab, ac)
        doubled_areas = np.linalg.norm(normals, axis=1)
        lights["a"], lights["ab"], lights["ac"] = corners[:, 0], ab, ac
        lights["normal"] = normals / np.maximum(doubled_areas, np.finfo(float).tiny)[:, None]
        return lights, doubled_areas / 2
    radii = shape.radii[chosen] * np.cbrt(abs(np.linalg.det(linear)))
    lights["a"], lights["radius"] = shape.centres[chosen] @ linear.T + shift, radii
    return lights, 4 * np.pi * radii**2


# Weights are whole numbers whose mean is this one: sums of 2^24 of them are exact in 64 bits.
_MEAN = 2**32


def make_alias_table(weights: NDArray[np.float64]) -> NDArray[np.void]:
    """Return the table, (n,) `structs.LIGHT_CHOICE`.

    The probability of each thing is exact but for its rounding to a multiple of 2^-32 / n, and for the sum of all these
    roundings, which the largest one takes.

    The table is that of Vose's algorithm ("A linear algorithm for generating random numbers with a given distribution",
    1991), by prefix sums instead of lists: the things below the mean take what they lack from those above it, in order,
    and one that has given too much takes that from the next one.

    Parameters
    ----------
    weights : (n,) float64, 0 or more
        At least one of them above 0.
    """
    count = len(weights)
    # Divided first: the sum of the largest float64 numbers is none.
    shares = weights / weights.max()
    whole = np.rint(shares * (_MEAN * count / shares.sum())).astype(np.int64)
    whole[np.argmax(whole)] += _MEAN * count - int(whole.sum())

    below = np.flatnonzero(whole < _MEAN)
    above = np.flatnonzero(whole >= _MEAN)
    # What things lack that come before each one, and what has been given up to each one.
    lacks = np.concatenate([[0], np.cumsum(_MEAN - whole[below])])
    gifts = np.cumsum(whole[above] - _MEAN)

    keeps, aliases = whole.copy(), np.arange(count)
    aliases[below] = above[np.searchsorted(gifts, lacks[:-1], side="right")]
    # After its last gift, a thing may have less than the mean: what it lacks is taken from the next one.
    taken = lacks[np.searchsorted(lacks[:-1], gifts, side="left")]
    keeps[above] = _MEAN + gifts - taken
    aliases[above[:-1]] = above[1:]

    table = np.zeros(count, LIGHT_CHOICE)
    is_whole = keeps >= _MEAN
    table["threshold"] = np.where(is_whole, 0, keeps)
    table["alias"] = np.where(is_whole, np.arange(count), aliases)
    return table


_CORNERS = 3


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


def has_cutouts(shapes: Sequence[Shape]) -> bool:
    """Return whether any surface has an alpha below 1."""
    appearances = [shape.appearance for shape in shapes if shape.appearance is not None]
    # Shapes share materials.
    materials = {material for appearance in appearances for material in appearance.materials}
    return not (all(each.is_opaque for each in materials) and all(map(has_whole_colours, appearances)))


def make_look_tables(looks: Looks, is_light: NDArray[np.bool_], crease_angle: float) -> dict[str, NDArray[Any]]:
    """Return the tables of the surfaces of a scene, by the names of the kernels' arguments.

    Parameters
    ----------
    looks : Looks
    is_light : (n,) bool
        Instances whose emitting primitives paths draw, see `find_lights`.
    crease_angle : float
        Degrees. Meshes without normals are shaded smoothly over edges that turn by less; 0: over none.

    Raises
    ------
    SceneError
        The shapes have more normals, colours, texture coordinates or texels than the device counts.
    """
    tables = _Tables(crease_angle)
    rows = np.zeros(len(looks.shapes), LOOK)
    for name in ("first_normal", "first_tangent", "first_colour", "first_uv", "first_material_id"):
        rows[name] = -1
    numbers = np.unique(looks.shape_ids).tolist()
    tables.add_normals([looks.shapes[number] for number in numbers])
    for number in numbers:
        tables.add(looks.shapes[number], rows[number : number + 1])
    placed = rows[np.asarray(looks.shape_ids)]
    has_colour = ~np.isnan(looks.colours).any(axis=1)
    placed["has_colour"] = has_colour
    placed["is_light"] = is_light
    placed["colour"][has_colour] = looks.colours[has_colour]
    return tables.finish(placed)


# The last angle and the smooth normals of meshes that are alive: 36 bytes per face, 0.6 s for a million faces.
_known: WeakKeyDictionary[Mesh, tuple[float, NDArray[np.float32]]] = WeakKeyDictionary()


def find_corner_normals(mesh: Mesh, crease_angle: float) -> NDArray[np.float32] | None:
    """Return (F, 3, 3) float32: unit normals at the corners of faces; None for a mesh that is not smoothed."""
    if mesh.appearance is not None and mesh.appearance.normals is not None:
        return mesh.appearance.normals
    if _is_flat(mesh, crease_angle):
        return None
    angle, normals = _known.get(mesh, (-1.0, None))
    if normals is None or angle != crease_angle:
        normals = smooth_normals_by_angle(mesh, crease_angle)
        _known[mesh] = crease_angle, normals
    return normals


def find_all_corner_normals(shapes: Sequence[Shape], crease_angle: float) -> list[NDArray[np.float32] | None]:
    """Return the `find_corner_normals` of each shape, None of spheres; small meshes are smoothed together."""
    new = [
        shape
        for shape in shapes
        if isinstance(shape, Mesh)
        and _given_normals(shape) is None
        and not _is_flat(shape, crease_angle)
        and _known.get(shape, (None,))[0] != crease_angle
    ]
    for batch in batch_small(new):
        own = [new[number] for number in batch]
        ends = np.cumsum([mesh.face_count for mesh in own])
        smooth = np.split(smooth_small(JoinedMeshes.of(own), crease_angle), ends[:-1])
        _known.update((mesh, (crease_angle, normals)) for mesh, normals in zip(own, smooth, strict=True))
    return [find_corner_normals(shape, crease_angle) if isinstance(shape, Mesh) else None for shape in shapes]


def _is_flat(mesh: Mesh, crease_angle: float) -> bool:
    return crease_angle == 0.0 or mesh.face_count > MOST_SMOOTHED


class _Tables:
    """Tables that grow by one geometry at a time."""

    def __init__(self, crease_angle: float) -> None:
        self._crease_angle = crease_angle
        dtypes = {"corner_normals": "u4", "corner_colours": "u4", "corner_uvs": "f4", "material_ids": "i4"}
        self._parts: dict[str, list[NDArray[Any]]] = {name: [np.zeros(0, dtype)] for name, dtype in dtypes.items()}
        self._counts = dict.fromkeys(dtypes, 0)
        # Where the values of arrays begin, by their identity: shapes that differ in their materials share them. The
        # shapes keep the arrays alive.
        self._begins: dict[tuple[Any, ...], int] = {}
        # Number 0 is that of shapes that have none; pictures give it the surface colour of their scene. A file's
        # material that equals the default one keeps its own colour.
        self._numbers: dict[Material, int] = {}

    def add(self, shape: Shape, row: NDArray[np.void]) -> None:
        """Append a geometry's values, and fill its row of `structs.LOOK`."""
        appearance: Appearance | None = shape.appearance
        if isinstance(shape, Mesh):
            self._add_normals(shape, row)
        if appearance is None:
            return
        if appearance.colours is not None:
            packed = np.ascontiguousarray(appearance.colours).view("<u4").reshape(-1).astype(np.uint32)
            if not isinstance(shape, Mesh):
                packed = np.repeat(packed, _CORNERS)
            row["first_colour"] = self._append("corner_colours", packed)
        if (uvs := appearance.uvs) is not None:
            row["first_uv"] = self._share("corner_uvs", (uvs,), lambda: uvs.reshape(-1).astype(np.float32))
        if appearance.materials:
            known = self._numbers
            numbers = np.array([known.setdefault(each, 1 + len(known)) for each in appearance.materials], np.int32)
            row["material_id"] = numbers[0]
            if appearance.material_ids is not None and len(numbers) > 1:
                row["first_material_id"] = self._append("material_ids", numbers[appearance.material_ids])

    def add_normals(self, shapes: Sequence[Shape]) -> None:
        """Append the normals of all meshes but those that a texture bends; of many small ones at once."""
        keys = {
            _key_of_normals(shape): shape
            for shape in shapes
            if isinstance(shape, Mesh) and self._has_normals(shape) and _find_bent_uvs(shape.appearance) is None
        }
        meshes = [*keys.values()]
        batches = batch_small(meshes)
        alone = set(range(len(meshes))).difference(*batches)
        for batch in (*batches, *([number] for number in sorted(alone))):
            own = sorted((meshes[number] for number in batch), key=lambda mesh: _given_normals(mesh) is not None)
            begin = self._append("corner_normals", _pack_all_normals(own, self._crease_angle))
            for mesh in own:
                self._begins[_key_of_normals(mesh)] = begin
                begin += _CORNERS * mesh.face_count

    def _has_normals(self, mesh: Mesh) -> bool:
        return _given_normals(mesh) is not None or not _is_flat(mesh, self._crease_angle)

    def _add_normals(self, mesh: Mesh, row: NDArray[np.void]) -> None:
        """Fill in the normals of a mesh; append them, and its tangents, if a texture bends the normals."""
        uvs = _find_bent_uvs(mesh.appearance)
        if uvs is not None:
            given = _given_normals(mesh)
            normals = smooth_normals_by_angle(mesh, self._crease_angle) if given is None else given
            row["first_normal"] = self._append("corner_normals", pack_normals(normals.reshape(-1, _CORNERS)))
            tangents = find_tangents(mesh, normals, uvs).reshape(-1, _CORNERS + 1)
            row["first_tangent"] = self._append("corner_normals", pack_tangents(tangents))
        elif self._has_normals(mesh):
            row["first_normal"] = self._begins[_key_of_normals(mesh)]

    def finish(self, looks: NDArray[np.void]) -> dict[str, NDArray[Any]]:
        """Return the tables."""
        textures = TextureTables()
        materials = np.zeros(1 + len(self._numbers), MATERIAL)
        for number, material in enumerate((Material(), *self._numbers)):
            _fill_material(materials[number : number + 1], material, textures)
        grown = {name: _join(parts) for name, parts in self._parts.items()}
        return {"looks": looks, "materials": materials, **textures.arrays(), **grown}

    def _share(self, name: str, sources: tuple[Any, ...], make: Callable[[], NDArray[Any]]) -> int:
        key = name, *map(id, sources)
        if key not in self._begins:
            self._begins[key] = self._append(name, make())
        return self._begins[key]

    def _append(self, name: str, values: NDArray[Any]) -> int:
        begin = self._counts[name]
        count = begin + len(values)
        if count > _MOST_ROWS:
            raise SceneError(
                f"the table '{name}' of what surfaces look like has {count:,} numbers, and the device counts up to "
                f"{_MOST_ROWS:,}: leave out texture coordinates, colours or normals"
            )
        self._parts[name].append(values)
        self._counts[name] = count
        return begin


def _given_normals(mesh: Mesh) -> NDArray[np.float32] | None:
    return None if mesh.appearance is None else mesh.appearance.normals


def _key_of_normals(mesh: Mesh) -> tuple[Any, ...]:
    # Moved vertices may have the normals of others, and are flat elsewhere.
    return "corner_normals", id(_given_normals(mesh)), id(mesh.local_vertices)


def _pack_all_normals(meshes: Sequence[Mesh], crease_angle: float) -> NDArray[np.uint32]:
    """Return the packed normals of one mesh or of small ones, of which those without normals come first."""
    given = [normals for mesh in meshes if (normals := _given_normals(mesh)) is not None]
    lacking = meshes[: len(meshes) - len(given)]
    if len(meshes) == 1:
        (mesh,) = meshes
        normals = given[0] if given else smooth_normals_by_angle(mesh, crease_angle)
        return _mark_flat_faces(pack_normals(normals.reshape(-1, _CORNERS)), mesh.vertices, mesh.faces)
    joined = JoinedMeshes.of(meshes)
    smooth = [smooth_small(JoinedMeshes.of(lacking) if given else joined, crease_angle)] if lacking else []
    packed = pack_normals(np.concatenate([*smooth, *given]).reshape(-1, _CORNERS))
    return _mark_flat_faces(packed, joined.vertices, joined.faces)


def _mark_flat_faces(
    packed: NDArray[np.uint32], vertices: NDArray[np.float64], faces: NDArray[np.int32]
) -> NDArray[np.uint32]:
    """Return packed normals at the corners of faces, marked where they are the face's own."""
    corners = packed.reshape(-1, _CORNERS)
    even = np.flatnonzero((corners == corners[:, :1]).all(axis=1))
    own = pack_normals(find_flat_normals(vertices[faces[even]]))
    corners[even[corners[even, 0] == own], 0] = FLAT_FACE
    return packed


def _join(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """Return all parts; a table without rows still needs a buffer."""
    return np.concatenate(parts) if any(map(len, parts)) else np.zeros(1, parts[0].dtype)


def has_normal_maps(shapes: Sequence[Shape]) -> bool:
    """Return whether a texture bends the normals of any mesh."""
    return any(isinstance(shape, Mesh) and _find_bent_uvs(shape.appearance) is not None for shape in shapes)


def _find_bent_uvs(appearance: Appearance | None) -> NDArray[np.float32] | None:
    """Return texture coordinates by which a texture bends normals, None if none does."""
    if appearance is None or all(material.normal_texture is None for material in appearance.materials):
        return None
    return appearance.uvs


def _fill_material(row: NDArray[np.void], material: Material, textures: TextureTables) -> None:
    for name in ("base_colour", "emission", "alpha", "metallic", "roughness", "ior", "transmission", "normal_scale"):
        row[name] = getattr(material, name)
    row["is_light"] = _is_drawable_light(material)
    row["alpha_cutoff"] = -1.0 if material.alpha_cutoff is None else material.alpha_cutoff
    for name in ("base_colour_texture", "metallic_roughness_texture", "emission_texture", "normal_texture"):
        row[name] = textures.number(getattr(material, name))


class TextureTables:
    """Textures, each once."""

    def __init__(self) -> None:
        self._textures: dict[int, tuple[int, Texture]] = {}  # with their numbers, by their identities

    def number(self, texture: Texture | None) -> int:
        """Return the number of a texture, -1 for None."""
        return -1 if texture is None else self._textures.setdefault(id(texture), (len(self._textures), texture))[0]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the tables by the names of the kernels' arguments.

        Raises
        ------
        SceneError
            The textures have more texels than the device counts.
        """
        textures = [texture for _, texture in self._textures.values()]
        rows = np.zeros(max(len(textures), 1), TEXTURE)
        counts = [texture.pixels.shape[0] * texture.pixels.shape[1] for texture in textures]
        if sum(counts) > _MOST_ROWS:
            raise SceneError(f"the textures have {sum(counts):,} pixels, and the device counts up to {_MOST_ROWS:,}")
        first = 0
        for row, texture, count in zip(rows, textures, counts, strict=False):
            row["first_texel"], row["is_srgb"] = first, texture.is_srgb
            row["height"], row["width"] = texture.pixels.shape[:2]
            row["wrap"] = [TEXTURE_WRAPS[wrap] for wrap in texture.wrap]
            row["is_nearest"] = texture.filter == "nearest"
            first += count
        texels = [np.ascontiguousarray(texture.pixels).view("<u4").reshape(-1) for texture in textures]
        decoded = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
        return {"textures": rows, "texels": _join([np.zeros(0, np.uint32), *texels]), "decoded_srgb": decoded}
