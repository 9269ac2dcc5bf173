"""What a picture shows: the objects of a scene at one moment, with their trees, bounds and materials."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..bvh import Bvh, sah_cost, validate_tree
from ..geometry import Mesh
from ..geometry.spheres import Bounded
from ..scene.state import SceneState, dress_shapes
from ..structs import MAX_DEPTH
from ..trace.hits.surface import Surface
from ..trace.tracer import Opening
from ..trace.world.world import World
from ..views.cameras.bounds import SceneBounds
from .look_tables import Looks


@dataclass(frozen=True, eq=False)
class DrawnScene:
    """The objects of a world at one moment, apart from the device: a picture outlives that.

    Attributes
    ----------
    state : SceneState
    top : Bvh or None
        The tree over the instances; None for the only shape.
    surface : Surface
        What hits are refined on.
    trees : tuple of Bvh
        One for each geometry; none where they are not known on the host, or where there are none.
    """

    state: SceneState
    top: Bvh | None
    surface: Surface
    trees: tuple[Bvh, ...] = ()

    @classmethod
    def of_world(cls, world: World, opening: Opening | None = None) -> Self:
        """Return the objects of a world, which has the trees of its opening until a shape moves."""
        trees: tuple[Bvh, ...] = ()
        if opening is not None and world.state.shapes is opening.state.shapes:
            trees = opening.trees
        return cls(world.state, None if world.top is None else world.top.bvh, Surface.of_world(world), trees)

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
        return SceneBounds.of_state(self.state)

    @property
    def space(self) -> Bounded:
        """The shape whose local coordinates are those of pictures: the only one, or the boxes of the instances."""
        return self.state.shapes[0] if self.top is None else self.top.shape

    def validate(self, leaf_size: int | None) -> None:
        """Raise `ValidationError` unless all trees are right; `leaf_size` bounds the primitives of a leaf."""
        for bvh in self.trees:
            validate_tree(bvh, max_depth=MAX_DEPTH, max_leaf_size=leaf_size)
        if self.top is not None:
            validate_tree(self.top, max_depth=MAX_DEPTH, max_leaf_size=1)

    @cached_property
    def looks(self) -> Looks:
        """What `make_look_tables` has to know."""
        return Looks(*dress_shapes(self.state), self.state.colours)

    @property
    def notes(self) -> tuple[str, ...]:
        """Facts about the objects that a user should know."""
        notes = (shape.note for shape in self.state.shapes if not isinstance(shape, Mesh))
        return tuple(dict.fromkeys(filter(None, notes)))

    @cached_property
    def closed(self) -> NDArray[np.uint8]:
        """(n,) uint8: 1 for each instance that encloses a volume."""
        of_shapes = np.array([shape.is_watertight for shape in self.state.shapes], np.uint8)
        return of_shapes[self.state.geometry_ids]

    @cached_property
    def has_lamps(self) -> bool:
        """Whether a material of what is shown emits light."""
        shapes, shown = self.looks.shapes, np.unique(self.looks.shape_ids[self.state.masks > 0])
        looks = (appearance for number in shown if (appearance := shapes[number].appearance) is not None)
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
        together. What trees tell is None where they are not known.
        """
        meshes = [shape for shape in self.state.shapes if isinstance(shape, Mesh)]
        face_count = sum(mesh.face_count for mesh in meshes)
        top = () if self.top is None else (self.top,)
        report: dict[str, Any] = {
            "mesh": self.name,
            "triangles": face_count,
            "degenerate_triangles": sum(mesh.degenerate_count for mesh in meshes),
            **dict.fromkeys(("nodes", "depth", "sah_cost")),
        }
        if self.trees:
            report["nodes"] = sum(bvh.node_count for bvh in (*top, *self.trees))
            report["depth"] = sum(bvh.depth for bvh in top) + max(bvh.depth for bvh in self.trees)
            report["sah_cost"] = None if self.bvh is None else sah_cost(self.bvh)
        if self.mesh is not None:
            return report
        return report | {
            "spheres": sum(shape.prim_count for shape in self.state.shapes) - face_count,
            "geometries": self.state.geometry_count,
            "instances": self.state.instance_count,
            "placed_primitives": self.state.placed_prim_count,
        }
