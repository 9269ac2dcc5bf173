"""What a renderer shows, a mesh or a scene: how it is loaded, gets its trees, and goes to the device."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..builders.build import build, leaf_limit
from ..builders.options import MAX_DEPTH
from ..builders.tree_cache import BuildResult, get_tree
from ..bvh import Bvh, validate_tree
from ..device.session import DeviceSession
from ..errors import ConfigError, SceneError
from ..geometry import Mesh
from ..geometry.box_mesh import mesh_of
from ..scene.state import SceneState, dress_shapes
from ..trace.device_tree import BRUTE, DeviceTree
from ..trace.hits.scene_arrays import make_scene_arrays
from ..trace.hits.surface import SceneSurface
from ..trace.scene.device_scene import DeviceScene
from ..trace.scene.merging import NOTHING_MERGED, Merging
from .cameras.bounds import SceneBounds
from .cameras.camera import Camera
from .film.light_tables import local_maps
from .film.look_tables import Looks
from .options import RenderOptions
from .scene import Scene
from .view import Ground, make_view

# The cost is rays times primitives: with more of them than this, a picture would take hours.
BRUTE_LIMIT = 100_000


def check_brute_limit(count: int, primitives: str) -> None:
    """Raise `ConfigError` if there are too many `primitives`, a plural, for a picture without a tree."""
    if count > BRUTE_LIMIT:
        raise ConfigError(
            f"the brute builder tests every primitive for every ray: {count:,} {primitives} are more than its limit of "
            f"{BRUTE_LIMIT:,}"
        )


@dataclass(frozen=True, eq=False, repr=False)
class SceneObjects:
    """The objects of a scene at the moment at which its renderer was made.

    Attributes
    ----------
    state : SceneState
    surface : SceneSurface
        What hits are refined on.
    trees : tuple of Bvh or None
        One for each geometry, None for one whose instances are merged; none with the builder ``"brute"``.
    top : Bvh
        The tree over the instances, and over the merged meshes.
    merging : Merging
    """

    state: SceneState
    surface: SceneSurface
    trees: tuple[Bvh | None, ...]
    top: Bvh
    merging: Merging

    @property
    def instance_count(self) -> int:
        """Number of instances."""
        return self.state.instance_count

    @property
    def name(self) -> str:
        """The name of the only geometry, or the number of instances."""
        names = self.state.names
        return names[0] if len(names) == 1 else f"{self.instance_count:,} instances"

    def report(self) -> dict[str, Any]:
        """Return the numbers of objects and trees, for `Picture.report`.

        Triangles, spheres and nodes are those in memory, each geometry once; the depth is the greatest of both levels
        together.
        """
        shapes, trees = self.state.shapes, self.merging.list_trees(self.trees)
        meshes = [shape for shape in shapes if isinstance(shape, Mesh)]
        prim_counts = np.array([shape.prim_count for shape in shapes], np.int64)
        face_count = sum(mesh.face_count for mesh in meshes)
        return {
            "mesh": self.name,
            "triangles": face_count,
            "degenerate_triangles": sum(mesh.degenerate_count for mesh in meshes),
            "spheres": int(prim_counts.sum()) - face_count,
            "geometries": len(shapes),
            "instances": self.instance_count,
            "placed_primitives": int(prim_counts[self.state.geometry_ids].sum()),
            "nodes": self.top.node_count + sum(bvh.node_count for bvh in trees),
            "depth": self.top.depth + max((bvh.depth for bvh in trees), default=0),
            "sah_cost": None,
        }


class MeshSubject:
    """One mesh. The steps are called in their order: load, build, put.

    Parameters
    ----------
    scene : Scene
        Of one mesh, which is not loaded yet.
    mesh : Mesh or None
        The mesh, where it is loaded.
    bvh : Bvh or None
        Its tree, where there is one.
    options : RenderOptions

    Attributes
    ----------
    mesh : Mesh
        In the scene's coordinates.
    bvh : Bvh or None
        None with the builder ``"brute"``.
    made : BuildResult or None
        The tree, if it was made here.
    """

    def __init__(self, scene: Scene, mesh: Mesh | None, bvh: Bvh | None, options: RenderOptions) -> None:
        self._scene, self._options = scene, options
        self._loaded = mesh
        self.bvh = bvh if options.builder != BRUTE else None
        self.made: BuildResult | None = None

    def load(self) -> None:
        """Find the mesh."""
        scene = self._scene
        self.mesh = scene.transform.apply(scene.only_mesh().load()) if self._loaded is None else self._loaded

    def build(self) -> None:
        """Find the tree."""
        if self._options.builder == BRUTE:
            check_brute_limit(self.mesh.face_count, "triangles")
        elif self.bvh is None:
            self.made = get_tree(self.mesh, self._options)
            self.bvh = self.made.bvh

    def put(self, session: DeviceSession) -> DeviceTree:
        """Put the mesh and its tree on the device."""
        return DeviceTree(session, self.mesh, self.bvh, self._options.chosen_layout)

    def validate(self) -> None:
        """Raise `ValidationError` unless the tree is right."""
        if self.bvh is not None:
            leaf_size = None if self.made is None else leaf_limit(self._options.builder, self._options.build)
            validate_tree(self.bvh, max_depth=MAX_DEPTH, max_leaf_size=leaf_size)

    @cached_property
    def extent(self) -> SceneBounds:
        """What a camera that sees everything has to see."""
        return SceneBounds.of_mesh(self.mesh)

    def looks(self) -> Looks:
        """Return what `make_look_tables` has to know."""
        return Looks((self.mesh,), np.zeros(1, np.int64), np.full((1, 3), np.nan))

    def to_local(self) -> NDArray[np.float64]:
        """Return (1, 4, 4) float64: the map from the mesh's coordinates to the local ones of pictures."""
        return local_maps(np.eye(4)[None], self.mesh.origin, self.mesh.scale)

    def make_view(self, scene: Scene, camera: Camera, ground: Ground | None, framed: SceneBounds) -> NDArray[np.void]:
        """Return the view, (1,) `structs.VIEW`; `framed` is what counts, see `make_view`."""
        return make_view(scene, camera, self.mesh, ground=ground, framed_box=framed.box_in(self.mesh))

    def picture_parts(self) -> dict[str, Any]:
        """Return what a `Picture` keeps of the subject, by its attributes."""
        return {"mesh": self.mesh, "bvh": self.bvh}


