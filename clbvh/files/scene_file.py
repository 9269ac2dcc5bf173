"""Files of a scene and its view: scene files, which people write as TOML, and the view in saved scenes.

The tables of a scene file are converted into the classes of this file, whose fields are the keys; those of `[view]` are
the fields of `View`. Owns the rules between objects: labels, scatters, the number of copies.
"""

from __future__ import annotations

import dataclasses
import math
import os
import re
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import msgspec
import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType
from numpy.typing import NDArray

from ..errors import ConfigError, MeshError, SceneError
from ..geometry import Mesh, Shape, Spheres, find_known_mesh, load_mesh, make_shape
from ..geometry.appearance.material import Material, Texture
from ..geometry.as_mesh import as_shape
from ..geometry.loading.file_mesh import FileMesh
from ..geometry.loading.file_parts import POINT, Parts, Placed, find_hidden, join_nodes
from ..geometry.loading.spheres_file import SPHERES_SUFFIXES, read_spheres
from ..geometry.loading.texture_files import decode_image
from ..geometry.shapes.make_shape import SHAPES, list_options
from ..geometry.shapes.make_spheres import SPHERE_SETS, make_spheres
from ..scene.copies import Grid, Scatter, check_copies
from ..scene.handles import ALL_BITS, Geometry
from ..scene.names import Named, name_of_file
from ..scene.scene import Scene
from ..scene.serialize import material_of_table, material_table, write_scene
from ..scene.transforms import Transform
from ..support.files import read_errors_as, read_regular
from ..support.settings import Vector, as_plain, change_settings, say_unknown
from ..views.cameras.camera import Camera
from ..views.cameras.lens import Lens
from ..views.cameras.projection import DEFAULT_UP, text_of
from ..views.view import View

_MAX_FILE_BYTES = 1 << 20  # a scene has a few hundred

Whole = Annotated[int, Meta(ge=0, le=2**63 - 1)]  # as TOML has it; Python's reader has no limit
Option = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)] | float | UnsetType
Row = tuple[float, float, float, float]
_NO_TURN = (0.0, 0.0, 0.0)

_Table = TypeVar("_Table", bound=Struct)


class SceneObject(Struct, kw_only=True, frozen=True, forbid_unknown_fields=True):
    """The keys of any `[[object]]`; those of its source are in the classes below."""

    label: str = ""
    material: str | None = None
    colour: Vector | None = None
    mask: Annotated[int, Meta(ge=0, le=ALL_BITS)] = ALL_BITS
    scale: float | Vector = 1.0
    rotate: Vector = _NO_TURN
    translate: Vector = _NO_TURN
    matrix: tuple[Row, Row, Row, Row] | None = None
    repeat: Any = None

    def __post_init__(self) -> None:
        if self.matrix is not None and (self.scale, self.rotate, self.translate) != (1.0, _NO_TURN, _NO_TURN):
            raise SceneError("a matrix stands for scale, rotate and translate: leave those out, or the matrix")
        Transform(1.0, self.rotate, self.translate)

    def load(self) -> Shape:
        """Return the shape of the source."""
        raise NotImplementedError

    @property
    def transform(self) -> NDArray[np.float64]:
        """(4, 4) float64: from the source's coordinates to the scene's, of each copy before it is moved itself."""
        if self.matrix is not None:
            return np.array(self.matrix)
        matrix = Transform(1.0, self.rotate, self.translate).matrix
        matrix[:3, :3] *= self.scale  # may be 0, which hides the object
        return matrix

    @property
    def count(self) -> int:
        """The number of copies."""
        return 1 if self.repeat is None else self.repeat.count

    @property
    def source(self) -> tuple[tuple[str, Any], ...]:
        """The keys of the source, the chosen one first; equal ones share a geometry."""
        names = self.__struct_fields__[len(SceneObject.__struct_fields__) :]
        return tuple((name, getattr(self, name)) for name in names)

    @property
    def options(self) -> dict[str, float]:
        """The options of a procedural source."""
        own = type(self).__mro__[1].__struct_fields__  # type: ignore[attr-defined]
        return {name: value for name, value in self.source if name not in own and value is not UNSET}


class _File(SceneObject, kw_only=True, frozen=True):
    path: str

    def load(self) -> Shape:
        return as_shape(self.path)


class _KnownMesh(SceneObject, kw_only=True, frozen=True):
    name: str

    def load(self) -> Mesh:
        return load_mesh(find_known_mesh(self.name))


class _ProceduralShape(SceneObject, kw_only=True, frozen=True):
    shape: str
    triangles: Whole = 100_000
    seed: Whole = 0

    def load(self) -> Mesh:
        return make_shape(self.shape, triangles=self.triangles, seed=self.seed, **self.options)


