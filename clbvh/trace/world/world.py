"""What rays and points are cast at: shapes with their trees on a device, instances, and the tree over these.

A world is a value. A mesh, a tree or a group of spheres is a world of one shape; where that is in its own place, seen
by every mask but 0, the world is lone: its kernels know of no instances, and nothing else differs.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...bvh import Bvh
from ...device.host.library import HostKernel
from ...device.host.variants import TOP_STACK_SIZE
from ...device.session import DeviceSession
from ...geometry import Mesh, Shape
from ...kinds import KINDS, Kind
from ...scene.state import SceneState
from ...structs import EXACT_RAY, HIT, RAY_LOW, WORLD_HIT
from ...tree_layouts import LAYOUTS
from .exact import NOT_EXACT, put_exact_arrays, spans_scales
from .metrics import LazyMetrics
from .refine_buffers import RefineBuffers
from .surface_arrays import FLOAT_ROUNDING, SurfaceArrays, lone_arrays, make_surface_arrays, move_instances
from .surplus import Surplus
from .top_tree import TopTree
from .tree_box import TreeBox
from .trees import BRUTE, DeviceTrees, NewTree, check_layout, choose_layout

if TYPE_CHECKING:
    from ...builders.options import BuildOptions


@dataclass(frozen=True, eq=False)
class World:
    """Shapes and instances in the memory of a device, at one moment.

    Attributes
    ----------
    state : SceneState
    trees : DeviceTrees
        By geometry id.
    find_arrays : function
        Returns `arrays`.
    box : TreeBox
        Around everything; its local coordinates are those of rays and points on the device.
    top : TopTree or None
        The tree over the instances; None of a lone shape.
    top_buffers : dict of str to buffer
        The arrays of `top`, as the kernels call them.
    metrics : LazyMetrics
        What distances need of the instances.
    refine_buffers : RefineBuffers
        What the device needs to refine hits.
    exact : dict of str to buffer
        What kernels need that decide in float64, see `exact.py`.
    """

    state: SceneState
    trees: DeviceTrees
    find_arrays: Callable[[], SurfaceArrays]
    box: TreeBox
    top: TopTree | None
    top_buffers: dict[str, Any]
    metrics: LazyMetrics
    refine_buffers: RefineBuffers
    exact: dict[str, Any]

    @property
    def arrays(self) -> SurfaceArrays:
        """The scene in float64, for hits and points."""
        return self.find_arrays()

    @property
    def is_lone(self) -> bool:
        """Whether there is one shape, in its own place."""
        return self.top is None

    @property
    def layout(self) -> str:
        """Name of the layout of the shapes' trees; that over the instances is `bvh2` in any case."""
        return self.trees.layout

    @cached_property
    def arguments(self) -> dict[str, Any]:
        """What every kernel is told of the world, by the names of its arguments; see cl/world/world.cl."""
        names = (*(kind.buffer for kind in KINDS.values()), "top_nodes", "instances")
        buffers: dict[str, Any] = dict.fromkeys(names) | self.trees.buffers | self.top_buffers | self.exact
        if self.is_lone:
            own = self.state.shapes[0].kind.buffer
            buffers |= {own: None} | {"blocks": buffers[own]}
        return buffers | {"block_count": np.int32(self.trees.trees[0].block_count if self.is_lone else 0)}

    @cached_property
    def box_numbers(self) -> NDArray[np.float64]:
        """The numbers of the box."""
        return self.box.as_numbers()

    @cached_property
    def kernels(self) -> dict[str, HostKernel]:
        """The kernels of the host that are told of the world, by their names; see `Caster.kernel_at`."""
        return {}

    @cached_property
    def defines(self) -> dict[str, int]:
        """Macros of every kernel that traverses the world."""
        trees = self.trees
        defines = make_defines(trees.layout, trees.stack_size, is_lone=self.is_lone, kinds=self.kinds)
        return defines | {"EXACT": 1} if self.is_exact else defines

    @property
    def is_exact(self) -> bool:
        """Whether float64 decides what rays hit."""
        return self.exact is not NOT_EXACT

    @property
    def kinds(self) -> set[Kind]:
        """Of the primitives that rays can meet; one of a lone world: nothing places the other shapes."""
        return {self.state.shapes[0].kind} if self.is_lone else self.trees.kinds

    @property
    def hit_dtype(self) -> np.dtype:
        """Of hits on the device."""
        return HIT if self.is_lone else WORLD_HIT

    @property
    def has_entry_points(self) -> bool:
        """Whether rays may begin elsewhere than at the root, see cl/traversal/entry_point.cl."""
        return LAYOUTS[self.layout].is_wide

    @property
    def node_bytes(self) -> int:
        """Size of a node."""
        return self.trees.dtypes["nodes"].itemsize

    @cached_property
    def memory_bytes(self) -> int:
        """Bytes of all buffers."""
        top = 0 if self.top is None else self.top.nodes.nbytes + self.top.instances.nbytes
        return self.trees.memory_bytes + top

    @cached_property
    def mesh(self) -> Mesh | None:
        """The mesh of a lone world; None of others."""
        shape = self.state.shapes[0] if self.is_lone else None
        return shape if isinstance(shape, Mesh) else None

    @property
    def most_hits(self) -> int:
        """Most hits that a ray can have."""
        return self.state.placed_prim_count * max(kind.most_hits for kind in self.kinds)

    @property
    def low_dtype(self) -> np.dtype | None:
        """Of what the device gets of a ray besides the ray in float32, if anything."""
        return EXACT_RAY if self.is_exact else None if self.is_lone else RAY_LOW

    @cached_property
    def surplus(self) -> Surplus | None:
        """The faces that a count of hits leaves out to tell the inside, if there are any."""
        return Surplus.find(self.state)

    def shapes_of(self, instance_ids: NDArray[np.integer] | None) -> list[Shape]:
        """Return the shapes that some instances place, or all of them for None; without those whose mask is 0."""
        chosen = slice(None) if instance_ids is None else instance_ids
        geometry_ids = self.state.geometry_ids[chosen][self.state.masks[chosen] > 0]
        return [self.state.shapes[geometry_id] for geometry_id in np.unique(geometry_ids)]

    def with_state(self, state: SceneState, session: DeviceSession) -> World:
        """Return the world with other transforms or masks; all but the tree over the instances is shared.

        Parameters
        ----------
        state : SceneState
        session : DeviceSession
            A branch of the owner's, for this thread.
        """
        return place(self.trees, state, session, None if self.is_lone else self.arrays, self.refine_buffers)


