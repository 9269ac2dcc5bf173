"""The scene of a tracer, as it opens and as it moves.

Every change makes a new `DeviceScene`, which shares the buffers that stay the same. So a query sees one scene from
beginning to end, a change waits for none, and one that fails has changed nothing. Buffers that a change has replaced
are given back once no query uses them: a query holds the caster that it began with.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast
from weakref import ref

import numpy as np
from numpy.typing import ArrayLike

from ...bvh import Bvh
from ...device.session import DeviceSession
from ...errors import SceneError
from ...geometry import Mesh
from ...geometry.shape import Shape
from ...geometry.spheres import Spheres
from ...scene.contents import SceneContents
from ...scene.geometry import Geometry
from ...scene.state import SceneState
from ...scene.transforms import check_transforms
from ..device_tree import DeviceTree
from ..launch import Caster
from ..rays.batch import TreeBox
from ..tree_copies import TreeCopies
from .device_scene import DeviceScene
from .refit_geometry import RefitGeometry

# A geometry's tree is built anew when its SAH cost has grown by this factor.
REBUILD_GROWTH = 1.3


class MovingScene:
    """What a tracer knows of its scene; for one change at a time.

    Parameters
    ----------
    contents : SceneContents
        Read now; later changes of it are not seen.
    build_tree : function
        Builds the tree of a mesh or of spheres.
    build_top : function
        Builds the tree over a mesh of the instances' boxes.
    """

    def __init__(
        self, contents: SceneContents, build_tree: Callable[[Shape], Bvh], build_top: Callable[[Mesh], Bvh]
    ) -> None:
        self._contents = contents
        self._build_tree, self._build_top = build_tree, build_top
        self.state: SceneState = contents.snapshot()
        self.trees: list[Bvh] = [build_tree(shape) for shape in self.state.shapes]
        self._refits: dict[int, RefitGeometry] = {}
        # Of the mesh, as long as the scene is nothing but one mesh in its place.
        self._copies: TreeCopies | None = None
        self._retired: list[tuple[ref[Caster], list[Any]]] = []

    def open(self, session: DeviceSession, layout: str) -> tuple[DeviceTree | DeviceScene, TreeBox]:
        """Put the scene on a device, and return it with the box around it.

        A mesh that is placed once, where it is, needs no instance.
        """
        if self.state.is_one_mesh:
            bvh = self.trees[self.state.geometry_ids[0]]
            return DeviceTree(session, bvh.mesh, bvh, layout), TreeBox.around(bvh)
        scene = DeviceScene(session, self.state, self.trees, self._build_top, layout)
        return scene, scene.box

    def set_transforms(self, caster: Caster, instances: Any, matrices: ArrayLike, session: DeviceSession) -> Caster:
        """Return a caster at the scene with other transforms; see `Tracer.set_transforms`."""
        ids = self._contents.instance_ids(instances)
        given = np.asarray(matrices)
        transforms = check_transforms(given[None] if given.ndim == 2 else given)
        if len(transforms) != len(ids):
            raise SceneError(f"{len(ids):,} instances need as many transforms, not {len(transforms):,}")
        if len(ids) and ids.max() >= self.state.instance_count:
            raise SceneError(f"the instance {ids.max()} was placed after the tracer was opened: open a new tracer")
        state = self.state.with_transforms(ids, transforms)
        tree: object = caster.tree
        if isinstance(tree, DeviceScene):
            moved = tree.moved(caster.session, session, state)
        else:
            moved = DeviceScene(caster.session, state, self._trees_now(), self._build_top, caster.tree.layout)
        return self._replace(caster, moved, state)

    def set_vertices(self, caster: Caster, geometry: Geometry, vertices: ArrayLike, session: DeviceSession) -> Caster:
        """Return a caster at the scene with a geometry whose vertices have moved; see `Tracer.set_vertices`."""
        geometry_id = self._contents.geometry_id(geometry)
        if geometry_id >= len(self.state.shapes):
            raise SceneError(f"{geometry!r} was added after the tracer was opened: open a new tracer")
        shape = self.state.shapes[geometry_id]
        tree: object = caster.tree
        moved_shape: Shape
        if isinstance(shape, Spheres):
            moved_shape = shape.with_spheres(vertices, shape.radii)
        else:
            moved_shape = shape.with_vertices(vertices)
        state = self.state.with_shape(geometry_id, moved_shape)
        if isinstance(tree, DeviceTree) and isinstance(moved_shape, Mesh):
            moved = self._copies_of(caster).move(caster, moved_shape, session)
            if cast(DeviceTree, moved.tree).sah_growth <= REBUILD_GROWTH:
                self.state = state
                return moved
        if isinstance(moved_shape, Mesh) and isinstance(tree, DeviceScene):
            refit = self._refits.get(geometry_id) or RefitGeometry(tree, geometry_id, session)
            scene = tree.with_geometry(caster.session, session, state, geometry_id, refit, caster.threads)
            self._refits[geometry_id] = refit
            if refit.sah_growth <= REBUILD_GROWTH:
                return self._replace(caster, scene, state)
            scene.release_other_than(tree, caster.session)
        self._refits.clear()
        trees = self._trees_now()
        trees[geometry_id] = self._build_tree(moved_shape)
        built = DeviceScene(caster.session, state, trees, self._build_top, caster.tree.layout)
        self.trees = trees
        return self._replace(caster, built, state)

    def _copies_of(self, caster: Caster) -> TreeCopies:
        """Return the copies of the only mesh."""
        if self._copies is None:
            self._copies = TreeCopies(caster)
        return self._copies

    def _trees_now(self) -> list[Bvh]:
        """Return the trees of all geometries around the vertices as they are now."""
        return [
            bvh.refit(shape.vertices) if isinstance(shape, Mesh) and bvh.mesh is not shape else bvh
            for bvh, shape in zip(self.trees, self.state.shapes, strict=True)
        ]

    def _replace(self, caster: Caster, scene: DeviceScene, state: SceneState) -> Caster:
        """Return a caster at a scene in place of another one, whose own buffers are given back in time."""
        self.state = state
        kept = {id(buffer) for buffer in scene.arguments.values()}
        surplus = [buffer for buffer in caster.tree.buffers_of_own() if id(buffer) not in kept]
        self._retired.append((ref(caster), surplus))
        if not isinstance(caster.tree, DeviceScene):
            # The copies of the mesh go, too.
            self._retired += self._copies_of(caster).list_users()
            self._copies = None
        moved = caster.over(scene, scene.box)
        self._release_unused(caster.session)
        return moved

    def _release_unused(self, session: DeviceSession) -> None:
        """Give back the buffers that no query uses."""
        used = []
        for user, buffers in self._retired:
            if user() is None:
                for buffer in buffers:
                    session.release(buffer)
            else:
                used.append((user, buffers))
        self._retired = used
