"""The engine for every mesh of the process: what `install` changes in trimesh, and how `uninstall` changes it back.

A mesh keeps the engines that trimesh gave it. While the engine is installed, `Trimesh.ray` and `Trimesh.nearest` are
properties that stand in front of them; so it does not matter when a mesh was made, and nothing is left in any mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self
from weakref import WeakSet

import trimesh
from trimesh import proximity as trimesh_proximity

from ...device.info import DeviceInfo
from ...support.forks import make_lock
from .proximity import ProximityQuery, closest_point, signed_distance
from .ray import RayMeshIntersector
from .thickness import longest_ray, max_tangent_sphere, thickness
from .tracers import EngineOptions, Installed, find_tracer, kept, read_options

# Functions of `trimesh.proximity`, which its own classes and other modules of trimesh look up there when called.
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    each.__name__: each for each in (closest_point, signed_distance, longest_ray, max_tangent_sphere, thickness)
}


class Installation:
    """An installation; as a context manager it restores the previous one at the end of its block.

    Examples
    --------
    >>> import trimesh
    >>> from clbvh.integrations.trimesh import install, is_installed
    >>> with install():
    ...     print(is_installed())
    True
    >>> is_installed()
    False
    """

    def __init__(self, before: EngineOptions | None) -> None:
        self._before = before

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        with _lock:
            if self._before is None:
                uninstall()
            else:
                install(**self._before._asdict())


def install(*, device: DeviceInfo | str | int | None = None, layout: str = "auto") -> Installation:
    """Make clbvh the ray and proximity engine of every mesh in this process, whenever it is or was made.

    Parameters
    ----------
    device : DeviceInfo, str, int or None
    layout : str
        See `clbvh.Tracer`. The device is opened by the first query: a process may fork before that.

    Returns
    -------
    Installation
        A context manager, for those who want the engine in a block only.

    Raises
    ------
    ConfigError
        An unknown layout, or a device of another type.

    Notes
    -----
    ``mesh.ray`` and ``mesh.nearest`` are ours, unless something else was assigned to them by hand; so are the functions
    of `trimesh.proximity`. Copies of a mesh, meshes that are loaded, and primitives are meshes like any other. Another
    `install` changes the options. What trimesh does with rays or nearest points then uses clbvh: docs/trimesh.md has a
    table. Pickled meshes hold nothing of it: a process that is spawned calls `install` itself.

    For the whole process, from any thread.

    Examples
    --------
    >>> import trimesh
    >>> from clbvh.integrations.trimesh import RayMeshIntersector, install
    >>> mesh = trimesh.creation.box()
    >>> with install():
    ...     isinstance(mesh.copy().ray, RayMeshIntersector)
    True
    >>> isinstance(mesh.ray, RayMeshIntersector)
    False
    """
    options = read_options(device, layout)
    with _lock:
        before = Installed.options
        Installed.options = options
        if before is None:
            for name, function in _FUNCTIONS.items():
                _originals[name] = getattr(trimesh_proximity, name)
                setattr(trimesh_proximity, name, function)
            for engine in _ENGINES:
                setattr(trimesh.Trimesh, engine.name, engine)
        return Installation(before)


def uninstall() -> None:
    """Restore trimesh's own engines, and release device memory that no engine assigned by hand uses.

    Does nothing if clbvh is not installed. Functions of `trimesh.proximity` that other code has replaced since stay as
    they are.

    Examples
    --------
    >>> from clbvh.integrations.trimesh import is_installed, uninstall
    >>> uninstall()
    >>> is_installed()
    False
    """
    with _lock:
        if Installed.options is None:
            return
        Installed.options = None
        for name, function in _FUNCTIONS.items():
            if getattr(trimesh_proximity, name) is function:
                setattr(trimesh_proximity, name, _originals[name])
        for engine in _ENGINES:
            if trimesh.Trimesh.__dict__.get(engine.name) is engine:
                delattr(trimesh.Trimesh, engine.name)
        kept.clear()


def is_installed() -> bool:
    """Return whether clbvh is the engine of every mesh in this process.

    Examples
    --------
    >>> from clbvh.integrations.trimesh import install, is_installed
    >>> with install():
    ...     is_installed()
    True
    """
    return Installed.options is not None


class _EngineProperty:
    """Stands in front of an attribute that trimesh's constructor sets, and gives our engine instead of trimesh's.

    The attribute itself stays in the mesh's own dictionary, as if this were not here.
    """

    def __init__(self, name: str, make_engine: Callable[[Any, EngineOptions], Any]) -> None:
        self.name = name
        self._make_engine = make_engine
        # Engines of trimesh that were assigned by hand while this stood here.
        self._chosen: WeakSet[Any] = WeakSet()

    def __get__(self, mesh: Any, owner: type | None = None) -> Any:
        if mesh is None:
            return self
        own, options = self._find_own(mesh), Installed.options
        if options is None or not _is_of_trimesh(own) or own in self._chosen:
            return own
        return self._make_engine(mesh, options)

    def __set__(self, mesh: Any, engine: Any) -> None:
        # The constructor sets it once; later assignments are the user's.
        if self.name in mesh.__dict__ and _is_of_trimesh(engine):
            self._chosen.add(engine)
        mesh.__dict__[self.name] = engine

    def __delete__(self, mesh: Any) -> None:
        self._find_own(mesh)
        del mesh.__dict__[self.name]

    def _find_own(self, mesh: Any) -> Any:
        try:
            return mesh.__dict__[self.name]
        except KeyError:
            raise AttributeError(f"'{type(mesh).__name__}' object has no attribute '{self.name}'") from None


def _is_of_trimesh(engine: Any) -> bool:
    return type(engine).__module__.partition(".")[0] == "trimesh"


def _make_ray_engine(mesh: Any, options: EngineOptions) -> RayMeshIntersector:
    find_tracer(mesh, options, keep=True)
    return RayMeshIntersector(mesh, **options._asdict())


# Reentrant: a context manager holds it while it installs or uninstalls.
_lock = make_lock()
_originals: dict[str, Callable[..., Any]] = {}
_ENGINES = (
    _EngineProperty("ray", _make_ray_engine),
    # It looks its options up: the ray engine may have been assigned by hand.
    _EngineProperty("nearest", lambda mesh, _: ProximityQuery(mesh)),
)
