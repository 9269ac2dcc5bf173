"""The objects of a scene as the subject of pictures: how they get their trees, and go to the device."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..builders.build import build
from ..builders.options import MAX_DEPTH
from ..builders.registry import leaf_limit
from ..builders.tree_maker import MadeTree, TreeMaker
from ..bvh import Bvh, validate_tree
from ..device.session import DeviceSession
from ..errors import SceneError
from ..geometry import Mesh
from ..geometry.sphere_boxes import mesh_of
from ..scene.dressed import dress_shapes
from ..scene.state import SceneState
from ..trace.device_tree import BRUTE
from ..trace.hits.scene_arrays import make_scene_arrays
from ..trace.hits.surface import SceneSurface
from ..trace.scene.device_scene import DeviceScene
from ..trace.scene.merging import NOTHING_MERGED, Merging
from .brute_limit import check_brute_limit
from .camera import Camera
from .film.ground import Ground
from .film.light_tables import local_maps
from .film.look_tables import Looks
from .render_options import RenderOptions
from .scene import Scene
from .scene_extent import SceneExtent
from .scene_objects import SceneObjects
from .view import make_view
from .view_bounds import box_in


class SceneSubject:
    """The objects of a scene. The steps are called in their order: load, build, put.

    Parameters
    ----------
    state : SceneState
    options : RenderOptions
    stack : ExitStack
        Ends the workers, which start now.

    Attributes
    ----------
    mesh, bvh
        None: there is no single one.
    extent : SceneExtent
    made : MadeTree or None
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

    def __init__(self, state: SceneState, options: RenderOptions, stack: ExitStack) -> None:
        if state.instance_count == 0:
            raise SceneError("the scene is empty: add a geometry and place it, as in scene.place(scene.add(mesh))")
        self._state, self._options = state, options
        self._maker: TreeMaker | None = None
        if options.builder == BRUTE:
            prim_counts = [shape.prim_count for shape in state.shapes]
            check_brute_limit(sum(prim_counts[geometry] for geometry in state.geometry_ids.tolist()), "primitives")
        else:
            expected_count = sum(shape.prim_count for shape in state.shapes)
            self._maker = stack.enter_context(TreeMaker(options, expected_count))
        self._trees: tuple[Bvh | None, ...] | None = None
        self._merging = NOTHING_MERGED
        self.made: MadeTree | None = None

    def load(self) -> None:
        """Find where everything is."""
        state = self._state
        self.extent = SceneExtent(state.shapes, state.geometry_ids, state.transforms)

    def build(self) -> None:
        """Make the trees of merged meshes, and of each geometry that is not merged; none with ``"brute"``."""
        maker, state = self._maker, self._state
        self._surface = make_scene_arrays(state.shapes, state.geometry_ids, state.transforms)
        if maker is None:
            return
        made: list[MadeTree] = []

        def make(mesh: Mesh) -> Bvh:
            made.append(maker.make(mesh))
            return made[-1].bvh

        self._merging = Merging.find(state, self._surface, make)
        merged = set(state.geometry_ids[self._merging.instance_ids].tolist())
        self._trees = tuple(
            None if geometry_id in merged else make(mesh_of(shape)) for geometry_id, shape in enumerate(state.shapes)
        )
        timings_ms = {phase: sum(each.timings_ms[phase] for each in made) for phase in ("cache", "build")}
        self.made = MadeTree(
            made[0].bvh,
            max(each.workers for each in made),
            all(each.from_cache for each in made),
            # The workers start once.
            {"pool_start": made[-1].timings_ms["pool_start"], **timings_ms},
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

    def make_view(
        self, scene: Scene, camera: Camera, ground: Ground | None, framed: Mesh | SceneExtent
    ) -> NDArray[np.void]:
        """Return the view, (1,) `structs.VIEW`; `framed` is what counts, see `make_view`."""
        boxes = self._scene.top.bvh.mesh
        return make_view(scene, camera, boxes, box_in(self.extent, boxes), ground, box_in(framed, boxes))

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
