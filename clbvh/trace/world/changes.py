"""Changes of a world: shapes, transforms and masks. Each makes a new world, which shares what stays the same.

So a query sees one world from its first to its last line, a change waits for none, and one that fails or is interrupted
has changed nothing: it leaves an unreferenced world.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...bvh import Bvh
from ...device.session import DeviceSession
from ...errors import SceneError
from ...geometry import Mesh, Shape
from ...layouts.device_arrays import has_shared_blocks
from ...layouts.device_prims import DevicePrims
from ...scene.handles import Geometry, Instances
from ...scene.scene import Scene
from ...scene.state import SceneState
from .refit import Refit
from .tree_box import TreeBox
from .trees import DeviceTrees, NewTree, RetiredBuffers
from .world import World, place

if TYPE_CHECKING:
    from ...builders.tree_options import TreeOptions

# A geometry's tree is built anew, on the device, when its SAH cost has grown by this factor.
REBUILD_GROWTH = 1.3


class Changes:
    """What a tracer knows of its scene beside the world; for one change at a time.

    Parameters
    ----------
    scene : Scene
        Its handles name geometries and instances. Later changes of it are not seen.
    opened : SceneState
        The scene as it was opened.
    tree : Bvh, str or TreeOptions
        The tree of the only mesh, or the quality or the options of all trees.
    """

    def __init__(self, scene: Scene, opened: SceneState, tree: Bvh | str | TreeOptions) -> None:
        self._scene, self._opened, self._tree = scene, opened, tree
        self._prims: dict[int, DevicePrims] = {}
        self._refits: dict[int, Refit] = {}
        self._growths: dict[int, float] = {}
        self._retired = RetiredBuffers()

    @property
    def memory_bytes(self) -> int:
        """Bytes of buffers that are for later changes."""
        prims = sum(each.memory_bytes for each in self._prims.values())
        return self._retired.memory_bytes + prims + sum(each.memory_bytes for each in self._refits.values())

    def sah_growth(self, geometry_id: int) -> float:
        """Return the SAH cost of a tree, divided by that of the tree that was built."""
        return self._growths.get(geometry_id, 1.0)

    def get_tree(self, world: World) -> Bvh:
        """Return the tree of a lone mesh: the one that was given, or the same built again, refitted like it."""
        # Imported here: few ask for it.
        from ...builders.build import build_shape
        from ...builders.tree_cache import get_tree

        mesh, refit = world.state.shapes[0], self._refits.get(0)
        built = mesh if refit is None else refit.built
        tree = self._tree
        if isinstance(tree, str):
            tree = build_shape(built, tree, world.trees.session.info)
        elif not isinstance(tree, Bvh):
            tree = get_tree(built, tree).bvh
        return tree if built is mesh else tree.refit(cast(Mesh, mesh).vertices)

    def choose_instances(self, geometry: Geometry | str | None, instance: Instances | None) -> NDArray[np.int64]:
        """Return the ids of the given instances of a geometry, or of either alone; see `Tracer.closest_point`."""
        if instance is None:
            chosen = np.arange(self._opened.instance_count)
        else:
            chosen = self._opened.check_ids(self._scene.instance_ids(instance))
        if geometry is not None:
            chosen = chosen[self._opened.geometry_ids[chosen] == self._scene.geometry_id(geometry)]
        return chosen

    def move_state(self, world: World, instances: Instances, transforms: ArrayLike) -> SceneState:
        """Return the state of a world with other transforms; see `Tracer.set_transforms`."""
        return self._scene._move(world.state, instances, transforms)

    def mask_state(self, world: World, instances: Instances, masks: ArrayLike) -> SceneState:
        """Return the state of a world with other masks; see `Tracer.set_masks`."""
        return self._scene._mask(world.state, instances, masks)

    def set_instances(self, world: World, state: SceneState, session: DeviceSession) -> World:
        """Return a world in a state of other transforms or masks."""
        return world.with_state(state, session)

    def find_shape(self, world: World, geometry: Geometry | str) -> tuple[int, Shape]:
        """Return the id of a geometry, and its shape as it is now."""
        geometry_id, shapes = self._scene.geometry_id(geometry), world.state.shapes
        if geometry_id >= len(shapes):
            raise SceneError(f"{geometry!r} was added after the tracer was opened: open a new tracer")
        return geometry_id, shapes[geometry_id]

    def set_shape(self, world: World, geometry_id: int, shape: Shape, session: DeviceSession) -> World:
        """Return a world with another shape of a geometry: its tree is refitted or built anew there."""
        before, growth = world.trees, 1.0
        if has_shared_blocks(shape, before.layout):
            # Vertices that were equal need not be any more.
            trees, box = self._rebuild(before, geometry_id, shape, session)
        else:
            refit = self._refits.get(geometry_id) or self._open_refit(world, geometry_id, session)
            trees = before.with_room(session, geometry_id, before.trees[geometry_id], self._retired)
            box = refit.write(before, trees, geometry_id, shape, session)
            growth = refit.sah_cost / refit.built_cost
            if growth > REBUILD_GROWTH and not before.session.info.cuts_loops:
                del trees  # the device need not have room for it and for the next one
                growth = 1.0
                session.finish()
                trees, box = self._rebuild(before, geometry_id, shape, session, refit.prims)
        if geometry_id == 0:
            trees = replace(trees, box=box)
        # Queries have queues of their own, which do not wait for this one.
        session.finish()
        moved = place(trees, world.state.with_shape(geometry_id, shape), session, before=world.refine_buffers)
        self._growths[geometry_id] = growth
        return moved

    def share(self, world: World) -> None:
        """Leave the buffers of a world as they are, which other tracers see, too."""
        self._retired.leave(world.trees)

    def retire(self, world: World, newer: World) -> None:
        """Keep what later queries do not need of a world, now that they see a newer one, for changes to come."""
        if newer.trees is not world.trees:
            self._retired.add(world.trees, newer.trees)

    def _open_refit(self, world: World, geometry_id: int, session: DeviceSession) -> Refit:
        """Return what refits the tree of a geometry from now on."""
        shape, prims = world.state.shapes[geometry_id], self._prims.get(geometry_id)
        if prims is None:
            prims = self._prims[geometry_id] = DevicePrims(world.trees.session, session, shape)
        elif prims.shape is not shape:
            prims.put(session, shape)
        refit = self._refits[geometry_id] = Refit(world.trees, geometry_id, prims, session)
        return refit

    def _rebuild(
        self,
        before: DeviceTrees,
        geometry_id: int,
        shape: Shape,
        session: DeviceSession,
        prims: DevicePrims | None = None,
    ) -> tuple[DeviceTrees, TreeBox]:
        """Return the trees with that of a geometry built anew, and the box around it."""
        # Imported here: most tracers build no second tree.
        from ...builders.build import suit_options
        from ...builders.options import FAST_QUALITY

        # By the owner of the buffers: a tree that is alone stays in those that it was built in.
        owner = before.session
        new = NewTree.make(owner, shape, suit_options(shape, FAST_QUALITY), before.layout, prims)
        if len(before.trees) == 1:
            trees = DeviceTrees.join(owner, [shape], [new], before.layout)
            owner.finish()
        else:
            trees = before.with_room(session, geometry_id, new.tree, self._retired)
            trees.put(session, geometry_id, [new])
        self._refits.pop(geometry_id, None)
        if geometry_id == 0:
            self._tree = FAST_QUALITY
        return trees, new.find_box()
