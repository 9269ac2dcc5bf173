"""The scene as users see it: geometries are added, placed by transforms, and found by id or name.

Owns ids and names. Must not know of trees, devices, cameras and pictures.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError
from ..geometry.appearance.material import Material
from ..geometry.as_mesh import HasGraph, MeshLike, as_shape
from ..geometry.loading.file_parts import Parts, Placed
from ..geometry.loading.load import load_parts, load_placed
from ..geometry.spheres import Shape
from ..support.forks import make_lock
from .handles import (
    ALL_BITS,
    Colour,
    Geometry,
    Handles,
    Instance,
    Instances,
    check_colour,
    check_mask,
    check_masks,
    check_material,
    shorten,
)
from .names import Named, name_of_file
from .parts import NamedParts, parts_of_file, parts_of_graph
from .state import SceneState
from .transforms import check_transform, check_transforms

_NO_COLOUR = (np.nan, np.nan, np.nan)


class Scene:
    """Objects: geometries, and the instances that place them. `View` has the settings of a picture.

    `Scene()` is empty: `add` takes geometries, and `place` places them. `Scene("car.glb")` adds and places all that the
    file holds.

    Parameters
    ----------
    source : Scene, Spheres, Mesh, str, path, (vertices, faces), or an object of trimesh, pyvista, Open3D, meshio
        Placed once, where it is; see `add`. But a GLB or glTF file, or a `trimesh.Scene`, whose nodes place more than
        twice the triangles that its meshes have, is added part by part, and so is another `Scene`; see `add_parts`.

    Raises
    ------
    MeshError
        The source is no valid mesh.

    Notes
    -----
    Any number of threads may use a scene, also while one of them adds objects: a tracer has the objects of the moment
    at which it was made. Scenes pickle. `copy` makes a scene of its own with the same geometries.

    Examples
    --------
    >>> import clbvh
    >>> scene = clbvh.Scene()
    >>> ball = scene.add(clbvh.make_shape("icosphere", triangles=320), name="ball")
    >>> left = scene.place(ball)
    >>> right = scene.place(ball, clbvh.Transform(scale=2, translate=(5, 0, 0)))
    >>> scene
    Scene(geometries=1, instances=2)
      'ball': 320 triangles, placed as 'ball', 'ball 2'
    >>> scene.instances
    (Instance(0, 'ball', of='ball'), Instance(1, 'ball 2', of='ball'))
    """

    def __init__(self, source: Shape | MeshLike | Scene | None = None) -> None:
        self._lock = make_lock()  # re-entrant: several parts are added as one step
        self._geometries, self._instances = Named[Geometry]("a geometry"), Named[Instance]("an instance")
        self._transforms: list[NDArray[np.float64]] = []  # (n, 4, 4) of each call of `place_many`
        # Handles refer to this token: the scene itself would keep its meshes alive until Python looks for cycles.
        self._owner = object()
        self._drop_caches()
        if isinstance(source, Scene):
            self.add_parts(source)
        elif isinstance(source, str | os.PathLike):
            self._add_placed(parts_of_file(source, load_placed))
        elif isinstance(source, HasGraph):
            self._add_placed(parts_of_graph(source, joins=True))
        elif source is not None:
            self.place(self.add(source))

    def _drop_caches(self) -> None:
        self._snapshot: SceneState | None = None
        self._handles: tuple[tuple[Geometry, ...], tuple[Instance, ...]] | None = None

    @classmethod
    def from_state(cls, state: SceneState) -> Scene:
        """Return a scene of the objects of a snapshot.

        Examples
        --------
        >>> import clbvh
        >>> state = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320)).snapshot()
        >>> clbvh.Scene.from_state(state).instances
        (Instance(0, 'icosphere', of='icosphere'),)
        """
        return cls._restore(state, object())

    @classmethod
    def _restore(cls, state: SceneState, owner: object) -> Scene:
        scene = cls()
        scene._owner = owner
        geometries = [scene._add(*shape) for shape in zip(state.shapes, state.names, state.names, strict=True)]
        numbers = zip(state.geometry_ids.tolist(), state.masks.tolist(), state.material_ids.tolist(), strict=True)
        colours = [None if math.isnan(colour[0]) else tuple(colour) for colour in state.colours.tolist()]
        materials = (*state.materials, None)  # -1: none
        rows = zip(state.instance_names, state.transforms, numbers, colours, strict=True)
        for index, (name, matrix, (geometry, mask, material), colour) in enumerate(rows):
            scene._instances[name] = Instance(
                index, name, geometries[geometry], matrix, mask, colour, materials[material]
            )
        scene._transforms = [state.transforms]
        scene._snapshot = state
        return scene

    def _at(self, state: SceneState) -> Scene:
        """Return the scene in another state, with the same handles."""
        return Scene._restore(state, self._owner)

    def __reduce__(self) -> tuple[Any, ...]:
        # The owner travels, too, so that handles pickled with their scene still belong to it.
        return Scene._restore, (self.snapshot(), self._owner)

    def copy(self) -> Scene:
        """Return a scene of the same geometries and instances; what is added to either is not in the other.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320))
        >>> scene.copy().instances
        (Instance(0, 'icosphere', of='icosphere'),)
        """
        return Scene.from_state(self.snapshot())

    __copy__ = copy

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save the scene as one file: geometries, instances, names, masks; `save_scene` adds a view.

        The file appears complete or not at all; one of that name is replaced.

        Raises
        ------
        ConfigError
            The folder does not exist, or the path is a folder.
        OSError
            The file cannot be written: the disk is full, for example.

        Examples
        --------
        >>> import clbvh
        >>> import tempfile
        >>> from pathlib import Path
        >>> folder = tempfile.TemporaryDirectory()
        >>> clbvh.Scene(clbvh.make_shape("icosphere", triangles=320)).save(Path(folder.name, "ball.scene"))
        >>> clbvh.Scene.load(Path(folder.name, "ball.scene")).instances
        (Instance(0, 'icosphere', of='icosphere'),)
        >>> folder.cleanup()
        """
        from .serialize import write_scene  # most scenes are not saved

        write_scene(path, self.snapshot(), {})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Scene:
        """Load the objects of a file that `save` or `save_scene` wrote; `open_scene` also returns the view.

        Nothing in the file is run or trusted: a damaged, cut off or forged one is refused.

        Raises
        ------
        SceneError
            The file cannot be read, or is no whole scene. The message names the fault.

        Examples
        --------
        >>> import clbvh
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     clbvh.Scene(clbvh.Spheres([[0, 0, 0]], 1)).save(Path(folder, "ball.scene"))
        ...     clbvh.Scene.load(Path(folder, "ball.scene"))
        Scene(geometries=1, instances=1)
          'spheres': 1 sphere, placed as 'spheres'
        """
        from .serialize import read_scene

        return cls.from_state(read_scene(path)[0])

    def add(self, source: Shape | MeshLike, *, name: str | None = None) -> Geometry:
        """Add a geometry, which is seen by no ray until it is placed.

        Parameters
        ----------
        source : Spheres, Mesh, str, path, (vertices, faces), or an object of trimesh, pyvista, Open3D, meshio
            A mesh in any form, see `clbvh.MeshLike`, or spheres. A file of several parts becomes one mesh with
            `Mesh.parts`, and so does a `trimesh.Scene`: `Hits.part_id` says which was hit. `add_parts` makes
            each part a geometry of its own, which can be moved.
        name : str, optional
            Unique among the geometries of the scene. By default that of the source, with a number where it is taken:
            ``"bunny"``, ``"bunny 2"``.

        Raises
        ------
        MeshError
            The source is no valid mesh.
        SceneError
            The name is taken, or is no name.

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> scene = clbvh.Scene()
        >>> scene.add(trimesh.creation.box(), name="crate")
        Geometry(0, 'crate', Mesh('Trimesh', vertices=8, faces=12))
        >>> scene.add(clbvh.make_shape("icosphere", triangles=320)).name
        'icosphere'
        >>> scene.is_empty  # nothing is placed yet
        True
        """
        if isinstance(source, Geometry):
            raise SceneError(f"{source!r} is in a scene already: place it again, or add its shape to another scene")
        if isinstance(source, Scene):
            raise SceneError("a clbvh.Scene has geometries and places for them: add it by `add_parts`")
        shape = as_shape(source)
        wish = name_of_file(shape.name) if isinstance(source, str | os.PathLike) else shape.name
        return self._add(shape, name, wish)

    def _add(self, shape: Shape, name: str | None, wish: str) -> Geometry:
        with self._lock:
            unique = self._geometries.find_free(wish) if name is None else self._geometries.check(name)
            geometry = self._geometries[unique] = Geometry(len(self._geometries), unique, shape, self._owner)
            self._drop_caches()
            return geometry

    def add_parts(
        self,
        source: str | os.PathLike[str] | HasGraph | Scene,
        transform: ArrayLike | None = None,
        *,
        mask: int | None = None,
    ) -> tuple[Instance, ...]:
        """Add the parts of a file or of a scene, and place them where they are in it: all of them or none.

        Parameters
        ----------
        source : str, path, trimesh.Scene or Scene
            Parts are the meshes of a GLB or glTF file, each with an instance for each node that has it; the objects
            (`o`) of an OBJ file, or its groups (`g`) if no object is named; the triangle meshes that nodes of a
            `trimesh.Scene` place. Other mesh files are one part. Nodes that a scale of 0 hides are left out. Names are
            kept, with a number where they are taken.
        transform : (4, 4) float, or Transform, optional
            Moves the whole; the identity if left out.
        mask : int, 0 to 2^32 - 1
            Mask of all instances. By default all bits, or the masks of the other `Scene`.

        Returns
        -------
        tuple of Instance
            In the order of the nodes; each has its `geometry`.

        Raises
        ------
        MeshError
            The file or a mesh cannot be used.
        SceneError
            Nothing is placed in the source, or a transform is not finite, or the whole is moved by a singular one. The
            message names it.

        Examples
        --------
        >>> import clbvh
        >>> import trimesh
        >>> wheel = trimesh.creation.cylinder(radius=0.3, height=0.2)
        >>> cart = trimesh.Scene()
        >>> _ = cart.add_geometry(trimesh.creation.box((2, 1, 0.5)), node_name="body", geom_name="box")
        >>> _ = cart.add_geometry(wheel, node_name="left", geom_name="wheel")
        >>> _ = cart.graph.update("right", geometry="wheel", matrix=clbvh.Transform(translate=(0, 1, 0)).matrix)
        >>> scene = clbvh.Scene()
        >>> scene.add_parts(cart)
        (Instance(0, 'body', of='box'), Instance(1, 'left', of='wheel'), Instance(2, 'right', of='wheel'))
        """
        outer = None if transform is None else check_transform(transform)
        common_mask = None if mask is None else check_mask(mask)
        if isinstance(source, str | os.PathLike):
            parts = parts_of_file(source, load_parts)
        elif isinstance(source, Scene):
            geometries, instances = source._list_handles()
            parts = Parts(
                [(geometry.shape, geometry.name) for geometry in geometries],
                [
                    Placed(one.name, one.geometry.id, one.matrix, (one.mask, one.colour, one.material))
                    for one in instances
                ],
            )
        elif isinstance(source, HasGraph):
            parts = parts_of_graph(source)
        else:
            raise SceneError(f"expected the path of a file, a trimesh.Scene or a clbvh.Scene, not {shorten(source)}")
        return self._add_placed(parts, outer, common_mask)

    def _add_placed(
        self, parts: NamedParts, outer: NDArray[np.float64] | None = None, common_mask: int | None = None
    ) -> tuple[Instance, ...]:
        matrices = np.array([part.matrix for part in parts.placed], np.float64).reshape(-1, 4, 4)
        with np.errstate(over="ignore", invalid="ignore"):  # refused if it is not finite
            matrices = matrices if outer is None else outer @ matrices
        names = [part.name for part in parts.placed]
        matrices = check_transforms(matrices, lambda index: f"the transform of {shorten(names[index])}")
        matrices.flags.writeable = False
        with self._lock:
            geometries = [self._add(shape, None, name) for shape, name in parts.shapes]
            instances: list[Instance] = []
            for (name, shape, _, looks), matrix in zip(parts.placed, matrices, strict=True):
                own_mask, colour, material = looks or (ALL_BITS, None, None)
                looks = own_mask if common_mask is None else common_mask, colour, material
                instances += self._place(geometries[shape], matrix[None], (self._instances.find_free(name),), looks)
            return Handles(instances)

    def place(
        self,
        geometry: Geometry | str,
        transform: ArrayLike | None = None,
        *,
        name: str | None = None,
        mask: int = ALL_BITS,
        colour: ArrayLike | None = None,
        material: Material | None = None,
    ) -> Instance:
        """Place a geometry in the scene; any number of times.

        Parameters
        ----------
        geometry : Geometry or str
            A geometry of this scene, by its handle or name.
        transform : (4, 4) float, or Transform, optional
            Map from the geometry's coordinates to the scene's: rotation, scale of any kind, shear, mirror, translation.
            The identity if left out.
        name : str, optional
            Unique among the instances of the scene. By default that of the geometry, with a number where it is taken.
        mask : int, 0 to 2^32 - 1
            A ray sees the instance if its own mask shares a bit with this one. All bits by default.
        colour : (3,) float, optional
            Linear red, green and blue in pictures, 0 to 1; by default `View.surface`.
        material : Material, optional
            Material of all primitives of this instance, in place of the geometry's materials and colours. Instances of
            a geometry share its tree, whatever their materials.

        Returns
        -------
        Instance

        Raises
        ------
        SceneError
            A geometry of another scene; a matrix that is not finite, not affine, or singular; a name that is taken; a
            mask out of range; a colour that is not three finite numbers, or a material that is none.

        Examples
        --------
        >>> import clbvh
        >>> import numpy as np
        >>> scene = clbvh.Scene()
        >>> ball = scene.add(clbvh.make_shape("icosphere", triangles=320))
        >>> scene.place(ball, np.diag([2, 1, 1, 1]), name="egg")
        Instance(0, 'egg', of='icosphere')
        >>> scene.place(ball, np.diag([0, 1, 1, 1]))
        Traceback (most recent call last):
        clbvh.errors.SceneError: the transform is singular: it flattens what it moves, and rays cannot be moved back
        """
        names = None if name is None else (name,)
        looks = check_mask(mask), check_colour(colour), check_material(material)
        return self._place(geometry, check_transform(transform)[None], names, looks)[0]

    def place_many(
        self,
        geometry: Geometry | str,
        transforms: ArrayLike,
        *,
        names: Sequence[str] | None = None,
        mask: int = ALL_BITS,
        colour: ArrayLike | None = None,
        material: Material | None = None,
    ) -> tuple[Instance, ...]:
        """Place a geometry once for each of many transforms, as `place` does, but all of them or none.

        Parameters
        ----------
        geometry : Geometry or str
            A geometry of this scene, by its handle or name.
        transforms : (n, 4, 4) float
        names : sequence of str, optional
            One name for each transform.
        mask : int, 0 to 2^32 - 1
        colour : (3,) float, optional
            Colour of all instances.
        material : Material, optional
            Material of all instances.

        Returns
        -------
        tuple of Instance

        Raises
        ------
        SceneError
            See `place`.

        Examples
        --------
        >>> import clbvh
        >>> import numpy as np
        >>> scene = clbvh.Scene()
        >>> ball = scene.add(clbvh.make_shape("icosphere", triangles=320), name="ball")
        >>> row = np.tile(np.eye(4), (3, 1, 1))
        >>> row[:, 0, 3] = [0, 5, 10]
        >>> [instance.name for instance in scene.place_many(ball, row)]
        ['ball', 'ball 2', 'ball 3']
        """
        matrices = check_transforms(transforms)
        if isinstance(names, str) or (names is not None and len(names) != len(matrices)):
            raise SceneError(f"{len(matrices):,} transforms need as many names, or none, not {shorten(names)}")
        looks = check_mask(mask), check_colour(colour), check_material(material)
        return self._place(geometry, matrices, names, looks)

    def _place(
        self,
        geometry: Geometry | str,
        matrices: NDArray[np.float64],
        names: Sequence[str] | None,
        looks: tuple[int, Colour | None, Material | None],
    ) -> tuple[Instance, ...]:
        """Place a geometry by checked transforms."""
        geometry = self.find_geometry(geometry) if isinstance(geometry, str) else geometry
        self.geometry_id(geometry)
        matrices.flags.writeable = False
        with self._lock:
            if names is not None and len({self._instances.check(name) for name in names}) < len(names):
                raise SceneError("two of the names are the same, but the names of instances are unique")
            placed = []
            for number, matrix in enumerate(matrices):
                name = self._instances.find_free(geometry.name) if names is None else names[number]
                instance = self._instances[name] = Instance(len(self._instances), name, geometry, matrix, *looks)
                placed.append(instance)
            self._transforms.append(matrices)
            self._drop_caches()
            return Handles(placed)

    @property
    def geometries(self) -> tuple[Geometry, ...]:
        """All geometries; the index is the id."""
        return self._list_handles()[0]

    @property
    def instances(self) -> tuple[Instance, ...]:
        """All instances; the index is the id."""
        return self._list_handles()[1]

    def _list_handles(self) -> tuple[tuple[Geometry, ...], tuple[Instance, ...]]:
        with self._lock:
            if self._handles is None:
                self._handles = Handles(self._geometries.values()), Handles(self._instances.values())
            return self._handles

    @property
    def is_empty(self) -> bool:
        """True if nothing is placed: no ray hits anything."""
        return not self._instances

    def find(self, name: str) -> Instance:
        """Return the instance of a name.

        Raises
        ------
        SceneError
            No instance has the name.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320))
        >>> scene.find("icosphere").id
        0
        """
        return self._find("instance", name, self._instances)

    def find_geometry(self, name: str) -> Geometry:
        """Return the geometry of a name.

        Raises
        ------
        SceneError
            No geometry has the name.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320))
        >>> scene.find_geometry("icosphere").id
        0
        """
        return self._find("geometry", name, self._geometries)

    def view(self, view: Any = None, options: Any = None, **changes: Any) -> Any:
        """Look at the scene as it is now: live, in the notebook or in the browser; see `clbvh.view`.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320))
        >>> scene.view(shading="ao")  # doctest: +SKIP
        """
        import clbvh  # imported here: a scene knows nothing of the folders above it

        return clbvh.view(self, view, options, **changes)

    def _find(self, kind: str, name: object, things: Named[Any]) -> Any:
        with self._lock:
            if isinstance(name, str) and name in things:
                return things[name]
            known = ", ".join(map(shorten, list(things)[:5])) + (", ..." if len(things) > 5 else "")
        raise SceneError(f"the scene has no {kind} {shorten(name)}; it has {known or 'none'}")

    def snapshot(self) -> SceneState:
        """Return the present state of the scene: immutable, and the same object until something is added.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320))
        >>> scene.snapshot().geometry_ids
        array([0], dtype=int32)
        """
        with self._lock:
            if self._snapshot is None:
                instances, count = self._instances.values(), len(self._instances)
                numbers: dict[Material | None, int] = {None: -1}  # equal materials are one
                for instance in instances:
                    numbers.setdefault(instance.material, len(numbers) - 1)
                self._transforms = [np.concatenate((np.empty((0, 4, 4)), *self._transforms))]
                colours = [instance.colour or _NO_COLOUR for instance in instances]
                self._snapshot = SceneState(
                    shapes=tuple(geometry.shape for geometry in self._geometries.values()),
                    names=tuple(self._geometries),
                    geometry_ids=np.fromiter((instance.geometry.id for instance in instances), np.int32, count),
                    transforms=self._transforms[0],
                    masks=np.fromiter((instance.mask for instance in instances), np.uint32, count),
                    instance_names=tuple(self._instances),
                    colours=np.array(colours, np.float64).reshape(count, 3),
                    materials=tuple(material for material in numbers if material is not None),
                    material_ids=np.fromiter((numbers[instance.material] for instance in instances), np.int32, count),
                )
            return self._snapshot

    def geometry_id(self, geometry: Geometry | str) -> int:
        """Return the id of a geometry, given by its handle or name; raise `SceneError` if it is not of this scene.

        Examples
        --------
        >>> import clbvh
        >>> ball = clbvh.Scene().add(clbvh.make_shape("icosphere", triangles=320))
        >>> clbvh.Scene().geometry_id(ball)
        Traceback (most recent call last):
        clbvh.errors.SceneError: Geometry(0, 'icosphere', ...) belongs to another scene: add its shape to this one
        """
        if isinstance(geometry, str):
            return self.find_geometry(geometry).id
        if not isinstance(geometry, Geometry):
            raise SceneError(f"expected a geometry that Scene.add returned, or its name, not {shorten(geometry)}")
        if geometry.owner is not self._owner:
            raise SceneError(f"{geometry!r} belongs to another scene: add its shape to this one")
        return geometry.id

    def instance_ids(self, instances: Instances) -> NDArray[np.int64]:
        """Return the ids of instances, (n,) int64.

        Parameters
        ----------
        instances : Instance, int or str, or a sequence of them
            Given by handle, id or name. The tuple `Scene.instances` itself takes no time, nor does an array of ids.

        Raises
        ------
        SceneError
            One is not an instance of this scene: the message names a few that are.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320))
        >>> scene.instance_ids("icosphere"), scene.instance_ids([scene.instances[0], 0])
        (array([0]), array([0, 0]))
        """
        mine = self.instances
        if instances is mine:
            return np.arange(len(mine))
        if isinstance(instances, Instance | int | np.integer | str):
            instances = (instances,)
        if isinstance(instances, np.ndarray) and instances.dtype.kind in "iu" and instances.ndim == 1:
            ids = instances
        else:
            try:
                handles = list(instances)
            except TypeError:
                raise SceneError(f"expected instances that Scene.place returned, not {shorten(instances)}") from None
            ids = np.array([self._instance_id(instance) for instance in handles], object)  # integers of any size
        wrong = (ids < 0) | (ids >= len(mine))
        if wrong.any():
            raise SceneError(f"there is no instance {ids[wrong][0]}: the scene has {len(mine):,} (from 0)")
        return ids.astype(np.int64)

    def _instance_id(self, instance: Instance | int | str) -> int:
        if isinstance(instance, str):
            return self.find(instance).id
        if isinstance(instance, Integral) and not isinstance(instance, bool):
            return int(instance)
        if not isinstance(instance, Instance):
            raise SceneError(f"expected an instance that Scene.place returned, not {shorten(instance)}")
        if instance.geometry.owner is not self._owner:
            raise SceneError(f"{instance!r} belongs to another scene")
        return instance.id

    def _move(self, state: SceneState, instances: Instances, transforms: ArrayLike) -> SceneState:
        """Return a state of this scene with other transforms of some instances; see `Tracer.set_transforms`."""
        ids, array = self.instance_ids(instances), np.asarray(transforms)
        matrices = check_transforms(array[None] if array.shape == (4, 4) else array)
        if len(matrices) != len(ids):
            raise SceneError(f"{len(ids):,} instances need as many transforms, not {len(matrices):,}")
        return state.with_transforms(state.check_ids(ids), matrices)

    def _mask(self, state: SceneState, instances: Instances, masks: ArrayLike) -> SceneState:
        """Return a state of this scene with other masks of some instances; see `Tracer.set_masks`."""
        ids, changed = state.check_ids(self.instance_ids(instances)), state.masks.copy()
        changed[ids] = check_masks(masks, len(ids))
        return replace(state, masks=changed)

    def __repr__(self) -> str:
        geometries, instances = self._list_handles()
        names: dict[int, list[str]] = {geometry.id: [] for geometry in geometries}
        for instance in instances:
            names[instance.geometry.id].append(instance.name)
        lines = [_show_object(geometry, names[geometry.id]) for geometry in geometries[:_MOST_SHOWN]]
        if len(geometries) > _MOST_SHOWN:
            lines.append(f"and {len(geometries) - _MOST_SHOWN:,} more")
        return "\n  ".join((f"Scene(geometries={len(geometries):,}, instances={len(instances):,})", *lines))


# Geometries that a scene shows, and the names of the instances of each.
_MOST_SHOWN, _MOST_NAMES = 8, 3


def _show_object(geometry: Geometry, names: list[str]) -> str:
    """Return a geometry and the names of its instances, in a line for `repr`."""
    count, prim = geometry.shape.prim_count, geometry.shape.kind.prim
    placed = f"placed as {', '.join(map(repr, names[:_MOST_NAMES]))}" if names else "not placed"
    more = f" and {len(names) - _MOST_NAMES:,} more" if len(names) > _MOST_NAMES else ""
    return f"{geometry.name!r}: {count:,} {prim}{'s'[: count - 1]}, {placed}{more}"
