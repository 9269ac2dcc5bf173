"""The content of a picture: mesh, camera, light and colours.

Owns the checks of these values; `scene_file.py` reads them from a file.
"""

from __future__ import annotations

import dataclasses
import math
import os
from dataclasses import dataclass, field
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry import Mesh, load_mesh
from ..geometry.as_mesh import MeshLike, as_mesh
from ..geometry.fetch import find_known_mesh
from ..geometry.shapes.make_shape import make_shape
from ..scene.contents import SceneContents
from ..scene.names import name_of_file
from ..scene.store import SceneStore
from ..structs import SHADINGS
from .camera import DEFAULT_FOV, DEFAULT_UP, Camera, check_fov
from .framing import frame_mesh
from .vectors import Vector, check_vector, is_vector

DEFAULT_WIDTH, DEFAULT_HEIGHT = 800, 450
MAX_SIDE = 65_535
DEFAULT_SHADING = "lambert+shadow"


@dataclass(frozen=True)
class Light:
    """A directed light, and ambient light from the sky and the ground. Colours are linear, 0 to 1.

    Attributes
    ----------
    direction : (3,) float, or None
        Towards the light, in the scene's coordinates. None: from behind the viewer's left shoulder.
    colour : (3,) float
        Of the directed light, on a surface that faces it.
    sky, ground : (3,) float
        On a surface that faces up, and one that faces down.

    Raises
    ------
    SceneError
        A value is not three finite numbers, or the direction is zero.

    Examples
    --------
    >>> import clbvh
    >>> light = clbvh.Light(direction=(0, 1, 0), sky=(0.3, 0.3, 0.35))
    >>> picture = clbvh.render(clbvh.Scene(clbvh.MeshSource(shape="icosphere", triangles=1000), light=light))
    """

    direction: Vector | None = None
    colour: Vector = (0.92, 0.88, 0.82)
    sky: Vector = (0.19, 0.21, 0.24)
    ground: Vector = (0.07, 0.065, 0.06)

    def __post_init__(self) -> None:
        for name in ("colour", "sky", "ground"):
            check_vector(f"the light's {name}", getattr(self, name))
        if self.direction is not None:
            check_vector("the light's direction", self.direction)
            if not any(self.direction):
                raise SceneError("the light's direction must not be zero")

    def with_direction(self, direction: Vector | None) -> Light:
        """Return a copy with another direction.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Light().with_direction((0, 1, 0)).direction
        (0, 1, 0)
        """
        return dataclasses.replace(self, direction=direction)


@dataclass(frozen=True)
class MeshSource:
    """The source of a scene's mesh: exactly one of `path`, `name`, `shape` and `mesh`.

    Attributes
    ----------
    path : str
        A mesh file.
    name : str
        A known mesh, such as ``bunny``.
    shape : str
        A procedural shape, with `triangles`, `seed` and the shape's own `options`.
    mesh : Mesh
        A mesh in memory.

    Raises
    ------
    SceneError
        None of the four is given, or several.

    Examples
    --------
    >>> import clbvh
    >>> clbvh.MeshSource(shape="icosphere", triangles=1000).load()
    Mesh('icosphere', vertices=492, faces=980)
    >>> clbvh.MeshSource(path="part.ply", name="bunny")
    Traceback (most recent call last):
    clbvh.errors.SceneError: the mesh needs exactly one of path, name and shape, or a Mesh
    """

    path: str | None = None
    name: str | None = None
    shape: str | None = None
    triangles: int = 100_000
    seed: int = 0
    options: dict[str, float] = field(default_factory=dict)
    mesh: Mesh | None = None

    def __post_init__(self) -> None:
        if sum(value is not None for value in (self.path, self.name, self.shape, self.mesh)) != 1:
            raise SceneError("the mesh needs exactly one of path, name and shape, or a Mesh")

    def load(self) -> Mesh:
        """Return the mesh; raise `MeshError` or `ConfigError` if there is none.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.MeshSource(shape="icosphere", triangles=1000).load().face_count
        980
        """
        if self.mesh is not None:
            return self.mesh
        if self.shape is not None:
            return make_shape(self.shape, triangles=self.triangles, seed=self.seed, **self.options)
        return load_mesh(self.file())

    def file(self) -> Path:
        """Return the file that `load` reads.

        Examples
        --------
        >>> import clbvh
        >>> print(clbvh.MeshSource(path="part.ply").file())
        part.ply
        """
        return find_known_mesh(self.name) if self.name is not None else Path(str(self.path))

    def estimate_face_count(self) -> int:
        """Return the approximate number of triangles without reading them; 0 if the file is missing.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.MeshSource(shape="icosphere", triangles=1000).estimate_face_count()
        1000
        """
        if self.mesh is not None:
            return self.mesh.face_count
        if self.shape is not None:
            return self.triangles
        file = self.file()
        return file.stat().st_size // _BYTES_PER_FACE if file.is_file() else 0


