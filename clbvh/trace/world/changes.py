"""Changes of a world: shapes and transforms that move. Each makes a new world, which shares what stays the same.

So a query sees one world from its first to its last line, a change waits for none, and one that fails or is interrupted
has changed nothing: it leaves an unreferenced world.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...device.session import DeviceSession
from ...errors import SceneError
from ...geometry import Shape
from ...scene.handles import Geometry, Instance
from ...scene.scene import Scene
from ...scene.state import SceneState
from ...scene.transforms import check_transforms
from .refit import Refit
from .tree_box import TreeBox
from .trees import DeviceTrees, NewTree, RetiredBuffers
from .world import World, place

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
    """

    def __init__(self, scene: Scene, opened: SceneState) -> None:
        self._scene, self._opened = scene, opened
        self._refits: dict[int, Refit] = {}
        self._retired = RetiredBuffers()

    @property
    def memory_bytes(self) -> int:
        """Bytes of buffers that no later query uses."""
        return self._retired.memory_bytes

    def sah_growth(self, geometry_id: int) -> float:
        """Return the SAH cost of a tree, divided by that of the tree that was built."""
        return self._refits[geometry_id].sah_growth if geometry_id in self._refits else 1.0

    def choose_instances(
        self, geometry: Geometry | None, instance: Instance | int | Iterable[Instance | int] | None
    ) -> NDArray[np.int64]:
        """Return the ids of the given instances of a geometry, or of either alone; see `Tracer.closest_point`."""
        if instance is None:
            chosen = np.arange(self._opened.instance_count)
        else:
            chosen = self._scene.instance_ids([instance] if isinstance(instance, int | np.integer) else instance)
            self._check_known(chosen)
        if geometry is not None:
            chosen = chosen[self._opened.geometry_ids[chosen] == self._scene.geometry_id(geometry)]
        return chosen

    def set_transforms(self, world: World, instances: Any, matrices: ArrayLike, session: DeviceSession) -> World:
        """Return a world with other transforms; see `Tracer.set_transforms`."""
        ids = self._scene.instance_ids(instances)
        given = np.asarray(matrices)
        transforms = check_transforms(given[None] if given.shape == (4, 4) else given)
        if len(transforms) != len(ids):
            raise SceneError(f"{len(ids):,} instances need as many transforms, not {len(transforms):,}")
        self._check_known(ids)
        return world.with_transforms(world.state.with_transforms(ids, transforms), session)

    def find_shape(self, world: World, geometry: Geometry) -> tuple[int, Shape]:
        """Return the id of a geometry, and its shape as it is now."""
        geometry_id, shapes = self._scene.geometry_id(geometry), world.state.shapes
        if geometry_id >= len(shapes):
            raise SceneError(f"{geometry!r} was added after the tracer was opened: open a new tracer")
        return geometry_id, shapes[geometry_id]

    def set_shape(self, world: World, geometry_id: int, shape: Shape, session: DeviceSession) -> World:
        """Return a world with another shape of a geometry: its tree is refitted or, where that pays, built anew there."""
        refit, before = self._refits.get(geometry_id), world.trees
        if refit is None:
            built = world.state.shapes[geometry_id]
            refit = self._refits[geometry_id] = Refit(before, geometry_id, built, session)
        trees = before.with_room(session, geometry_id, before.trees[geometry_id], self._retired)
        box = refit.write(before, trees, geometry_id, shape, session)
        if refit.sah_growth > REBUILD_GROWTH:
            del trees  # the device need not have room for it and for the next one
            trees, box = self._rebuild(before, geometry_id, shape, session)
        if geometry_id == 0:
            trees = replace(trees, box=box)
        # Queries have queues of their own, which do not wait for this one.
        session.finish()
        return place(trees, world.state.with_shape(geometry_id, shape), session)

    def retire(self, world: World, newer: World) -> None:
        """Keep what later queries do not need of a world, now that they see a newer one, for changes to come."""
        if newer.trees is not world.trees:
            self._retired.add(world.trees, newer.trees)

    def _rebuild(
        self, before: DeviceTrees, geometry_id: int, shape: Shape, session: DeviceSession
    ) -> tuple[DeviceTrees, TreeBox]:
        """Return the trees with that of a geometry built anew, and the box around it."""
        # Imported here: most tracers build no second tree.
        from ...builders.build import suit_options
        from ...builders.options import FAST_QUALITY

        self._refits.pop(geometry_id, None)
        new = NewTree.build(session, shape, suit_options(shape, FAST_QUALITY), before.layout)
        trees = before.with_room(session, geometry_id, new.tree, self._retired)
        trees.put(session, geometry_id, new)
        return trees, new.box

    def _check_known(self, instance_ids: NDArray[np.int64]) -> None:
        """Raise unless the instances were there when the tracer was opened."""
        if len(instance_ids) and instance_ids.max() >= self._opened.instance_count:
            raise SceneError(
                f"the instance {instance_ids.max()} was placed after the tracer was opened: open a new tracer"
            )
