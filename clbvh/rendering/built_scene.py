"""The subject of a renderer: the objects of a scene at one moment, with their trees, bounds and materials."""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..builders.build import leaf_limit
from ..builders.tree_cache import BuildResult, get_trees
from ..bvh import Bvh, sah_cost, validate_tree
from ..device.session import DeviceSession
from ..errors import ConfigError, SceneError
from ..geometry import Mesh
from ..geometry.corners import Bounded
from ..scene.state import SceneState, dress_shapes
from ..structs import MAX_DEPTH
from ..trace.hits.surface import Surface
from ..trace.world.trees import BRUTE, check_fit
from ..trace.world.world import World, open_world
from .cameras.bounds import SceneBounds
from .look_tables import Looks
from .options import RenderOptions

# The cost is rays times primitives: with more of them than this, a picture would take hours.
BRUTE_LIMIT = 100_000


class BuiltScene:
    """The objects of a scene at one moment, with their trees.

    Parameters
    ----------
    state : SceneState
    options : RenderOptions
    bvh : Bvh, optional
        The tree of the only mesh, which is not built again.

    Attributes
    ----------
    state : SceneState
    trees : tuple of Bvh
        One for each geometry; none with the builder ``"brute"``.
    top : Bvh or None
        The tree over the instances; None for the only mesh.
    surface : Surface
        What hits are refined on, once `put` was called.
    made : BuildResult or None
        The sums over the trees that were made here, and one of them.

    Raises
    ------
    SceneError
        Nothing is placed in the scene.
    ConfigError
        The builder makes no trees, and there are too many primitives without them.
    """

    def __init__(self, state: SceneState, options: RenderOptions, bvh: Bvh | None = None) -> None:
        if state.instance_count == 0:
            raise SceneError("the scene is empty: add a geometry and place it, as in scene.place(scene.add(mesh))")
        self.state, self._options = state, options
        self.trees: tuple[Bvh, ...] = ()
        self.top: Bvh | None = None
        self.surface: Surface
        self.made: BuildResult | None = None
        if options.builder == BRUTE:
            if (count := self.state.placed_prim_count) > BRUTE_LIMIT:
                raise ConfigError(
                    f"the brute builder tests every primitive for every ray: {count:,} "
                    f"{'triangles' if self.mesh else 'primitives'} are more than its limit of {BRUTE_LIMIT:,}"
                )
        elif bvh is not None:
            self.trees = (bvh,)
        else:
            self._build()

    def _build(self) -> None:
        device = self._options.device
        check_fit(device, self._options.chosen_layout, self.state.shapes)
        made = get_trees(self.state.shapes, lambda _: self._options, device)
        self.trees = tuple(each.bvh for each in made)
        self.made = BuildResult(
            made[0].bvh,
            max(each.workers for each in made),
            all(each.from_cache for each in made),
            {phase: sum(each.timings_ms[phase] for each in made) for phase in ("cache", "build")},
            tuple(dict.fromkeys(note for each in made for note in each.notes)),
        )

    @property
    def mesh(self) -> Mesh | None:
        """The only mesh, in its place; None for a scene of several objects, or of one that is moved."""
        shape = self.state.lone_shape
        return shape if isinstance(shape, Mesh) and self.state.geometry_count == 1 else None

    @property
    def bvh(self) -> Bvh | None:
        """The tree of the only mesh; None with the builder ``"brute"``, and for a scene of several objects."""
        return self.trees[0] if self.mesh is not None and self.trees else None

    @property
    def name(self) -> str:
        """The name of the mesh or of the only geometry, or the number of instances."""
        if self.mesh is not None:
            return self.mesh.name
        names = self.state.names
        return names[0] if len(names) == 1 else f"{self.state.instance_count:,} instances"

    @cached_property
    def bounds(self) -> SceneBounds:
        """Where everything is."""
        if self.mesh is not None:
            return SceneBounds.of_mesh(self.mesh)
        with np.errstate(over="ignore", invalid="ignore"):  # `put` refuses objects that float64 has no room for
            return SceneBounds(self.state.shapes, self.state.geometry_ids, self.state.transforms)

    @property
    def space(self) -> Bounded:
        """The shape whose local coordinates are those of pictures: the only one, or the boxes of the instances."""
        return self.state.shapes[0] if self.top is None else self.top.shape

    def put(self, session: DeviceSession) -> World:
        """Put everything on the device."""
        world = open_world(session, self.state, self.trees or None, self._options.chosen_layout)
        self._show(world)
        return world

    def _show(self, world: World) -> None:
        self.top, self.surface = None if world.top is None else world.top.bvh, Surface.of_world(world)

    def at(self, world: World) -> BuiltScene:
        """Return the scene with the transforms of another world; trees and materials are shared."""
        moved = copy(self)
        vars(moved).pop("bounds", None)
        moved.state = world.state
        moved._show(world)
        return moved

    def validate(self) -> None:
        """Raise `ValidationError` unless all trees are right."""
        leaf_size = None if self.made is None else leaf_limit(self._options.builder, self._options.build)
        for bvh in self.trees:
            validate_tree(bvh, max_depth=MAX_DEPTH, max_leaf_size=leaf_size)
        if self.top is not None:
            validate_tree(self.top, max_depth=MAX_DEPTH, max_leaf_size=1)

    @cached_property
    def looks(self) -> Looks:
        """What `make_look_tables` has to know."""
        return Looks(*dress_shapes(self.state), self.state.colours)

    @cached_property
    def has_lamps(self) -> bool:
        """Whether a material emits light."""
        looks = (shape.appearance for shape in self.looks.shapes if shape.appearance is not None)
        return any(any(material.emission) for each in looks for material in each.materials)

    def to_local(self) -> NDArray[np.float64]:
        """Return (n, 4, 4) float64: the map from each instance's coordinates to the local ones of pictures."""
        maps = np.array(self.state.transforms, np.float64)
        maps[:, :3, 3] -= self.space.origin
        maps[:, :3] *= self.space.scale
        return maps

    def report(self) -> dict[str, Any]:
        """Return the numbers of objects and trees, for `Picture.report`.

        Triangles, spheres and nodes are those in memory, each geometry once; the depth is the greatest of both levels
        together.
        """
        meshes = [shape for shape in self.state.shapes if isinstance(shape, Mesh)]
        face_count = sum(mesh.face_count for mesh in meshes)
        top = () if self.top is None else (self.top,)
        report: dict[str, Any] = {
            "mesh": self.name,
            "triangles": face_count,
            "degenerate_triangles": sum(mesh.degenerate_count for mesh in meshes),
            "nodes": sum(bvh.node_count for bvh in (*top, *self.trees)),
            "depth": sum(bvh.depth for bvh in top) + max((bvh.depth for bvh in self.trees), default=0),
            "sah_cost": None if self.bvh is None else sah_cost(self.bvh),
        }
        if self.mesh is not None:
            return report
        return report | {
            "spheres": sum(shape.prim_count for shape in self.state.shapes) - face_count,
            "geometries": self.state.geometry_count,
            "instances": self.state.instance_count,
            "placed_primitives": self.state.placed_prim_count,
        }
