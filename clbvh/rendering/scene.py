"""A scene as users make it: objects, and the settings of their picture.

Owns the checks of the settings; `scene_file.py` reads them from a file. The objects are in the room `clbvh.scene`.
"""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry import Mesh
from ..geometry.as_mesh import MeshLike, as_mesh
from ..scene.contents import SceneContents
from ..scene.serialize import get_item, read_scene, write_scene
from ..scene.state import SceneState
from ..scene.store import SceneStore, name_of_file
from ..structs import SHADINGS
from .cameras.bounds import SceneBounds
from .cameras.camera import Camera
from .cameras.framing import frame_scene
from .cameras.projection import (
    AUTO,
    DEFAULT_FOV,
    DEFAULT_UP,
    Fisheye,
    Orthographic,
    Panorama,
    check_focus,
    check_fov,
    check_view,
    read_projection,
    text_of,
)
from .cut import Cut
from .film.environment_map import EnvironmentMap, as_environment
from .guesses import frame_without_outliers, guess_up
from .settings import DEFAULT_BOUNCES, DEFAULT_CREASE_ANGLE, DEFAULT_LIGHT, Light, Wireframe, check_sampling
from .sources import NO_TRANSFORM, MeshSource, Transform
from .vectors import Vector, check_vector, is_vector

DEFAULT_WIDTH, DEFAULT_HEIGHT = 800, 450
MAX_SIDE = 65_535
DEFAULT_SHADING = "studio"

FRAMES = (AUTO, "all")

_MAX_SHOWN = 60  # characters of a wrong name in a message