class _ProceduralSpheres(SceneObject, kw_only=True, frozen=True):
    spheres: str
    number: Whole = msgspec.field(default=100_000, name="count")
    seed: Whole = 0

    def load(self) -> Spheres:
        return make_spheres(self.spheres, count=self.number, seed=self.seed, **self.options)


class _SpheresFile(SceneObject, kw_only=True, frozen=True):
    spheres: str
    radii: float | None = None

    def load(self) -> Spheres:
        centres, radii = read_spheres(self.spheres)
        if radii is not None and self.radii is not None:
            raise SceneError(f"{self.spheres}: the file has its own radii: leave 'radii' out")
        if radii is None and self.radii is None:
            raise SceneError(f"{self.spheres}: the file has no radii: give 'radii', one for all")
        sizes = self.radii if radii is None else radii
        return Spheres.from_arrays(centres, sizes, name=name_of_file(self.spheres))  # type: ignore[arg-type]


class _Centres(SceneObject, kw_only=True, frozen=True):
    centres: tuple[Vector, ...]
    radii: float | tuple[float, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.radii, tuple) and len(self.radii) != len(self.centres):
            raise SceneError(f"{len(self.radii)} radii do not fit {len(self.centres)} centres")

    def load(self) -> Spheres:
        return Spheres.from_arrays(np.array(self.centres), np.array(self.radii), name="spheres")


_SPHERES = ("spheres", "centres")
_SOURCES: dict[str, type[SceneObject]] = {
    "path": _File,
    "name": _KnownMesh,
    "shape": _ProceduralShape,
    "spheres": _ProceduralSpheres,
    "centres": _Centres,
}


@cache
def _add_options(kind: type[SceneObject], names: tuple[str, ...]) -> type[SceneObject]:
    """Return a class of objects that has numbers by these names, too."""
    fields = [(name, Option, UNSET) for name in names]
    return msgspec.defstruct(kind.__name__, fields, bases=(kind,), kw_only=True, frozen=True)  # type: ignore[return-value]


# Their pixels are colours, which are sRGB; those of the other textures are numbers.
_TEXTURES_OF_COLOURS = ("base_colour_texture", "emission_texture")


class SceneFile(NamedTuple):
    """A scene file that was read and checked, with its textures, but no other file that it names."""

    objects: Named[SceneObject]
    """By their labels."""
    materials: dict[str, Material]
    """By their labels."""
    view: View


def read_scene_file(path: str | os.PathLike[str]) -> tuple[Scene, View]:
    """Read a scene file, load its objects and place them; `docs/scenes.md` lists its keys.

    The instances of an object are named after its label: ``tree``, ``tree 2``, ``tree 3``.

    Raises
    ------
    SceneError
        The file is missing, not a regular one, not TOML, or has an unknown key or an invalid value, which the message
        names.
    MeshError
        An object cannot be loaded.
    """
    file = parse_scene_file(path)
    scene, geometries = Scene(), dict[Any, Geometry]()
    names = Named[None]("an object")
    names.update(dict.fromkeys(file.objects))
    for label, each in file.objects.items():
        try:
            if each.source not in geometries:
                geometries[each.source] = scene.add(each.load(), name=label)
            # Products of numbers that are too large are not finite, and refused when they are placed.
            with np.errstate(over="ignore", invalid="ignore"):
                matrices = _place(each, file, geometries)
            matrices = matrices[~find_hidden(matrices)]
            copies = [label]
            for _ in range(1, len(matrices)):
                copies.append(names.find_free(label))
                names[copies[-1]] = None
            material = None if each.material is None else file.materials[each.material]
            scene.place_many(
                geometries[each.source],
                matrices,
                names=copies[: len(matrices)],
                mask=each.mask,
                colour=each.colour,
                material=material,
            )
        except (ConfigError, MeshError, SceneError) as error:
            kind = MeshError if isinstance(error, MeshError) else SceneError
            raise kind(f"{path}: the object '{label}': {error}") from error
    if scene.is_empty:
        scene.place(scene.add(Mesh.from_arrays(*POINT, name="hidden")))
    return scene, file.view


def parse_scene_file(path: str | os.PathLike[str]) -> SceneFile:
    """Read a scene file and check its values; see `read_scene_file`."""
    with read_errors_as(SceneError, path):
        content = read_regular(Path(path), max_bytes=_MAX_FILE_BYTES)
    try:
        tables = tomllib.loads(content.decode(), parse_float=_read_float)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    except (ValueError, RecursionError) as error:  # also of numbers of many digits, and of lists within lists
        raise SceneError(f"{path}: not a TOML file: {error}") from error
    with _naming(str(path)):
        return _read_tables(tables, Path(path).parent)


