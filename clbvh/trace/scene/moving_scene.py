"""The scene of a tracer, as it opens and as it moves.

Every change makes a new `DeviceScene`, which shares the buffers that stay the same. So a query sees one scene from
beginning to end, a change waits for none, and one that fails has changed nothing. Buffers that a change has replaced
are given back once no query uses them: a query holds the caster that it began with.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias
from weakref import ref

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
from .device_scene import DeviceScene
from .refit_geometry import RefitGeometry

_Tree: TypeAlias = DeviceTree | DeviceScene

# A geometry's tree is built anew when its SAH cost has grown by this factor.
REBUILD_GROWTH = 1.3


class _Now(NamedTuple):
    """The scene of a caster: its tree on the device, what it shows, and the trees of its geometries as built."""

    tree: _Tree
    state: SceneState
    trees: Sequence[Bvh]


class _Held(NamedTuple):
    """A scene that has been used, and its buffers, which outlive it."""

    tree: ref[_Tree]
    buffers: list[Any]


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

    Attributes
    ----------
    state : SceneState
        The scene as the tracer was opened.
    """

    def __init__(
        self, contents: SceneContents, build_tree: Callable[[Shape], Bvh], build_top: Callable[[Mesh], Bvh]
    ) -> None:
        self._contents = contents
        self._build_tree, self._build_top = build_tree, build_top
        self.state: SceneState = contents.snapshot()
        self._trees: list[Bvh] = [build_tree(shape) for shape in self.state.shapes]
        self._refits: dict[int, RefitGeometry] = {}
        # Of geometries that were refitted before another one was built anew.
        self._growths: dict[int, float] = {}
        self._held: list[_Held] = []

    def open(self, session: DeviceSession, layout: str) -> tuple[_Tree, TreeBox]:
        """Put the scene on a device, and return it with the box around it.

        A mesh that is placed once, where it is, needs no instance.
        """
        if self.state.is_one_mesh:
            bvh = self._trees[self.state.geometry_ids[0]]
            tree = DeviceTree(session, bvh.mesh, bvh, layout)
            self._held.append(_Held(ref(tree), list(tree.buffers.arguments.values())))
            return tree, TreeBox.around(bvh)
        scene = DeviceScene(session, self.state, self._trees, self._build_top, layout)
        self._held.append(_Held(ref(scene), scene.buffers()))
        return scene, scene.box

    def set_transforms(self, caster: Caster, instances: Any, matrices: ArrayLike, session: DeviceSession) -> Caster:
        """Return a caster at the scene with other transforms; see `Tracer.set_transforms`."""
        ids = self._contents.instance_ids(instances)
        transforms = check_transforms(matrices)
        if len(transforms) != len(ids):
            raise SceneError(f"{len(ids):,} instances need as many transforms, not {len(transforms):,}")
        if len(ids) and ids.max() >= self.state.instance_count:
            raise SceneError(f"the instance {ids.max()} was placed after the tracer was opened: open a new tracer")
        now = self._now(caster)
        state = now.state.with_transforms(ids, transforms)
        if isinstance(now.tree, DeviceScene):
            moved = now.tree.moved(caster.session, session, state)
        else:
            moved = DeviceScene(caster.session, state, _refit_trees(now), self._build_top, now.tree.layout)
        return self._use(caster, moved)

    def set_vertices(self, caster: Caster, geometry: Geometry, vertices: ArrayLike, session: DeviceSession) -> Caster:
        """Return a caster at the scene with a geometry whose vertices have moved; see `Tracer.set_vertices`."""
        geometry_id = self._contents.geometry_id(geometry)
        if geometry_id >= len(self.state.shapes):
            raise SceneError(f"{geometry!r} was added after the tracer was opened: open a new tracer")
        now = self._now(caster)
        shape = now.state.shapes[geometry_id]
        moved_shape: Shape
        if isinstance(shape, Spheres):
            moved_shape = shape.with_spheres(vertices, shape.radii)
        else:
            moved_shape = shape.with_vertices(vertices)
        state = now.state.with_shape(geometry_id, moved_shape)
        if isinstance(moved_shape, Mesh) and isinstance(now.tree, DeviceScene):
            refit = self._refits.get(geometry_id)
            if refit is None:
                refit = RefitGeometry(now.tree, geometry_id, session, self._growths.get(geometry_id, 1.0))
            scene = now.tree.with_geometry(caster.session, session, state, geometry_id, refit, caster.threads)
            self._refits[geometry_id] = refit
            if refit.sah_growth <= REBUILD_GROWTH:
                return self._use(caster, scene)
            scene.release_other_than(now.tree, caster.session)
        trees = _refit_trees(now)
        trees[geometry_id] = self._build_tree(moved_shape)
        built = DeviceScene(caster.session, state, trees, self._build_top, now.tree.layout)
        # The arrays of all geometries are new.
        self._growths |= {number: refit.sah_growth for number, refit in self._refits.items()}
        self._growths.pop(geometry_id, None)
        self._refits.clear()
        return self._use(caster, built)

    def _now(self, caster: Caster) -> _Now:
        """Return the scene of a caster."""
        tree: Any = caster.tree
        if isinstance(tree, DeviceScene):
            return _Now(tree, tree.state, tree.trees)
        return _Now(tree, self.state, self._trees)

    def _use(self, caster: Caster, scene: DeviceScene) -> Caster:
        """Return a caster at a scene, and give back the buffers that no scene in use has."""
        self._held.append(_Held(ref(scene), scene.buffers()))
        self._release_unused(caster.session)
        return caster.over(scene, scene.box)

    def _release_unused(self, session: DeviceSession) -> None:
        """Give back the buffers that no scene in use has."""
        in_use = [held for held in self._held if held.tree() is not None]
        used = {id(buffer) for held in in_use for buffer in held.buffers}
        unused = {id(buffer): buffer for held in self._held for buffer in held.buffers if id(buffer) not in used}
        # Forgotten first: Ctrl-C below leaves buffers to the session's end, but none is given back twice.
        self._held = in_use
        for buffer in unused.values():
            session.release(buffer)


def _refit_trees(now: _Now) -> list[Bvh]:
    """Return the trees of all geometries around the vertices as they are now."""
    return [
        bvh.refit(shape.vertices) if isinstance(shape, Mesh) and bvh.mesh is not shape else bvh
        for bvh, shape in zip(now.trees, now.state.shapes, strict=True)
    ]