def make_defines(layout: str, stack_size: int, *, is_lone: bool, kinds: Collection[Kind]) -> dict[str, int]:
    """Return the macros of every kernel that traverses a world; see cl/world/world.cl."""
    defines = {"LAYOUT": LAYOUTS[layout].number, "STACK_SIZE": stack_size, "LONE": int(is_lone)}
    defines["KINDS"] = sum(kind.bit for kind in kinds)
    return defines if is_lone else defines | {"TOP_STACK_SIZE": TOP_STACK_SIZE}


def is_lone(state: SceneState) -> bool:
    """Return whether a scene is one shape in its own place; others that nothing places may come behind it."""
    return state.lone_shape is not None and int(state.geometry_ids[0]) == 0


def with_any_instance(state: SceneState) -> SceneState:
    """Return a scene; one without instances with an instance that nothing sees, as kernels need one."""
    if state.instance_count:
        return state
    return replace(
        state, shapes=state.shapes or (Mesh.from_arrays(np.eye(3), [[0, 1, 2]]),), geometry_ids=np.zeros(1, np.int32),
        transforms=np.eye(4)[None], masks=np.zeros(1, np.uint32),
    )  # fmt: skip


def open_world(
    session: DeviceSession, state: SceneState, bvhs: Sequence[Bvh | BuildOptions] | None, layout: str = "auto"
) -> World:
    """Put a scene on a device.

    Parameters
    ----------
    session : DeviceSession
        Owns the buffers.
    state : SceneState
    bvhs : sequence of Bvh or BuildOptions, or None
        The tree of each geometry, or the options by which the device builds it. Without any: no tree but the one over
        the instances, and the layout ``"brute"``, whatever is asked: each primitive of an instance is tested against
        each ray that meets its box.
    layout : str
        Of the geometries' trees; ``"auto"`` takes what suits the device.

    Raises
    ------
    SceneError
        An instance is too small beside the scene.
    ConfigError
        An unknown layout, or a tree that is too deep.
    DeviceError
        The scene does not fit the device.
    """
    check_layout(layout)
    shapes = with_any_instance(state).shapes
    chosen = choose_layout(layout, session.info, shapes) if bvhs else BRUTE
    if bvhs:
        new = NewTree.make_all(session, shapes, bvhs, chosen)
    else:
        new = [NewTree.without_nodes(shape) for shape in shapes]
    trees = DeviceTrees.join(session, shapes, new, chosen)
    # Queries have queues of their own, which do not wait for trees that the device still writes.
    session.finish()
    return place(trees, state, session)