class SceneSubject:
    """The objects of a scene. The steps are called in their order: load, build, put.

    Parameters
    ----------
    state : SceneState
    options : RenderOptions

    Attributes
    ----------
    mesh, bvh
        None: there is no single one.
    extent : SceneBounds
    made : BuildResult or None
        The sums over all trees, and one of the trees; None with the builder ``"brute"``.

    Raises
    ------
    SceneError
        Nothing is placed in the scene.
    ConfigError
        The builder makes no trees, and there are too many primitives without them.
    """

    mesh = None
    bvh = None

    def __init__(self, state: SceneState, options: RenderOptions) -> None:
        if state.instance_count == 0:
            raise SceneError("the scene is empty: add a geometry and place it, as in scene.place(scene.add(mesh))")
        self._state, self._options = state, options
        if options.builder == BRUTE:
            prim_counts = [shape.prim_count for shape in state.shapes]
            check_brute_limit(sum(prim_counts[geometry] for geometry in state.geometry_ids.tolist()), "primitives")
        self._trees: tuple[Bvh | None, ...] | None = None
        self._merging = NOTHING_MERGED
        self.made: BuildResult | None = None

    def load(self) -> None:
        """Find where everything is."""
        state = self._state
        self.extent = SceneBounds(state.shapes, state.geometry_ids, state.transforms)

    def build(self) -> None:
        """Make the trees of merged meshes, and of each geometry that is not merged; none with ``"brute"``."""
        state = self._state
        self._surface = make_scene_arrays(state.shapes, state.geometry_ids, state.transforms)
        if self._options.builder == BRUTE:
            return
        made: list[BuildResult] = []

        def make(mesh: Mesh) -> Bvh:
            made.append(get_tree(mesh, self._options))
            return made[-1].bvh

        self._merging = Merging.find(state, self._surface, make)
        merged = set(state.geometry_ids[self._merging.instance_ids].tolist())
        self._trees = tuple(
            None if geometry_id in merged else make(mesh_of(shape)) for geometry_id, shape in enumerate(state.shapes)
        )
        timings_ms = {phase: sum(each.timings_ms[phase] for each in made) for phase in ("cache", "build")}
        self.made = BuildResult(
            made[0].bvh,
            max(each.workers for each in made),
            all(each.from_cache for each in made),
            timings_ms,
            tuple(dict.fromkeys(note for each in made for note in each.notes)),
        )

    def put(self, session: DeviceSession) -> DeviceScene:
        """Build the tree over the instances, and put the scene on the device."""
        self._scene = DeviceScene(
            session, self._state, self._trees, _build_top, self._options.chosen_layout, merging=self._merging,
            surface=self._surface,
        )  # fmt: skip
        return self._scene

    def validate(self) -> None:
        """Raise `ValidationError` unless all trees are right."""
        leaf_size = leaf_limit(self._options.builder, self._options.build)
        for bvh in self._scene.all_trees:
            validate_tree(bvh, max_depth=MAX_DEPTH, max_leaf_size=leaf_size)
        validate_tree(self._scene.top.bvh, max_depth=MAX_DEPTH, max_leaf_size=1)

    def looks(self) -> Looks:
        """Return what `make_look_tables` has to know."""
        shapes, shape_ids = dress_shapes(self._state)
        maps = {}
        for merged in self._merging.meshes:
            for instance in merged.merged_ids:
                # The inverse transpose of the map into the merged mesh, divided by its size.
                inverse = self._surface.inverse[instance]
                turned = merged.transform[:3, :3] @ inverse.T
                maps[int(shape_ids[instance])] = turned / np.abs(turned).max()
        return Looks(shapes, shape_ids, self._state.colours, maps)

    def to_local(self) -> NDArray[np.float64]:
        """Return (n, 4, 4) float64: the map from each instance's coordinates to the local ones of pictures."""
        boxes = self._scene.top.bvh.mesh
        return local_maps(self._state.transforms, boxes.origin, boxes.scale)

    def make_view(self, scene: Scene, camera: Camera, ground: Ground | None, framed: SceneBounds) -> NDArray[np.void]:
        """Return the view, (1,) `structs.VIEW`; `framed` is what counts, see `make_view`."""
        boxes = self._scene.top.bvh.mesh
        return make_view(scene, camera, boxes, self.extent.box_in(boxes), ground, framed.box_in(boxes))

    def picture_parts(self) -> dict[str, Any]:
        """Return what a `Picture` keeps of the subject, by its attributes."""
        surface = SceneSurface(self._scene.surface, self._state.shapes, self._state.names)
        return {
            "mesh": None,
            "bvh": None,
            "objects": SceneObjects(self._state, surface, self._scene.trees, self._scene.top.bvh, self._merging),
        }


def _build_top(boxes: Mesh) -> Bvh:
    return build(boxes, leaf_size=1)
