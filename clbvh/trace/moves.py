"""The moves of a tracer: vertices, transforms, masks and spheres that change between queries.

How trees follow is in `world/changes.py`.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numpy.typing import ArrayLike

from ..bvh import Bvh
from ..errors import ConfigError, SceneError
from ..geometry import Mesh, Shape, Spheres
from ..layouts.device_mesh import move_mesh
from ..scene.handles import Geometry, Instances
from .launch import Call, HasCaster
from .world.changes import Changes
from .world.world import World


class Moves(HasCaster):
    """The methods of a `Tracer` that move what it is at."""

    # Held by a move, so that two of them do not write at the same time.
    _updating: threading.RLock

    def update(self, vertices: ArrayLike) -> None:
        """Move the vertices of the mesh: the device refits the tree, or builds it anew where that pays.

        Later queries find the same hits as with a new tracer over the moved mesh.

        Parameters
        ----------
        vertices : (V, 3) float, the file's coordinates
            The same number as before; copied. Size and place of the mesh may change. A `pyopencl.array.Array` in
            `Tracer.context` does not leave the device.

        Raises
        ------
        MeshError
            Another number of vertices, wrong shape or dtype, or vertices that `Mesh.from_arrays` refuses.
        QueryError
            The tracer is closed.
        DeviceError
            The device refuses, or this process was forked from one that has used OpenCL.

        Notes
        -----
        After an error or Ctrl-C the tracer is as before the update, or as after it.

        Updates wait for each other, but not for queries of other threads: a query that is running ends on the mesh
        that it began with. Results refer to the mesh that was hit (`Hits.mesh`) and keep their locations.

        A tree whose SAH cost has grown by 1.3 is built anew, with the quality ``"fast"``; see `sah_growth`. Vertices go
        to the device, and nothing else does.

        A tree that is updated is on the device twice, and once more for each older mesh that queries of other threads
        still use; about 30 bytes per triangle are needed to refit it. The tree that the tracer was made of does not
        change.

        Examples
        --------
        >>> import clbvh
        >>> vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
        >>> with clbvh.Tracer((vertices, [[0, 1, 2]])) as tracer:
        ...     tracer.update([[0, 0, 1], [1, 0, 1], [0, 1, 1]])
        ...     tracer.closest_hit([[0.25, 0.25, 3]], [[0, 0, -1]]).t
        array([2.])
        """
        if self._caster.world.mesh is None:
            raise ConfigError("a tracer of a scene moves one geometry: call set_vertices(geometry, vertices)")
        with self._changing() as (call, _):
            mesh = move_mesh(self.mesh, vertices, call.session)
            self._change(call, Changes.set_shape, 0, mesh)

    def set_transforms(self, instances: Instances, transforms: ArrayLike) -> None:
        """Move instances of a scene: only the tree over the instances is built anew.

        Parameters
        ----------
        instances : Instance, int or str, or several
            Those to move, by handle, id or name. The others stay where they are.
        transforms : (n, 4, 4) float, or Transform
            From the coordinates of each instance's geometry to the scene's; (4, 4) for one.

        Raises
        ------
        SceneError
            No such instance, one of another scene, or one that was placed after the tracer was opened; a matrix that
            is not finite, not affine, or singular; or an instance that is too small beside the scene.
        QueryError
            The tracer is closed.
        DeviceError
            The device refuses, or this process was forked from one that has used OpenCL.

        Notes
        -----
        Changes wait for each other, but not for queries: a query that is running ends on the scene that it began with.
        The scene that the tracer was opened with does not change.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene()
        >>> ball = scene.place(scene.add(clbvh.make_shape("icosphere", triangles=320)), name="ball")
        >>> with clbvh.Tracer(scene) as tracer:
        ...     before = tracer.any_hit([[0, 0, 5]], [[0, 0, -1]])
        ...     tracer.set_transforms("ball", clbvh.Transform(translate=(9, 0, 0)))
        ...     before, tracer.any_hit([[0, 0, 5], [9, 0, 5]], [[0, 0, -1], [0, 0, -1]])
        (array([ True]), array([False,  True]))
        """
        with self._changing() as (call, world):
            self._change(call, Changes.set_instances, self._changes.move_state(world, instances, transforms))

    def set_masks(self, instances: Instances, masks: ArrayLike) -> None:
        """Give instances of a scene other masks, and remove them by a mask of 0: only the tree over them is new.

        Parameters
        ----------
        instances : Instance, int or str, or several
            By handle, id or name. The others keep their masks.
        masks : (n,) int, or int
            0 to 2^32 - 1, see `Scene.place`; an int for all of these instances. With a mask of 0, no ray and no point
            sees an instance, it costs them no time, and pictures do not show it, until it gets another mask.

        Raises
        ------
        SceneError
            No such instance, one of another scene, or one that was placed after the tracer was opened; a mask out of
            range; or an instance that is too small beside the scene.
        QueryError, DeviceError
            As of `set_transforms`.

        Notes
        -----
        An instance of mask 0 can be moved, and `closest_pair`, `is_colliding` and `collisions` measure it only where it
        is named. See `set_transforms`.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene()
        >>> ball = scene.place(scene.add(clbvh.make_shape("icosphere", triangles=320)), name="ball")
        >>> with clbvh.Tracer(scene) as tracer:
        ...     tracer.set_masks("ball", 0)
        ...     removed = tracer.any_hit([0, 0, 5], [0, 0, -1])
        ...     tracer.set_masks("ball", 0b01)
        ...     removed, tracer.any_hit([[0, 0, 5]] * 2, [0, 0, -1], mask=[0b01, 0b10])
        (array(False), array([ True, False]))
        """
        with self._changing() as (call, world):
            self._change(call, Changes.set_instances, self._changes.mask_state(world, instances, masks))

    def set_vertices(self, geometry: Geometry | str, vertices: ArrayLike) -> None:
        """Move the vertices of a geometry of a scene: its tree is refitted, or built anew where that pays.

        Parameters
        ----------
        geometry : Geometry or str
            As `Scene.add` returned it.
        vertices : (V, 3) float, the geometry's coordinates
            The same number as before; of spheres, their centres, see also `set_spheres`.

        Raises
        ------
        MeshError
            Another number of vertices, wrong shape or dtype, or vertices that `Mesh.from_arrays` refuses.
        SceneError
            A geometry of another scene, or one that was added after the tracer was opened.
        QueryError, DeviceError
            As of `set_transforms`.

        Notes
        -----
        A tree whose SAH cost has grown by 1.3 is built anew, on the device. See `set_transforms`.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene()
        >>> mesh = clbvh.make_shape("icosphere", triangles=320)
        >>> ball = scene.add(mesh)
        >>> aside = [[1, 0, 0, 9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
        >>> first, second = scene.place(ball), scene.place(ball, aside)
        >>> with clbvh.Tracer(scene) as tracer:
        ...     tracer.set_vertices(ball, mesh.vertices * 0.5)
        ...     tracer.any_hit([[0.7, 0, 5], [9.7, 0, 5], [9.4, 0, 5]], [0, 0, -1])
        array([False, False,  True])
        """
        with self._changing() as (call, world):
            geometry_id, shape = self._changes.find_shape(world, geometry)
            if isinstance(shape, Spheres):
                moved: Shape = shape.with_spheres(vertices)
            else:
                moved = move_mesh(shape, vertices, call.session)
            self._change(call, Changes.set_shape, geometry_id, moved)

    @property
    def mesh(self) -> Mesh:
        """The mesh as it is now.

        Raises
        ------
        ConfigError
            The tracer has a scene of several objects.
        """
        mesh = self._caster.world.mesh
        if mesh is None:
            raise ConfigError("a tracer of a scene has no single mesh: see scene.geometries")
        return mesh

    @property
    def bvh(self) -> Bvh:
        """The binary tree of the mesh as it is now: the one that was given, or built again where none was kept.

        A tree of the quality ``"fast"`` is built on the device, and downloaded. Each access takes as long as a build.

        Raises
        ------
        ConfigError
            The tracer has a scene of several objects.
        """
        with self._changing() as (_, world):
            if world.mesh is None:
                raise ConfigError("a tracer of a scene has no single tree")
            return self._changes.get_tree(world)

    @property
    def sah_growth(self) -> float:
        """The SAH cost of the tree now, divided by its cost when it was built: 1.3 at most, then `update` builds anew.

        1 until the first `update`; moving or scaling the whole mesh does not change it. Rays slow down by less than
        this factor.
        """
        return 1.0 if self._caster.world.mesh is None else self._changes.sah_growth(0)

    def set_spheres(self, geometry: Geometry | str, centres: ArrayLike, radii: ArrayLike | None = None) -> None:
        """Move the spheres of a geometry of a scene: their tree is refitted, or built anew where that pays.

        Parameters
        ----------
        geometry : Geometry or str
            As `Scene.add` returned it.
        centres : (n, 3) float, the geometry's coordinates
            As many as before.
        radii : (n,) float, or float, optional
            The present radii if left out.

        Raises
        ------
        MeshError
            Another number of spheres, or spheres that `clbvh.Spheres` refuses.
        SceneError
            The geometry is a mesh, of another scene, or was added after the tracer was opened.
        QueryError, DeviceError
            As of `set_transforms`.

        Notes
        -----
        A tree whose SAH cost has grown by 1.3 is built anew, on the device. See `set_transforms`.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene()
        >>> atoms = scene.add(clbvh.Spheres([[0, 0, 0], [4, 0, 0]], 1))
        >>> placed = scene.place(atoms)
        >>> with clbvh.Tracer(scene) as tracer:
        ...     tracer.set_spheres(atoms, [[0, 0, 1], [4, 0, 0]], [1, 0.5])
        ...     tracer.closest_hit([[0, 0, 5], [4, 0, 5]], [0, 0, -1]).t
        array([3. , 4.5])
        """
        with self._changing() as (call, world):
            geometry_id, shape = self._changes.find_shape(world, geometry)
            if not isinstance(shape, Spheres):
                raise SceneError(f"{geometry!r} is a mesh and has no spheres: call set_vertices(geometry, vertices)")
            moved = shape.with_spheres(centres, radii)
            self._change(call, Changes.set_shape, geometry_id, moved)

    @contextmanager
    def _changing(self) -> Iterator[tuple[Call, World]]:
        """Give memory on the device for a change, and the newest world, while no other change is at work."""
        with self._caster.open_call() as call, self._updating:
            yield call, self._caster.world

    def _change(self, call: Call, change: Callable[..., World], *arguments: Any) -> None:
        """Change the world, and let later queries see it.

        Parameters
        ----------
        call : Call
            Of `_changing`.
        change : function
            Called with the tracer's changes, its world, the arguments, and the session of the call.
        """
        before = self._caster.world
        after = change(self._changes, before, *arguments, call.session)
        self._caster = self._caster.at(after)
        # Not earlier: after Ctrl-C the buffers of the world that stays would be written by the next change.
        self._changes.retire(before, after)