def place(
    trees: DeviceTrees, state: SceneState, session: DeviceSession, arrays: SurfaceArrays | None = None,
    before: RefineBuffers | None = None,
) -> World:  # fmt: skip
    """Return the world of trees on a device and the instances of a scene.

    Parameters
    ----------
    trees : DeviceTrees
    state : SceneState
    session : DeviceSession
        The owner of the trees, or a branch of it.
    arrays : SurfaceArrays, optional
        Of the state with other transforms, if they are there already.
    before : RefineBuffers, optional
        Of the world that this one follows.

    Raises
    ------
    SceneError
        An instance is too small beside the scene.
    DeviceError
        The device has no room for the tree over the instances.
    """
    if is_lone(state):
        # A mesh on the device is downloaded when a hit needs float64.
        find_arrays = cache(partial(lone_arrays, state.shapes[0]))
        lone, metrics = state.shapes[0], LazyMetrics(find_arrays, trees.box.scale)
        refine_buffers = RefineBuffers(find_arrays, lone if isinstance(lone, Mesh) else None, before)
        exact = _put_exact(trees, state, session, find_arrays, None, refine_buffers)
        fitting = _fit_rounding(find_arrays, exact)
        return World(state, trees, fitting, trees.box, None, {}, metrics, refine_buffers, exact)
    placed = with_any_instance(state)
    if arrays is None:
        arrays = make_surface_arrays(placed.shapes, placed.geometry_ids, placed.transforms)
    else:
        arrays = move_instances(arrays, placed.transforms)
    top = TopTree.build(arrays, trees.ranges, placed.masks)
    buffers = {}
    for name, array in (("top_nodes", top.nodes), ("instances", top.instances)):
        buffers[name] = trees.session.allocate(array.nbytes, writable=False)
        session.write(buffers[name], array)
    find_arrays = cache(lambda: arrays)
    metrics = LazyMetrics(find_arrays, float(top.bvh.shape.scale))
    refine_buffers = RefineBuffers(find_arrays, None, before)
    exact = _put_exact(trees, state, session, find_arrays, top, refine_buffers)
    fitting = _fit_rounding(find_arrays, exact)
    return World(state, trees, fitting, TreeBox.around(top.bvh), top, buffers, metrics, refine_buffers, exact)


def _put_exact(
    trees: DeviceTrees, state: SceneState, session: DeviceSession, find_arrays: Callable[[], SurfaceArrays],
    top: TopTree | None, refine: RefineBuffers,
) -> dict[str, Any]:  # fmt: skip
    if not spans_scales(state.shapes, top):
        return NOT_EXACT
    return put_exact_arrays(trees.session, session, find_arrays(), top, refine)


def _fit_rounding(find_arrays: Callable[[], SurfaceArrays], exact: dict[str, Any]) -> Callable[[], SurfaceArrays]:
    """Return `find_arrays` with the rounding of float32 where that decides: a device may have no doubles."""
    return find_arrays if exact is not NOT_EXACT else cache(lambda: find_arrays()._replace(rounding=FLOAT_ROUNDING))


def with_instances(world: World, top_buffers: dict[str, Any]) -> World:
    """Return the world with other arrays of the tree over the instances: of some of them, see `prune_top`."""
    chosen = replace(world, top_buffers=top_buffers)
    vars(chosen)["surplus"] = world.surplus  # cached: it is that of all instances
    return chosen