@contextmanager
def _naming(where: str) -> Iterator[None]:
    """Raise the errors of a part of the file as `SceneError`, with the name of the part."""
    try:
        yield
    except (ConfigError, MeshError, SceneError) as error:
        raise SceneError(f"{where}: {error}") from None
    except RecursionError:  # in the message about a value, for example
        raise SceneError(f"{where}: too many tables or lists within others") from None


def _read_float(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise SceneError(f"numbers must be finite, not {text[:40]}")
    return number


class _Document(Struct, forbid_unknown_fields=True):
    object: list[dict[str, Any]] = []
    material: list[dict[str, Any]] = []
    view: dict[str, Any] = {}


def _read_tables(tables: dict[str, Any], folder: Path) -> SceneFile:
    for name, values in tables.items():
        if name in ("object", "material") and isinstance(values, dict):
            raise SceneError(f"a scene may have several of {name}: write [[{name}]], not [{name}]")
    document = _convert(tables, _Document)
    if not document.object:
        raise SceneError("the scene has no [[object]]: it needs a path, a name, a shape, spheres or centres")
    materials = _read_materials(document.material, folder)
    objects = _read_objects(document.object, folder, materials)
    with _naming("view"):
        if isinstance(panorama := document.view.get("environment"), str):
            document.view["environment"] = str(folder / panorama)
        return SceneFile(objects, materials, change_settings(View(), document.view))


def _read_objects(tables: list[dict[str, Any]], folder: Path, materials: dict[str, Material]) -> Named[SceneObject]:
    objects = Named[SceneObject]("an object")
    for number, values in enumerate(tables, 1):
        with _naming(f"object {number}"):
            found = _read_object(values, folder)
            if found.material is not None and found.material not in materials:
                raise SceneError(say_unknown(found.material, materials, "[[material]] with the label"))
            if isinstance(found.repeat, Scatter):
                target = found.repeat.on
                if target not in objects:
                    raise SceneError(say_unknown(target, objects, "object above it with the label"))
                if objects[target].repeat is not None or objects[target].source[0][0] in _SPHERES:
                    raise SceneError(f"is scattered on '{target}', which must be a mesh that is placed once")
            name = found.source[0][1]
            stem = name_of_file(name) if isinstance(name, str) else "spheres"
            objects[objects.check(found.label) if found.label else objects.find_free(stem)] = found
    check_copies(sum(found.count for found in objects.values()))
    return objects


def _read_object(values: dict[str, Any], folder: Path) -> SceneObject:
    """Return the object of a table."""
    chosen = [key for key in _SOURCES if key in values]
    if len(chosen) != 1:
        raise SceneError(f"needs exactly one of {', '.join(_SOURCES)}, not {' and '.join(chosen) or 'none of them'}")
    kind, name = _SOURCES[chosen[0]], values[chosen[0]]
    if isinstance(name, str):
        is_file = Path(name).suffix.lower() in SPHERES_SUFFIXES or Path(name).name != name
        if kind is _ProceduralSpheres and is_file:
            kind = _SpheresFile
        if kind in (_File, _SpheresFile):
            values[chosen[0]] = str(folder / name)
        elif kind is _ProceduralShape:
            kind = _add_options(kind, list_options("is no shape", SHAPES, name))
        elif kind is _ProceduralSpheres:
            kind = _add_options(kind, list_options("are no spheres", SPHERE_SETS, name))
    if isinstance(repeat := values.get("repeat"), dict):
        with _naming("repeat"):
            if ("grid" in repeat) == ("on" in repeat):
                raise SceneError("needs either 'grid' and 'spacing', or 'on' and 'count'")
            values["repeat"] = _convert(repeat, Grid if "grid" in repeat else Scatter)
    elif repeat is not None:
        raise SceneError("repeat: expected a table")
    return _convert(values, kind)


def _read_materials(tables: list[dict[str, Any]], folder: Path) -> dict[str, Material]:
    read_once = cache(_read_texture)  # also for textures of several materials

    def read_texture(name: str, path: str) -> Texture:
        with _naming(name):
            return read_once(folder / path, name in _TEXTURES_OF_COLOURS)

    materials = Named[Material]("a material")
    for number, values in enumerate(tables, 1):
        with _naming(f"material {number}"):
            table = _convert(values, material_table(str, "label"))
            materials[materials.check(table.name)] = material_of_table(table, read_texture)
    return materials


def _read_texture(path: Path, is_srgb: bool) -> Texture:
    """Return the texture of a file; raise `SceneError` if it cannot be read."""
    with read_errors_as(SceneError, path):
        content = read_regular(path)
    try:
        return Texture(path.name, decode_image(content), is_srgb)
    except Exception as error:  # decoders raise anything
        raise SceneError(f"{path}: the file cannot be used as a texture: {error}") from None


def _convert(values: dict[str, Any], kind: type[_Table]) -> _Table:
    """Return a table as its class; raise `SceneError` with the key for an unknown or missing one, or another type."""
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        raise SceneError(_say(str(error), kind)) from None


# A message of msgspec: the sentence, and the path of the key.
_MESSAGE = re.compile(r"(.*?)(?: - at `\$\.?(.*)`)?", re.DOTALL)
_UNKNOWN = re.compile(r"Object contains unknown field `(.*)`", re.DOTALL)
_MISSING = re.compile(r"Object missing required field `(.*)`")


def _say(message: str, kind: type[Struct]) -> str:
    """Return a message of msgspec in the words of scene files."""
    sentence, key = _MESSAGE.fullmatch(message).groups()  # type: ignore[union-attr]
    if unknown := _UNKNOWN.fullmatch(sentence):
        return say_unknown(unknown[1], kind.__struct_encode_fields__, "key")
    if missing := _MISSING.fullmatch(sentence):
        return f"needs '{missing[1]}'"
    sentence = (
        sentence.replace("Expected", "expected", 1).replace("`object", "`table").replace(" | null", "").replace("`", "")
    )
    return f"{key}: {sentence}" if key else sentence


def _place(found: SceneObject, file: SceneFile, geometries: dict[Any, Geometry]) -> NDArray[np.float64]:
    """Return the transforms of an object's copies, (n, 4, 4)."""
    if found.repeat is None:
        return found.transform[None]
    if isinstance(found.repeat, Grid):
        return found.repeat.matrices(found.transform)
    target = file.objects[found.repeat.on]
    surface, matrix = geometries[target.source].shape, target.transform
    if find_hidden([matrix])[0]:
        return np.zeros((0, 4, 4))  # with their surface
    if not isinstance(surface, Mesh):
        raise SceneError(f"the object '{found.repeat.on}' has points and no faces: copies need a surface")
    ground = join_nodes(Parts([FileMesh("", surface.vertices, surface.faces)], [Placed("", 0, matrix)]))
    if not np.isfinite(ground.vertices).all():
        raise MeshError(f"the surface of '{found.repeat.on}' has coordinates that are not finite in the scene")
    # What is up in a picture may be guessed, but by the whole scene.
    up = DEFAULT_UP if isinstance(file.view.up, str) else file.view.up
    return found.repeat.matrices(found.transform, ground.vertices, ground.faces, up)


def save_scene(path: str | os.PathLike[str], scene: Scene, view: View) -> None:
    """Save a scene and a view as one file, which `open_scene` reads; it holds the pixels of an environment, too.

    The file appears complete or not at all; one of that name is replaced.

    Raises
    ------
    ConfigError
        The folder does not exist, or the path is a folder.
    OSError
        The file cannot be written: the disk is full, for example.

    Examples
    --------
    >>> import clbvh
    >>> import tempfile
    >>> from pathlib import Path
    >>> folder = tempfile.TemporaryDirectory()
    >>> ball = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320))
    >>> clbvh.save_scene(Path(folder.name, "ball.scene"), ball, clbvh.View(side="top", cut="z=50%"))
    >>> scene, view = clbvh.open_scene(Path(folder.name, "ball.scene"))
    >>> view.side, view.cut.text
    ('top', 'z=50.0%')
    >>> folder.cleanup()
    """
    write_scene(path, scene.snapshot(), plain_view(view))


def plain_view(view: View) -> dict[str, Any]:
    """Return the settings that are not the default ones, as JSON takes them, but for the pixels of an environment."""
    plain = as_plain(view)
    if view.camera is not None:
        plain["camera"] = dataclasses.asdict(view.camera) | {"projection": text_of(view.camera.projection)}
    if view.projection is not None:
        plain["projection"] = text_of(view.projection)
    if view.cut is not None:
        plain["cut"] = view.cut.text
    if view.environment is not None:
        plain["environment"] = view.environment.pixels
    return plain


def view_of_plain(plain: dict[str, Any]) -> View:
    """Return the view of `plain_view`; raise `SceneError` for anything else, whatever it is."""
    try:
        values = dict(plain)
        if "camera" in values:
            lens = values["camera"]["lens"]
            values["camera"] = Camera(**values["camera"] | {"lens": None if lens is None else Lens(**lens)})
        if isinstance(values.get("environment"), str):  # a file that was sent must not have others read
            raise SceneError("its environment is no map of light")
        return change_settings(View(), values)
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise SceneError(f"the view in the file cannot be used: {error}") from error
