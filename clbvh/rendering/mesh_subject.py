"""One mesh as the subject of pictures: how it is loaded, gets its tree, and goes to the device."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..builders.options import MAX_DEPTH
from ..builders.registry import leaf_limit
from ..builders.tree_maker import MadeTree, TreeMaker
from ..bvh import Bvh, validate_tree
from ..device.session import DeviceSession
from ..geometry import Mesh
from ..trace.device_tree import BRUTE, DeviceTree
from .brute_limit import check_brute_limit
from .camera import Camera
from .film.ground import Ground
from .film.light_tables import local_maps
from .film.look_tables import Looks
from .render_options import RenderOptions
from .scene import Scene
from .scene_extent import SceneExtent
from .view import make_view
from .view_bounds import box_in


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
    stack : ExitStack
        Ends the workers, which start now.

    Attributes
    ----------
    mesh : Mesh
        In the scene's coordinates.
    bvh : Bvh or None
        None with the builder ``"brute"``.
    made : MadeTree or None
        The tree, if it was made here.
    """

    def __init__(
        self, scene: Scene, mesh: Mesh | None, bvh: Bvh | None, options: RenderOptions, stack: ExitStack
    ) -> None:
        self._scene, self._options = scene, options
        self._loaded = mesh
        self.bvh = bvh if options.builder != BRUTE else None
        self.made: MadeTree | None = None
        self._maker: TreeMaker | None = None
        if options.builder != BRUTE and bvh is None:
            face_count = mesh.face_count if mesh is not None else scene.only_mesh().estimate_face_count()
            self._maker = stack.enter_context(TreeMaker(options, face_count))

    def load(self) -> None:
        """Find the mesh."""
        scene = self._scene
        self.mesh = scene.transform.apply(scene.only_mesh().load()) if self._loaded is None else self._loaded

    def build(self) -> None:
        """Find the tree."""
        if self._maker is not None:
            self.made = self._maker.make(self.mesh)
            self.bvh = self.made.bvh
        elif self.bvh is None:
            check_brute_limit(self.mesh.face_count, "triangles")

    def put(self, session: DeviceSession) -> DeviceTree:
        """Put the mesh and its tree on the device."""
        return DeviceTree(session, self.mesh, self.bvh, self._options.chosen_layout)

    def validate(self) -> None:
        """Raise `ValidationError` unless the tree is right."""
        if self.bvh is not None:
            leaf_size = None if self.made is None else leaf_limit(self._options.builder, self._options.build)
            validate_tree(self.bvh, max_depth=MAX_DEPTH, max_leaf_size=leaf_size)

    @property
    def extent(self) -> Mesh:
        """What a camera that sees everything has to see."""
        return self.mesh

    def looks(self) -> Looks:
        """Return what `make_look_tables` has to know."""
        return Looks((self.mesh,), np.zeros(1, np.int64), np.full((1, 3), np.nan))

    def to_local(self) -> NDArray[np.float64]:
        """Return (1, 4, 4) float64: the map from the mesh's coordinates to the local ones of pictures."""
        return local_maps(np.eye(4)[None], self.mesh.origin, self.mesh.scale)

    def make_view(
        self, scene: Scene, camera: Camera, ground: Ground | None, framed: Mesh | SceneExtent
    ) -> NDArray[np.void]:
        """Return the view, (1,) `structs.VIEW`; `framed` is what counts, see `make_view`."""
        box = None if framed is self.mesh else box_in(framed, self.mesh)
        return make_view(scene, camera, self.mesh, ground=ground, framed_box=box)

    def picture_parts(self) -> dict[str, Any]:
        """Return what a `Picture` keeps of the subject, by its attributes."""
        return {"mesh": self.mesh, "bvh": self.bvh}