# Binary PLY files take about 19 bytes per triangle, ASCII ones about 43.
_BYTES_PER_FACE = 30


@dataclass(frozen=True)
class Transform:
    """The placement of the mesh: scaled, then rotated, then translated.

    Attributes
    ----------
    scale : float
        Not zero.
    rotate : (3,) float
        Degrees about x, then y, then z.
    translate : (3,) float, the scene's units

    Raises
    ------
    SceneError
        A value is not finite, or the scale is zero.

    Examples
    --------
    >>> import clbvh
    >>> upright = clbvh.Transform(scale=0.001, rotate=(-90, 0, 0))  # millimetres, z up, to metres, y up
    >>> part = clbvh.Mesh.from_arrays([[0, 0, 0], [1000, 0, 0], [0, 0, 2000]], [[0, 1, 2]])
    >>> upright.apply(part).vertices.round(6).max(axis=0)
    array([1., 2., 0.])
    """

    scale: float = 1.0
    rotate: Vector = (0.0, 0.0, 0.0)
    translate: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not isinstance(self.scale, Real) or not math.isfinite(self.scale) or self.scale == 0:
            raise SceneError(f"the transform's scale must be a finite number other than 0, not {self.scale!r}")
        check_vector("the transform's rotate", self.rotate)
        check_vector("the transform's translate", self.translate)

    @np.errstate(over="ignore", invalid="ignore")  # coordinates that are not finite are refused by the mesh
    def apply(self, mesh: Mesh) -> Mesh:
        """Return the mesh in the scene's coordinates.

        Examples
        --------
        >>> import clbvh
        >>> mesh = clbvh.make_shape("icosphere", triangles=1000)
        >>> clbvh.Transform(translate=(0, 0, 5)).apply(mesh).origin
        array([0., 0., 5.])
        """
        if self == Transform():
            return mesh
        points = mesh.vertices * self.scale @ self._rotation.T + np.asarray(self.translate)
        return Mesh.from_arrays(points, mesh.faces, name=mesh.name)

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(4, 4) float64: the transform that `Scene.place` takes.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Transform(scale=2, translate=(0, 0, 5)).matrix
        array([[2., 0., 0., 0.],
               [0., 2., 0., 0.],
               [0., 0., 2., 5.],
               [0., 0., 0., 1.]])
        """
        matrix = np.eye(4)
        matrix[:3, :3] = self._rotation * self.scale
        matrix[:3, 3] = self.translate
        return matrix

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return `matrix`, so that a transform can be given for an array."""
        return self.matrix if dtype is None else self.matrix.astype(dtype)

    @property
    def _rotation(self) -> NDArray[np.float64]:
        rotation = np.eye(3)
        for axis, degrees in enumerate(self.rotate):
            rotation = _rotate_about(axis, math.radians(degrees)) @ rotation
        return rotation


