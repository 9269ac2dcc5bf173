"""The public class for ray and point queries: how a source becomes a scene on a device, and how it is closed.

Its queries are in `ray_queries`, `sight_queries`, `point_queries` and `pair_queries`, its changes in `moves`. A tracer
that was pickled is opened once in each process where it arrives; what is handed out there are tracers of that one's
world, with changes of their own.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, Self, TypeAlias

from ..bvh import Bvh
from ..device.info import DeviceInfo
from ..device.open import open_device
from ..device.session import DeviceSession
from ..device.times import CommandTimes
from ..errors import QueryError
from ..geometry import MeshLike, Shape, Spheres
from ..geometry.as_mesh import HasGraph
from ..layouts.device_mesh import open_session, take_shape
from ..scene.scene import Scene
from ..scene.state import SceneState
from ..support.context_manager import ContextManager
from ..support.forks import make_lock
from ..support.opened import digest_of, open_once
from .clearance.walk import HostTrees
from .launch import Caster
from .moves import Moves
from .pair_queries import PairQueries
from .point_queries import PointQueries
from .points.winding import WindingTrees
from .sight_queries import SightQueries
from .world.changes import Changes
from .world.trees import BRUTE, check_brute, check_fit, check_layout
from .world.world import open_world

if TYPE_CHECKING:
    from ..builders.options import BuildOptions
    from ..builders.tree_cache import BuildResult
    from ..builders.tree_options import TreeOptions

Traceable: TypeAlias = Scene | Bvh | Spheres | MeshLike
"""Anything that rays can be cast at: a `Scene`, a `Bvh`, `Spheres`, or a `MeshLike`."""

Plans: TypeAlias = "Sequence[Bvh | BuildOptions] | None"
"""The tree of each geometry, or the options by which the device builds it; None for primitives without a tree."""


class Opening(NamedTuple):
    """What a tracer was opened from.

    Attributes
    ----------
    scene : Scene
        Its handles name geometries and instances.
    state : SceneState
        The scene as it was.
    tree : Bvh or None
        That was given for the only mesh.
    device : DeviceInfo, str, int or None
        As it was asked for.
    layout : str
    building : str or TreeOptions
        The quality of the trees that are built, or all options of trees that are built on the host.
    ref : SceneRef, optional
        That names the scene.
    built : BuildResult, optional
        The trees that were built by options, of the scene as it was.
    """

    scene: Scene
    state: SceneState
    tree: Bvh | None
    device: DeviceInfo | str | int | None
    layout: str
    building: str | TreeOptions
    ref: Any = None
    built: BuildResult | None = None

    @classmethod
    def plan(
        cls, scene: Scene, tree: Bvh | None, device: DeviceInfo | str | int | None, layout: str,
        building: str | TreeOptions,
    ) -> tuple[Self, Plans]:  # fmt: skip
        """Return the opening of a scene as it is now, and the plans of its trees; those of options are built here."""
        state = scene.snapshot()
        check_fit(device, layout, state.shapes)
        opening = cls(scene, state, tree, device, layout, building)
        if tree is not None:
            return opening, [tree]
        if isinstance(building, str):
            return opening, _plan_trees(state.shapes, building)
        if building.builder == BRUTE:
            check_brute(state.placed_prim_count)
            return opening, None
        built = _find_trees(state.shapes, building, device)
        return opening._replace(built=built), built.bvhs

    @property
    def trees(self) -> tuple[Bvh, ...]:
        """The trees of the scene as it was, as far as the host has them."""
        if self.tree is not None:
            return (self.tree,)
        return () if self.built is None else self.built.bvhs


class Tracer(SightQueries, PointQueries, PairQueries, Moves):
    """Casts rays at one mesh or scene on one device; a context manager.

    Any number of threads may use one tracer, and so may forked children on the host. On a device of OpenCL they cannot:
    their queries raise `DeviceError`, and closing the tracer there changes nothing.

    Tracers pickle as their present source, the device as it was asked for, layout and quality, and open again where
    they arrive, once in each process.

    Parameters
    ----------
    source : Scene, Bvh, Spheres, Mesh, str, path, (vertices, faces), or an object of trimesh, pyvista, Open3D, meshio
        A scene as it is now; a tree; spheres; or a mesh, see `clbvh.MeshLike`. A `trimesh.Scene` becomes a `Scene`, and
        a point cloud spheres, see `clbvh.Spheres.from_points`. Trees are built in this process, as `clbvh.build` does.
        A path names a mesh file, one of points, or a scene, see `clbvh.open_scene`. Vertices and faces may be a
        `pyopencl.array.Array`, float32 or float64, and int32: with the quality ``"fast"`` they stay on their device,
        where the tracer then is; see `clbvh.build`.
    device : DeviceInfo, str, int, pyopencl.Device or None
        The device: a number, part of its name, ``"gpu"`` or ``"host"``; by default a GPU, if there is one, or else the
        host.
    layout : str
        ``"auto"``, ``"bvh2"``, ``"bvh4"``, ``"bvh8"``, or ``"bvh8c"``, which takes half the memory of ``"bvh8"``.
    quality : str
        Of the trees that are built: ``"default"``; ``"fast"``, built on the device, which suits meshes that change; or
        ``"high"``. See `clbvh.BuildOptions`. A finished tree is taken as it is.

    Raises
    ------
    DeviceError
        There is no such device, the tree does not fit it, or this process was forked from one that has used OpenCL.
    ConfigError
        An unknown layout or quality.
    MeshError
        The source is neither a tree nor a valid mesh.

    Examples
    --------
    >>> import clbvh
    >>> triangle = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]
    >>> with clbvh.Tracer(triangle) as tracer:
    ...     print(tracer)
    ...     tracer.closest_hit([[0.25, 0.25, 2]], [[0, 0, -1]]).t
    Tracer('mesh', triangles=1, device=..., layout=...)
    array([2.])
    """

    def __init__(
        self,
        source: Traceable,
        *,
        device: DeviceInfo | str | int | None = None,
        layout: str = "auto",
        quality: str = "default",
    ) -> None:
        check_layout(layout)
        if isinstance(source, str | os.PathLike):
            # Imported here: few tracers read a file.
            from ..files.open_scene import open_scene

            source = open_scene(source)[0]
        elif isinstance(source, HasGraph):
            source = Scene(source)
        shape = None if isinstance(source, Scene) else _find_shape(source, device)
        scene = source if isinstance(source, Scene) else Scene(shape)
        tree = source if isinstance(source, Bvh) else None
        opening, plans = Opening.plan(scene, tree, device, layout, quality)
        # A tree on the device is built once that is open.
        self._open(opening, plans, lambda: open_session(shape, device))

    def _open(self, opening: Opening, plans: Plans, find_session: Callable[[], DeviceSession]) -> None:
        """Put the trees on the device: what the constructor does when it knows them."""
        session = find_session()
        try:
            caster = Caster(session, open_world(session, opening.state, plans, opening.layout))
        except BaseException:
            session.close()
            raise
        self._start(caster, opening)

    @classmethod
    def _opened(cls, opening: Opening, plans: Plans, session: DeviceSession | None = None) -> Self:
        """Return a tracer of trees that are planned, on its device or in the session given."""
        tracer = object.__new__(cls)
        tracer._open(opening, plans, lambda: session or open_device(opening.device))
        return tracer

    def _start(self, caster: Caster, opening: Opening) -> None:
        self._caster, self._opening = caster, opening
        self._changes = Changes(opening.scene, opening.state, opening.tree or opening.building)
        self._updating = make_lock()
        self._host_trees = HostTrees()
        self._winding_trees = WindingTrees(self._host_trees)

    @property
    def device(self) -> DeviceInfo:
        """The device that the tree is on."""
        return self._caster.session.info

    @property
    def context(self) -> Any:
        """The `pyopencl.Context` of the tracer: arrays in it need not leave the device, see `update`.

        None of the host.
        """
        return self._caster.session.context

    @property
    def queue(self) -> Any:
        """A `pyopencl.CommandQueue` in `context`, which runs its commands one after the other.

        A query of arrays on the device waits for it, and the hits that it leaves there are complete. None on the host.
        """
        return self._caster.session.queue

    @property
    def layout(self) -> str:
        """The layout that the tree has on the device."""
        return self._caster.world.layout

    @property
    def memory_bytes(self) -> int:
        """Device memory for trees, primitives and instances; the first `update` of a mesh doubles it."""
        world = self._caster.world
        return world.memory_bytes + world.refine_buffers.memory_bytes + self._changes.memory_bytes

    @property
    def timings_ms(self) -> dict[str, float]:
        """Milliseconds on the device so far, in all threads: upload, kernel, download."""
        return self._caster.session.times.sums_ms()

    @property
    def is_closed(self) -> bool:
        """Whether the tracer takes no more queries."""
        return self._caster.calls.is_closed

    def close(self) -> None:
        """Give the device's memory back. Closing twice is allowed.

        Queries that other threads are running get their results, and this waits for them, but for few rays on the host;
        later ones raise `QueryError`.

        Examples
        --------
        >>> import clbvh
        >>> tracer = clbvh.Tracer(clbvh.make_shape("icosphere", triangles=1000))
        >>> tracer.close()
        >>> tracer.is_closed
        True
        """
        self._caster.close()

    def __reduce__(self) -> tuple[Any, ...]:
        if self.is_closed:
            raise QueryError("a closed tracer cannot be pickled: pickle it before, or what it was opened from")
        opening, state = self._opening, self._caster.world.state
        scene, _, tree, device, layout, building, ref, _ = opening
        if ref is not None and state is opening.state:
            return partial(ref.tracer, device=device, layout=layout, quality=building), ()
        # Of moved vertices, it is built again.
        tree = tree if tree is not None and state.shapes[0] is tree.shape else None
        asked = device, layout, building
        key = digest_of((state, None if tree is None else (tree.nodes, tree.prim_ids), asked))
        return _reopen, (key, scene._at(state), tree, *asked)

    def _twin(self, scene: Scene) -> Tracer:
        """Return a tracer of the same world, which never was changed: its changes and its end are its own.

        Handles are those of the given scene, which has the same objects.
        """
        twin, opening = object.__new__(Tracer), self._opening
        # Of the world's shapes, so that those of the scene need not stay.
        opening = opening._replace(scene=scene._at(opening.state))
        caster = Caster(self._caster.session.branch(), self._caster.world)
        caster.session.times = CommandTimes()
        twin._start(caster, opening)
        twin._changes.share(caster.world)
        return twin

    def __repr__(self) -> str:
        mesh = self._caster.world.mesh
        name = "scene" if mesh is None else mesh.name
        counts = self._caster.world.state._describe()
        return f"Tracer({name!r}, {counts}, device={self.device.name!r}, layout={self.layout!r})"


def _find_shape(source: Bvh | Shape | MeshLike, device: DeviceInfo | str | int | None) -> Shape:
    if isinstance(source, Bvh):
        return source.mesh
    return take_shape(source, device, or_else="a clbvh.Scene, clbvh.Spheres, a clbvh.Bvh")


def _plan_trees(shapes: Sequence[Shape], quality: str) -> Sequence[Bvh | BuildOptions]:
    # Imported here: a tracer of a finished tree needs no builder.
    from ..builders.build import plan_trees

    return plan_trees(shapes, quality)


def _find_trees(shapes: Sequence[Shape], options: TreeOptions, device: Any) -> BuildResult:
    from ..builders.tree_cache import get_trees

    return get_trees(shapes, lambda _: options, device)


def _reopen(
    key: str, scene: Scene, tree: Bvh | None, device: Any, layout: str, building: str | TreeOptions
) -> Tracer:  # fmt: skip
    """Return a tracer that was pickled: its world is opened once in this process."""

    def open_anew() -> Tracer:
        return Tracer._opened(*Opening.plan(scene, tree, device, layout, building))

    return open_once(key, open_anew)._twin(scene)


# Errors of Python about arguments name a function by this.
for _owner in Tracer.__mro__[1:-1]:
    for _name, _method in vars(_owner).items():
        if inspect.isfunction(_method) and _owner is not ContextManager:
            _method.__qualname__ = f"Tracer.{_name}"