_Settings = TypeVar("_Settings", Cut, Wireframe, "Light", Transform, "Scene")


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
        None: chosen so that the whole mesh, or all objects, are visible.
    up : (3,) float, or "auto"
        The direction that is up in the picture. ``"auto"``: y or z, guessed from the shape when it is loaded. That is
        so for mesh files that `open_scene` opens, but for glTF, whose rule is y. `Picture.notes` says the guess.
    frame : str
        What a camera without an eye shows: ``"auto"``, all but a few small parts far away from everything else, or
        ``"all"``. `Picture.notes` says what was left out.
    view : str, or None
        Of a scene without an eye: ``"front"``, ``"right"``, ``"back"``, ``"left"``, ``"top"``, ``"bottom"`` or
        ``"iso"``. None: from the front, a little from the right and from above.
    fov : float
        Vertical field of view in degrees; of a perspective camera only.
    projection : Orthographic, Fisheye, Panorama or None
        None: perspective. An orthographic camera without a height gets the one that shows everything.
    aperture, focus_distance : float, the scene's units
        Depth of field, see `Camera`.
    light : Light
    shading : str
        One of `structs.SHADINGS`: ``studio``, ``ao`` and ``path`` take samples; ``lambert``, ``lambert+shadow``,
        ``normal`` and ``depth`` cast one ray through the centre of each pixel.
    samples : int, or None
        Of each pixel, for the shadings with samples. None: 16, for ``path`` 64.
    seed : int
        Of the sample points. Equal seeds give equal pictures.
    smooth : float
        Degrees. Meshes without normals of their own are shaded smoothly over edges that turn by less; 0: over none.
    ground : bool, or None
        Whether there is a ground below all objects: in ``studio`` it shows their shadows alone, in ``path`` it is a
        matte surface of middle grey, without an end but for a soft transition to the background. The other shadings
        have none. None: in ``studio`` alone.
    transparent : bool
        Whether the background is left out of the picture; see `Picture.alpha`.
    exposure : float
        Stops by which the light of the shadings with samples is made brighter, or darker where negative.
    tone_curve : str, or None
        ``"linear"``, or ``"filmic"``, which keeps bright light from becoming white. None: filmic for ``path``.
    max_bounces : int
        Reflections after which a path of ``path`` ends; 0: light that comes straight from a source.
    clamp : float, or None
        Of ``path``: a sample with more light than that, in any channel, is made as much darker. That takes bright dots
        away, and with them light: the mean is no longer the right one. None: no limit.
    environment : str, path, (h, w, 3) array, or None
        Light from all around, of ``path``: a panorama as an ``.hdr`` or ``.exr`` file, or as linear colours with the
        zenith's row first, which becomes an `EnvironmentMap`. Its middle column is along +x, and `up` is up. The
        directed light then shines only if it has a direction. None: the `background`, from below to above.
    environment_rotation : float
        Degrees by which it is turned about the direction upwards, counter-clockwise seen from above.
    environment_strength : float
        Factor of its light.
    surface : (3,) float
        Linear colour of the mesh, and of objects without one of their own.
    cut : Cut, or None
        A part of the world that the camera does not see.
    wireframe : Wireframe, or None
        Lines along the edges of triangles.
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
    transform: Transform = NO_TRANSFORM
    eye: Vector | None = None
    look_at: Vector | None = None
    up: Vector | Literal["auto"] = DEFAULT_UP
    frame: Literal["auto", "all"] = "auto"
    view: str | None = None
    fov: float = DEFAULT_FOV
    projection: Orthographic | Fisheye | Panorama | None = None
    aperture: float = 0.0
    focus_distance: float | None = None
    light: Light = DEFAULT_LIGHT
    shading: str = DEFAULT_SHADING
    samples: int | None = None
    seed: int = 0
    smooth: float = DEFAULT_CREASE_ANGLE
    ground: bool | None = None
    transparent: bool = False
    exposure: float = 0.0
    tone_curve: str | None = None
    max_bounces: int = DEFAULT_BOUNCES
    clamp: float | None = None
    environment: EnvironmentMap | None = None
    environment_rotation: float = 0.0
    environment_strength: float = 1.0
    cut: Cut | None = None
    wireframe: Wireframe | None = None
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
        check_sampling(self)
        object.__setattr__(self, "environment", as_environment(self.environment))
        check_fov(self.fov)
        object.__setattr__(self, "projection", read_projection(self.projection))
        check_focus(self.projection, self.aperture, self.focus_distance)
        if self.look_at is not None and self.eye is None:
            raise SceneError("a camera with look_at needs an eye")
        if self.view is not None:
            check_view(self.view)
            if self.eye is not None:
                raise SceneError(f"a camera with an eye has no view '{self.view}': take one of them out")
        if self.frame not in FRAMES:
            raise SceneError(f"the frame must be one of {', '.join(FRAMES)}, not {self.frame!r}")
        for name in ("eye", "look_at", "up"):
            if getattr(self, name) is not None and not (name == "up" and self.up == AUTO):
                check_vector(f"the camera's {name}", getattr(self, name))
        if self.cut is not None and not isinstance(self.cut, Cut):
            raise SceneError(f"the cut must be a clbvh.Cut, not {self.cut!r}")
        if self.wireframe is not None and not isinstance(self.wireframe, Wireframe):
            raise SceneError(f"the wireframe must be a clbvh.Wireframe, not {self.wireframe!r}")
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
        if self.mesh is None and self.transform != NO_TRANSFORM:
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
        return self.find_camera(mesh)

    def find_camera(self, extent: Any) -> Camera:
        """Return the camera for a `Mesh`, or for the extent of a scene of several objects.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.open_scene("demo")
        >>> scene.find_camera(scene.mesh.load()).fov == scene.fov
        True
        """
        bounds = SceneBounds.of_mesh(extent) if isinstance(extent, Mesh) else extent
        framed = frame_without_outliers(bounds).bounds if self.frame == AUTO else bounds
        up = guess_up(framed, self.eye, self.look_at).vector if isinstance(self.up, str) else self.up
        view: dict[str, Any] = {"aspect": self.width / self.height, "up": up, "fov": self.fov}
        camera = frame_scene(
            framed, eye=self.eye, look_at=self.look_at, projection=self.projection, side=self.view, **view
        )
        if self.aperture == 0 and self.focus_distance is None:
            return camera
        return dataclasses.replace(camera, aperture=self.aperture, focus_distance=self.focus_distance)

    def with_view(self, view: str) -> Scene:
        """Return the scene seen from another side, see `view`; it has no eye of its own.

        Raises
        ------
        SceneError
            There is no view of this name.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.open_scene("knot").with_view("top").view
        'top'
        """
        return dataclasses.replace(self, eye=None, look_at=None, view=view)

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

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save the scene as one file: geometries, instances, names, masks, and the settings of its picture.

        The file appears complete or not at all; one of that name is replaced.

        Raises
        ------
        MeshError
            The mesh of the scene cannot be loaded.
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
        >>> clbvh.Scene(clbvh.make_shape("icosphere", triangles=320)).save(Path(folder.name, "ball.scene"))
        >>> folder.cleanup()
        """
        values = self._settings() | {"projection": text_of(self.projection)}
        settings = {name: as_plain(value) for name, value in values.items() if name not in ("mesh", "environment")}
        environment = None if self.environment is None else self.environment.as_plain()
        write_scene(path, self.snapshot(), settings | {"mesh": self.mesh is not None, "environment": environment})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Scene:
        """Load a scene that `save` wrote.

        Nothing in the file is run or trusted: a damaged, cut off or forged one is refused.

        Raises
        ------
        SceneError
            The file cannot be read, or is no whole scene. The message names the fault.

        Examples
        --------
        >>> import clbvh
        >>> import tempfile
        >>> from pathlib import Path
        >>> folder = tempfile.TemporaryDirectory()
        >>> clbvh.Scene(clbvh.make_shape("icosphere", triangles=320)).save(Path(folder.name, "ball.scene"))
        >>> clbvh.Scene.load(Path(folder.name, "ball.scene")).instances
        (Instance(0, 'icosphere', of='icosphere'),)
        >>> folder.cleanup()
        """
        state, settings = read_scene(path)
        try:
            return cls._restore(state, settings)
        except (SceneError, TypeError, OverflowError) as error:
            raise SceneError(f"{path}: the file is whole, but its settings make no scene: {error}") from error

    @classmethod
    def _restore(cls, state: SceneState, settings: dict[str, Any]) -> Scene:
        """Return the scene of a file; the settings are a dict, and nothing else of them is checked yet."""
        values = {name: as_setting(value) for name, value in settings.items()}
        values["projection"] = read_projection(values.get("projection"))
        if values.get("environment") is not None:
            values["environment"] = EnvironmentMap.from_plain(values["environment"])
        if values.get("cut") is not None:
            values["cut"] = _make(Cut, get_item(values, "cut", dict))
        if values.get("wireframe") is not None:
            values["wireframe"] = _make(Wireframe, get_item(values, "wireframe", dict))
        values["light"] = _make(Light, get_item(values, "light", dict))
        values["transform"] = _make(Transform, get_item(values, "transform", dict))
        first = None
        if get_item(values, "mesh", bool):
            mesh = state.shapes[0] if state.shapes else None
            if not isinstance(mesh, Mesh) or not state.instance_count or state.geometry_ids[0] != 0:
                raise SceneError("geometry 0 is no mesh, or instance 0 does not place it")
            values["mesh"] = MeshSource(mesh=mesh)
            first = _FirstMesh(values["mesh"], values["transform"])
        else:
            values["mesh"] = None
        return dataclasses.replace(_make(cls, values), _store=SceneStore.from_state(state, first))

    @property
    def is_one_mesh(self) -> bool:
        """Whether the scene holds its `mesh` and nothing else."""
        return self.mesh is not None and self._store.is_as_made

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
            raise SceneError(
                "one mesh is needed here, as `Scene(mesh)` holds it, but the scene has "
                f"{len(self.geometries):,} geometries in {len(self.instances):,} places"
            )
        return self.mesh

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Scene):
            return NotImplemented
        mine, others = self._store, other._store
        return self._settings() == other._settings() and (mine is others or (mine.is_as_made and others.is_as_made))

    def __repr__(self) -> str:
        """Name the objects, and the settings that are not the default ones; nothing is loaded."""
        defaults = {each.name: each.default for each in dataclasses.fields(self)}
        shown = {name: value for name, value in self._settings().items() if repr(value) != repr(defaults[name])}
        if not self._store.is_as_made:
            shown = {"geometries": len(self.geometries), "instances": len(self.instances)} | shown
        return f"Scene({', '.join(f'{name}={value!r}' for name, value in shown.items())})"

    def __hash__(self) -> int:
        return hash(tuple(self._settings().values()))

    def _settings(self) -> dict[str, Any]:
        return {each.name: getattr(self, each.name) for each in dataclasses.fields(self) if each.name != "_store"}


def _make(kind: type[_Settings], values: dict[str, Any]) -> _Settings:
    """Return settings of their values; an unknown name is refused."""
    for name in values:
        if name.startswith("_") or name not in {each.name for each in dataclasses.fields(kind)}:
            raise SceneError(f"{kind.__name__} has no setting {name[:_MAX_SHOWN]!r}")
    return kind(**values)


def _make_source(mesh: MeshLike) -> MeshSource:
    """Return the source of a mesh; a file is read later."""
    if isinstance(mesh, str | os.PathLike):
        return MeshSource(path=os.fspath(mesh))
    return MeshSource(mesh=as_mesh(mesh))


def as_plain(value: Any) -> Any:
    """Return a setting without Python's own types: a dataclass as a dict, an array or a tuple as a list."""
    if dataclasses.is_dataclass(value):
        return {each.name: as_plain(getattr(value, each.name)) for each in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {name: as_plain(item) for name, item in value.items()}
    if value is None or isinstance(value, str | bool):
        return value
    if isinstance(value, Integral):
        return int(value)
    if isinstance(value, Real):
        return float(value)
    return [as_plain(item) for item in value]


def as_setting(value: Any) -> Any:
    """Return a value of JSON as settings have it: lists are tuples, at every depth."""
    if isinstance(value, dict):
        return {name: as_setting(item) for name, item in value.items()}
    return tuple(map(as_setting, value)) if isinstance(value, list) else value