@dataclass(frozen=True)
class _FirstMesh:
    """The mesh that a scene is made with, placed by the scene's transform."""

    source: MeshSource
    transform: Transform

    @property
    def matrix(self) -> NDArray[np.float64]:
        return self.transform.matrix

    def load(self) -> tuple[Mesh, str]:
        mesh = self.source.load()
        is_file = self.source.path is not None or self.source.name is not None
        return mesh, name_of_file(mesh.name) if is_file else mesh.name


@dataclass(frozen=True, eq=False)
class Scene(SceneContents):
    """Objects, and the settings of their picture: camera, light and colours.

    `Scene()` is empty: `add` takes geometries, and `place` places them. `Scene(mesh)` begins with that mesh, placed
    once by `transform`, as geometry 0 and instance 0. Rays need no settings; a picture has defaults for all of them.

    Attributes
    ----------
    mesh : MeshSource, optional
        Or a `Mesh`, a `trimesh.Trimesh`, a path or ``(vertices, faces)``, which becomes a `MeshSource`. It is loaded
        when it is needed.
    transform : Transform
        Of `mesh`.
    eye, look_at : (3,) float, or None
        None: chosen so that the whole mesh is visible.
    up : (3,) float
        The direction that is up in the picture.
    fov : float
        Vertical field of view in degrees.
    light : Light
    shading : str
        One of `structs.SHADINGS`: ``lambert``, ``lambert+shadow``, ``normal``, ``depth``.
    surface : (3,) float
        Linear colour of the mesh.
    background : pair of (3,) float
        Linear colours at the top and at the bottom of the picture. One colour may be given for both.
    width, height : int
        Pixels.

    Raises
    ------
    SceneError
        A value is out of range.

    Notes
    -----
    Settings cannot be changed; `with_changes` returns a scene with other settings that shares the objects. Any number
    of threads may use a scene, also while one of them adds objects: a tracer has the objects of the moment at which it
    was made. Two scenes are equal if their settings are, and they share their objects or have none besides `mesh`.
    `copy.copy` makes a scene of its own with the same geometries. Scenes pickle, with all that they have loaded.

    Examples
    --------
    >>> import clbvh
    >>> scene = clbvh.Scene()
    >>> ball = scene.add(clbvh.make_shape("icosphere", triangles=320), name="ball")
    >>> left = scene.place(ball)
    >>> right = scene.place(ball, clbvh.Transform(scale=2, translate=(5, 0, 0)))
    >>> scene.instances
    (Instance(0, 'ball', of='ball'), Instance(1, 'ball 2', of='ball'))

    >>> scene = clbvh.open_scene("demo").with_changes(eye=(3.0, 2.0, 4.0), look_at=(0.0, 0.0, 0.0))
    >>> scene.camera(scene.mesh.load()).eye
    (3.0, 2.0, 4.0)
    """

    mesh: MeshSource | None = None
    transform: Transform = Transform()
    eye: Vector | None = None
    look_at: Vector | None = None
    up: Vector = DEFAULT_UP
    fov: float = DEFAULT_FOV
    light: Light = Light()
    shading: str = DEFAULT_SHADING
    surface: Vector = (0.80, 0.72, 0.60)
    background: tuple[Vector, Vector] = ((0.42, 0.50, 0.60), (0.86, 0.88, 0.90))
    width: int = DEFAULT_WIDTH
    height: int = DEFAULT_HEIGHT
    # A field, so that a copy with other settings shares it.
    _store: Any = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.mesh is not None and not isinstance(self.mesh, MeshSource):
            object.__setattr__(self, "mesh", _make_source(self.mesh))
        if not isinstance(self.shading, str) or self.shading not in SHADINGS:
            raise SceneError(f"the shading must be one of {', '.join(SHADINGS)}, not '{self.shading}'")
        for name, side in (("width", self.width), ("height", self.height)):
            if isinstance(side, bool) or not isinstance(side, Integral) or not 1 <= side <= MAX_SIDE:
                raise SceneError(f"the {name} must be 1 to {MAX_SIDE} pixels, not {side}")
        check_fov(self.fov)
        if self.look_at is not None and self.eye is None:
            raise SceneError("a camera with look_at needs an eye")
        for name in ("eye", "look_at", "up"):
            if getattr(self, name) is not None:
                check_vector(f"the camera's {name}", getattr(self, name))
        check_vector("the surface colour", self.surface)
        if is_vector(self.background):
            object.__setattr__(self, "background", (self.background, self.background))
        if not isinstance(self.background, tuple | list) or len(self.background) != 2:
            raise SceneError(f"the background must be a colour, or two: top and bottom, not {self.background!r}")
        for colour in self.background:
            check_vector("a background colour", colour)
        object.__setattr__(self, "_store", self._find_store())

    def _find_store(self) -> SceneStore:
        """Return the store of the scene that this one is made from, or a new one."""
        if self.mesh is None and self.transform != Transform():
            raise SceneError("the transform is that of `mesh`, which the scene lacks: give it to `Scene.place`")
        first = None if self.mesh is None else _FirstMesh(self.mesh, self.transform)
        if self._store is None:
            return SceneStore(first)
        if self._store.first == first:
            return self._store
        if not self._store.is_as_made:
            raise SceneError(
                "the mesh and the transform of a scene to which objects were added cannot be changed: "
                "make a new scene, and add them there"
            )
        return SceneStore(first)

    def camera(self, mesh: Mesh) -> Camera:
        """Return the camera: the one that was asked for, or one that sees the whole mesh.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.open_scene("demo")
        >>> camera = scene.camera(scene.mesh.load())
        >>> camera.fov == scene.fov
        True
        """
        if self.eye is not None and self.look_at is not None:
            return Camera(self.eye, self.look_at, self.up, self.fov)
        return frame_mesh(mesh, aspect=self.width / self.height, up=self.up, fov=self.fov, eye=self.eye)

    def with_changes(self, **changes: Any) -> Scene:
        """Return a scene with those changes that are not None; it shares the objects.

        Raises
        ------
        SceneError
            A value is out of range, or another mesh or transform is given for a scene to which objects were added.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.open_scene("demo").with_changes(shading="depth", width=None)
        >>> scene.shading, scene.width
        ('depth', 1280)
        """
        return dataclasses.replace(self, **{key: value for key, value in changes.items() if value is not None})

    def only_mesh(self) -> MeshSource:
        """Return the source of the mesh of a scene that holds nothing else; raise `SceneError` for any other scene.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.open_scene("knot").only_mesh().shape
        'knot'
        """
        if self.mesh is None and self.is_empty:
            raise SceneError("the scene is empty: add a geometry, and place it")
        if self.mesh is None or not self._store.is_as_made:
            raise SceneError("the scene has several objects, but one mesh is needed here")
        return self.mesh

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Scene):
            return NotImplemented
        mine, others = self._store, other._store
        return self._settings() == other._settings() and (mine is others or (mine.is_as_made and others.is_as_made))

    def __hash__(self) -> int:
        return hash(self._settings())

    def _settings(self) -> tuple[object, ...]:
        return tuple(getattr(self, each.name) for each in dataclasses.fields(self) if each.name != "_store")


def _make_source(mesh: MeshLike) -> MeshSource:
    """Return the source of a mesh; a file is read later."""
    if isinstance(mesh, str | os.PathLike):
        return MeshSource(path=os.fspath(mesh))
    return MeshSource(mesh=as_mesh(mesh))


def _rotate_about(axis: int, angle: float) -> NDArray[np.float64]:
    """Return the right-handed rotation about one axis, (3, 3) float64."""
    rotation = np.eye(3)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rotation[first, first] = rotation[second, second] = math.cos(angle)
    rotation[second, first] = math.sin(angle)
    rotation[first, second] = -math.sin(angle)
    return rotation
