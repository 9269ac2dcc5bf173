"""The scene of a tracer, as it opens and as it moves.

Every change makes a new `DeviceScene`, which shares the buffers that stay the same. So a query sees one scene from
beginning to end, a change waits for none, and one that fails has changed nothing.

A query holds the scene that it began with, and a change that Ctrl-C has undone leaves one that nobody holds. The device
has the buffers of the scenes that are alive.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...bvh import Bvh
from ...bvh.refit import fit_nodes
from ...device.session import DeviceSession
from ...errors import SceneError
from ...geometry import Mesh, Shape
from ...geometry.corners import Boxes
from ...geometry.spheres import Spheres
from ...layouts.refit_arrays import RefitArrays, read_topology
from ...scene.handles import Geometry, Instance
from ...scene.scene import Scene
from ...scene.state import SceneState
from ...scene.transforms import check_transforms
from ...support.host_threads import HostThreads
from ..device_tree import DeviceTree, TreeCopies
from ..hits.surface import Surface
from ..launch import Caster
from ..rays.batch import TreeBox
from .device_scene import DeviceScene

# A geometry's tree is built anew when its SAH cost has grown by this factor.
REBUILD_GROWTH = 1.3


class MovingScene:
    """What a tracer knows of its scene; for one change at a time.

    Parameters
    ----------
    contents : Scene
        Read now; later changes of it are not seen.
    build_tree : function
        Builds the tree of a mesh or of spheres.
    build_top : function
        Builds the tree over the instances' boxes.
    """

    def __init__(self, contents: Scene, build_tree: Callable[[Shape], Bvh], build_top: Callable[[Boxes], Bvh]) -> None:
        self._contents = contents
        self._build_tree, self._build_top = build_tree, build_top
        self._opened: SceneState = contents.snapshot()
        # The trees of the geometries as they were opened, once they are needed.
        self._built: list[Bvh | None] = [None] * self._opened.geometry_count
        self._refits: dict[int, RefitGeometry] = {}
        # Of the mesh, as long as the scene is nothing but one mesh in its place.
        self._copies: TreeCopies | None = None

    def open(self, session: DeviceSession, layout: str) -> tuple[DeviceTree | DeviceScene, TreeBox]:
        """Put the scene on a device, and return it with the box around it.

        A mesh that is placed once, where it is, needs no instance.
        """
        if self._opened.is_one_mesh:
            bvh = self._first_tree(int(self._opened.geometry_ids[0]))
            tree = DeviceTree(session, bvh.mesh, bvh, layout)
            # For the ids and the names that hits know.
            tree.scene_surface = Surface.from_shapes(
                self._opened.shapes, self._opened.names, self._opened.geometry_ids, self._opened.transforms
            )
            return tree, TreeBox.around(bvh)
        state = self._opened
        trees = [self._first_tree(geometry_id) for geometry_id in range(state.geometry_count)]
        scene = DeviceScene(session, state, trees, self._build_top, layout)
        return scene, scene.box

    def state(self, caster: Caster) -> SceneState:
        """Return the scene that a caster is at."""
        tree: object = caster.tree
        if isinstance(tree, DeviceScene):
            return tree.state
        return self._opened.with_shape(int(self._opened.geometry_ids[0]), caster.tree.mesh)

    def choose_instances(
        self, geometry: Geometry | None, instance: Instance | int | Iterable[Instance | int] | None
    ) -> NDArray[np.int64]:
        """Return the ids of the given instances of a geometry, or of either alone; see `Tracer.closest_point`."""
        if instance is None:
            chosen = np.arange(self._opened.instance_count)
        else:
            chosen = self._contents.instance_ids([instance] if isinstance(instance, int | np.integer) else instance)
            self._check_known(chosen)
        if geometry is not None:
            geometry_id = self._contents.geometry_id(geometry)
            chosen = chosen[self._opened.geometry_ids[chosen] == geometry_id]
        return chosen

    def set_transforms(self, caster: Caster, instances: Any, matrices: ArrayLike, session: DeviceSession) -> Caster:
        """Return a caster at the scene with other transforms; see `Tracer.set_transforms`."""
        ids = self._contents.instance_ids(instances)
        given = np.asarray(matrices)
        transforms = check_transforms(given[None] if given.shape == (4, 4) else given)
        if len(transforms) != len(ids):
            raise SceneError(f"{len(ids):,} instances need as many transforms, not {len(transforms):,}")
        self._check_known(ids)
        state = self.state(caster).with_transforms(ids, transforms)
        tree: object = caster.tree
        if isinstance(tree, DeviceScene):
            moved = tree.moved(caster.session, session, state)
        else:
            trees = self._trees_now(caster, {})
            moved = DeviceScene(caster.session, state, trees, self._build_top, caster.tree.layout)
        return self._use(caster, moved)

    def set_vertices(self, caster: Caster, geometry: Geometry, vertices: ArrayLike, session: DeviceSession) -> Caster:
        """Return a caster at the scene with a geometry whose vertices have moved; see `Tracer.set_vertices`."""
        geometry_id, shape = self._find_shape(caster, geometry)
        moved = shape.with_spheres(vertices) if isinstance(shape, Spheres) else shape.with_vertices(vertices)
        return self._set_shape(caster, geometry_id, moved, session)

    def set_spheres(
        self,
        caster: Caster,
        geometry: Geometry,
        centres: ArrayLike,
        radii: ArrayLike | None,
        session: DeviceSession,
    ) -> Caster:
        """Return a caster at the scene with spheres that have moved; see `Tracer.set_spheres`."""
        geometry_id, shape = self._find_shape(caster, geometry)
        if not isinstance(shape, Spheres):
            raise SceneError(f"{geometry!r} is a mesh and has no spheres: call set_vertices(geometry, vertices)")
        return self._set_shape(caster, geometry_id, shape.with_spheres(centres, radii), session)

    def _find_shape(self, caster: Caster, geometry: Geometry) -> tuple[int, Shape]:
        """Return the id of a geometry, and its shape as it is now."""
        geometry_id, shapes = self._contents.geometry_id(geometry), self.state(caster).shapes
        if geometry_id >= len(shapes):
            raise SceneError(f"{geometry!r} was added after the tracer was opened: open a new tracer")
        return geometry_id, shapes[geometry_id]

    def _set_shape(self, caster: Caster, geometry_id: int, moved_shape: Shape, session: DeviceSession) -> Caster:
        """Return a caster at the scene with another shape of a geometry: refitted, or built anew."""
        tree: object = caster.tree
        state = self.state(caster).with_shape(geometry_id, moved_shape)
        is_in_tree = isinstance(tree, DeviceTree) and geometry_id == self._opened.geometry_ids[0]
        if is_in_tree and isinstance(moved_shape, Mesh):
            moved = self._copies_of(caster).move(caster, moved_shape, session)
            if cast(DeviceTree, moved.tree).sah_growth <= REBUILD_GROWTH:
                return moved
        if isinstance(tree, DeviceScene):
            refit = self._find_refit(tree, geometry_id, session)
            write = partial(refit.write, threads=caster.threads)
            scene = tree.with_geometry(caster.session, session, state, geometry_id, write)
            if refit.sah_growth <= REBUILD_GROWTH:
                return self._use(caster, scene)
            del scene  # the device need not have room for it and for the next one
        self._refits.pop(geometry_id, None)
        trees = self._trees_now(caster, {geometry_id: self._build_tree(moved_shape)})
        built = DeviceScene(caster.session, state, trees, self._build_top, caster.tree.layout)
        return self._use(caster, built)

    def _find_refit(self, scene: DeviceScene, geometry_id: int, session: DeviceSession) -> RefitGeometry:
        """Return what refits a geometry; it is kept as long as the geometry has the tree that it was built with.

        Where another geometry is built anew, this one's tree begins again as it was refitted, and with its wear.
        """
        refit = self._refits.get(geometry_id)
        if refit is None or refit.bvh is not scene.trees[geometry_id]:
            growth = 1.0 if refit is None else refit.sah_growth
            refit = self._refits[geometry_id] = RefitGeometry(scene, geometry_id, session, growth)
        return refit

    def _copies_of(self, caster: Caster) -> TreeCopies:
        """Return the copies of the only mesh."""
        if self._copies is None:
            self._copies = TreeCopies(caster)
        return self._copies

    def _check_known(self, instance_ids: NDArray[np.int64]) -> None:
        """Raise unless the instances were there when the tracer was opened."""
        if len(instance_ids) and instance_ids.max() >= self._opened.instance_count:
            raise SceneError(
                f"the instance {instance_ids.max()} was placed after the tracer was opened: open a new tracer"
            )

    def _trees_now(self, caster: Caster, rebuilt: Mapping[int, Bvh]) -> list[Bvh]:
        """Return the trees of the geometries around the shapes as they are now; some have been built anew."""
        tree: object = caster.tree
        shapes, before = self.state(caster).shapes, self._opened.shapes
        if isinstance(tree, DeviceScene):
            before = tree.built_shapes
        now = []
        for geometry_id, (built, shape) in enumerate(zip(before, shapes, strict=True)):
            bvh = rebuilt.get(geometry_id)
            if bvh is None:
                bvh = tree.trees[geometry_id] if isinstance(tree, DeviceScene) else self._first_tree(geometry_id)
                bvh = bvh if shape is built else _refit_tree(bvh, shape)
            now.append(bvh)
        return now

    def _first_tree(self, geometry_id: int) -> Bvh:
        """Return the tree of a geometry as it was opened."""
        bvh = self._built[geometry_id]
        if bvh is None:
            bvh = self._built[geometry_id] = self._build_tree(self._opened.shapes[geometry_id])
        return bvh

    def _use(self, caster: Caster, scene: DeviceScene) -> Caster:
        """Return a caster at a scene in place of another one."""
        if isinstance(caster.tree, DeviceScene):
            # Only now: after Ctrl-C the tracer may have stayed with the mesh, and with its copies.
            self._copies = None
        return caster.over(scene, scene.box)


def _refit_tree(bvh: Bvh, shape: Shape) -> Bvh:
    """Return a tree of the same topology over a shape with as many primitives."""
    return Bvh(fit_nodes(bvh.nodes["first"], bvh.nodes["count"], bvh.prim_ids, shape), bvh.prim_ids, shape)


class RefitGeometry:
    """Writes the arrays of one geometry, for one shape after the other.

    Parameters
    ----------
    scene : DeviceScene
        With the geometry as it is now.
    geometry_id : int
    session : DeviceSession
        A branch of the scene's, for this thread.
    growth_before : float
        The SAH cost of the tree in the scene, divided by that of the tree that was built.

    Attributes
    ----------
    bvh : Bvh
        The tree in the scene.
    sah_growth : float
        The SAH cost of the tree as it was last written, divided by that of the tree that was built.
    """

    def __init__(
        self, scene: DeviceScene, geometry_id: int, session: DeviceSession, growth_before: float = 1.0
    ) -> None:
        self.bvh = scene.trees[geometry_id]
        self._first = scene.state.shapes[geometry_id]
        self._first_cost = 0.0
        self._growth_before = self.sah_growth = growth_before
        with scene.mapped(session, geometry_id, write=False) as arrays:
            self._arrays = RefitArrays(read_topology(*arrays, scene.layout))

    def write(self, shape: Shape, nodes: NDArray[np.void], blocks: NDArray[np.void], threads: HostThreads) -> None:
        """Write nodes and blocks for a shape; see `RefitArrays.write`."""
        if self._first_cost == 0.0:
            # Only those who move a geometry ask how the cost has grown.
            self._arrays.write(self._first, nodes, blocks, threads)
            self._first_cost = self._arrays.sah_cost
        self._arrays.write(shape, nodes, blocks, threads)
        self.sah_growth = self._growth_before * self._arrays.sah_cost / self._first_cost
