"""One mesh in the place of a scene's instances, for the shading `path`.

A path has no beam of neighbours that finds its instances with it, so that each of its rays goes through the tree over
the instances, and into each instance whose box it meets. In one tree over all triangles, paths take half the time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..builders.build import plan_trees
from ..builders.options import DEFAULT_QUALITY
from ..device.session import DeviceSession
from ..geometry import Mesh
from ..geometry.appearance.appearance import Appearance, make_unchecked
from ..geometry.appearance.material import Material
from ..geometry.loading.file_mesh import FileMesh
from ..geometry.loading.file_parts import Parts, Placed, join_nodes
from ..scene.scene import Scene
from ..structs import HIT, NO_PRIM, WORLD_HIT
from ..support.forks import make_lock
from ..trace.launch import Caster
from ..trace.world.trees import BRUTE
from ..trace.world.world import open_world
from ..views.view import View
from .drawn_scene import DrawnScene
from .look_tables import find_all_corner_normals, has_whole_colours
from .painters import Painters

# Of a joined mesh: its tree is built anew where instances move, in less than a second.
_MOST_TRIANGLES = 2**20

# An instance that is smaller than this share of the scene would lose by the float32 of the scene's coordinates.
_LEAST_SIZE = 2.0**-10


@dataclass(frozen=True)
class JoinedScene:
    """The mesh of all instances on the device.

    Attributes
    ----------
    caster : Caster
        At the mesh, on the device of the scene.
    scene : DrawnScene
        Of the mesh.
    painters : Painters
    first_prims : (n,) int64
        The first triangle of each instance.
    scale : float
        Local units of the scene's hits in one of the mesh.
    """

    caster: Caster
    scene: DrawnScene
    painters: Painters
    first_prims: NDArray[np.int64]
    scale: float

    @classmethod
    def make(cls, session: DeviceSession, caster: Caster, scene: DrawnScene, view: View) -> Self:
        """Join the instances of a scene, and put the mesh on its device."""
        layout = caster.world.layout
        state = Scene(join_instances(scene, view)).snapshot()
        world = open_world(session, state, plan_trees(state.shapes, DEFAULT_QUALITY), layout)
        joined = DrawnScene.of_world(world)
        counts = [scene.state.shapes[geometry].prim_count for geometry in scene.state.geometry_ids]
        return cls(
            caster.at(world), joined, Painters(session, world, joined), np.cumsum([0, *counts[:-1]]),
            float(scene.space.scale / joined.space.scale),
        )  # fmt: skip

    def as_world_hits(self, found: NDArray[np.void]) -> NDArray[np.void]:
        """Return hits of the mesh, `structs.HIT`, as those of the scene, `structs.WORLD_HIT`."""
        hits = np.empty(found.shape, WORLD_HIT)
        for name in HIT.names:  # type: ignore[union-attr]
            hits[name] = found[name]
        is_hit = found["prim_id"] != NO_PRIM
        instances = np.searchsorted(self.first_prims, found["prim_id"], side="right") - 1
        hits["instance_id"] = np.where(is_hit, instances, NO_PRIM)
        hits["prim_id"] -= np.where(is_hit, self.first_prims[instances], 0).astype(np.int32)
        hits["t"] *= np.float32(self.scale)
        hits["t_inside"] = hits["t"]
        return hits


class JoinedScenes:
    """Joins the instances of a scene when a view first needs it; from any number of threads.

    Parameters
    ----------
    session : DeviceSession
        Owns the buffers of the mesh.
    caster : Caster
        At the scene, on the same device.
    scene : DrawnScene
    """

    def __init__(self, session: DeviceSession, caster: Caster, scene: DrawnScene) -> None:
        self._session, self._caster, self._scene = session, caster, scene
        self._lock = make_lock()
        self._known: tuple[Any, JoinedScene | None] = ((), None)

    def find(self, view: View) -> JoinedScene | None:
        """Return the joined scene of a view; None where the instances stay as they are."""
        if view.shading != "path" or self._scene.top is None or self._caster.world.layout == BRUTE:
            return None
        if view.cut is not None and view.section.fill:
            return None  # of which the mesh of open and closed ones has none
        with self._lock:
            key = view.smooth, view.surface  # what the looks of a mesh depend on
            if self._known[0] != key:
                self._known = key, self._join(view) if can_join(self._scene) else None
            return self._known[1]

    def _join(self, view: View) -> JoinedScene:
        return JoinedScene.make(self._session, self._caster, self._scene, view)


def can_join(scene: DrawnScene) -> bool:
    """Return whether one mesh shows what the instances of a scene show."""
    state = scene.state
    placed = [state.shapes[geometry] for geometry in np.unique(state.geometry_ids)]
    if not 0 < state.placed_prim_count <= _MOST_TRIANGLES or not state.masks.all():
        return False
    # The light of a shape is drawn if no corner of it is transparent, see `find_lights`.
    if not all(isinstance(shape, Mesh) and has_whole_colours(shape.appearance) for shape in placed):
        return False
    lower, upper = scene.bounds.instance_boxes()
    is_fine = (upper - lower).max(axis=1).min() >= _LEAST_SIZE * (upper.max(axis=0) - lower.min(axis=0)).max()
    # A mirrored triangle would have its corners turned round, and with them u and v of its hits.
    return bool(is_fine and (np.linalg.det(state.transforms[:, :3, :3]) > 0).all())


def join_instances(scene: DrawnScene, view: View) -> Mesh:
    """Return the triangles of all instances as one mesh, one instance after the other, in the scene's coordinates."""
    shapes, shape_ids, colours = scene.looks
    # Where one mesh is smooth, all have normals at their corners.
    normals = find_all_corner_normals(shapes, view.smooth)
    plain = (Material(base_colour=view.surface),)
    meshes, placed = [], []
    for number, (shape_id, colour) in enumerate(zip(shape_ids.tolist(), colours, strict=True)):
        shape = shapes[shape_id]
        assert isinstance(shape, Mesh)
        looks = shape.appearance or Appearance()
        materials = looks.materials or plain
        if not np.isnan(colour).any():
            own = tuple(colour.tolist())
            materials = tuple(replace(each, base_colour=own, base_colour_texture=None) for each in materials)
            looks = replace(looks, colours=None)
        looks = make_unchecked(**(vars(looks) | {"materials": materials, "normals": normals[shape_id]}))
        meshes.append(FileMesh("", shape.vertices, shape.faces, looks))
        placed.append(Placed(str(number), number, scene.state.transforms[number]))
    joined = join_nodes(Parts(meshes, placed))
    return Mesh.from_arrays(joined.vertices, joined.faces, appearance=joined.appearance)
