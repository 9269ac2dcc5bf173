"""The content of a scene as users see it: geometries are added, placed by transforms, and found by id or name.

Owns the kinds of sources. Must not know of trees, devices, cameras and pictures.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from numbers import Integral
from typing import Any, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError
from ..geometry.appearance.material import Material
from ..geometry.as_mesh import MeshLike, as_mesh
from ..geometry.spheres import Shape, Spheres
from .handles import ALL_BITS, Geometry, Instance, check_colour, check_mask, check_material, shorten
from .parts import HasGraph, Parts, parts_of_file, parts_of_graph, parts_of_state
from .state import SceneState
from .store import SceneStore, name_of_file
from .transforms import check_transform, check_transforms


class SceneContents:
    """Geometries and their instances. `clbvh.Scene` adds the settings of a picture to it."""

    def __init__(self) -> None:
        self._store = SceneStore()

    @overload
    def add(self, source: Shape | MeshLike, *, name: str | None = None) -> Geometry: ...

    @overload
    def add(self, source: HasGraph | SceneContents, *, name: str | None = None) -> tuple[Instance, ...]: ...

    def add(
        self, source: Shape | MeshLike | HasGraph | SceneContents, *, name: str | None = None
    ) -> Geometry | tuple[Instance, ...]:
        """Add a geometry, which is seen by no ray until it is placed.

        Parameters
        ----------
        source : Mesh, Spheres, trimesh.Trimesh, str, path, (vertices, faces), trimesh.Scene or Scene
            A mesh in any form, or spheres. A file of several parts becomes one geometry, as `load_mesh` reads it;
            `add_scene` keeps the parts. A scene has places for its parts already, so it is handed to `add_scene`.
        name : str, optional
            Unique among the geometries of the scene. By default that of the source, with a number where it is taken:
            ``"bunny"``, ``"bunny 2"``. Not for a scene, which has names.

        Returns
        -------
        Geometry
            For `place`. Of a scene, the tuple of instances that `add_scene` returns.

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
        if isinstance(source, SceneContents | HasGraph):
            if name is not None:
                raise SceneError(f"a scene has names for its parts, so it cannot be given the name {shorten(name)}")
            return self.add_scene(source)
        if isinstance(source, Geometry):
            raise SceneError(f"{source!r} is in a scene already: place it again, or add its shape to another scene")
        kinds = "clbvh.Spheres, a trimesh.Scene, a clbvh.Scene"
        shape = source if isinstance(source, Spheres) else as_mesh(source, or_else=kinds)
        wish = name_of_file(shape.name) if isinstance(source, str | os.PathLike) else shape.name
        return self._store.add(shape, name, wish)

    def add_scene(
        self,
        source: str | os.PathLike[str] | HasGraph | SceneContents,
        transform: ArrayLike | None = None,
        *,
        mask: int | None = None,
    ) -> tuple[Instance, ...]:
        """Add the parts of a file or of a scene, and place them where they are in it: all of them or none.

        Parameters
        ----------
        source : str, path, trimesh.Scene or Scene
            Of a GLB or glTF file, each mesh becomes a geometry, and each node that has it an instance; of an OBJ file,
            each object (`o`), or each group (`g`) if no object is named. Other mesh files are one part. Of a
            `trimesh.Scene`, the triangle meshes that nodes place. Names are kept, with a number where they are taken.
        transform : (4, 4) float, or Transform, optional
            Moves the whole; the identity if left out.
        mask : int, 0 to 2^32 - 1
            Of all instances. By default all bits, or those of the other `Scene`.

        Returns
        -------
        tuple of Instance
            In the order of the nodes; each has its `geometry`.

        Raises
        ------
        MeshError
            The file or a mesh cannot be used.
        SceneError
            Nothing is placed in the source, or a transform is singular, as of a node that is scaled to nothing. The
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
        >>> scene.add_scene(cart)
        (Instance(0, 'body', of='box'), Instance(1, 'left', of='wheel'), Instance(2, 'right', of='wheel'))
        """
        outer = check_transform(transform)
        common_mask = None if mask is None else check_mask(mask)
        parts = _find_parts(source)
        with np.errstate(over="ignore", invalid="ignore"):  # refused if it is not finite
            matrices = [
                check_transform(
                    part.matrix if transform is None else outer @ part.matrix, f"the transform of {shorten(part.name)}"
                )
                for part in parts.placed
            ]
        with self._store.lock:
            geometries = [self._store.add(shape, None, name) for shape, name in parts.shapes]
            return tuple(
                instance
                for part, matrix in zip(parts.placed, matrices, strict=True)
                for instance in self._store.place(
                    geometries[part.shape],
                    matrix[None],
                    None,
                    part.name,
                    part.mask if common_mask is None else common_mask,
                    part.colour,
                    part.material,
                )
            )

    def place(
        self,
        geometry: Geometry,
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
        geometry : Geometry
            Of this scene.
        transform : (4, 4) float, or Transform, optional
            From the geometry's coordinates to the scene's: rotation, scale of any kind, shear, mirror, translation.
            The identity if left out.
        name : str, optional
            Unique among the instances of the scene. By default that of the geometry, with a number where it is taken.
        mask : int, 0 to 2^32 - 1
            A ray sees the instance if its own mask shares a bit with this one. All bits by default.
        colour : (3,) float, optional
            Linear red, green and blue in pictures, 0 to 1; by default that of all surfaces, `Scene.surface`.
        material : Material, optional
            Of all primitives of this instance, instead of the materials and colours of the geometry. Its tree is
            shared whatever the material.

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
        self.geometry_id(geometry)
        matrix = check_transform(transform)
        names = None if name is None else (name,)
        look = check_colour(colour), check_material(material)
        return self._store.place(geometry, matrix[None], names, geometry.name, check_mask(mask), *look)[0]

    def place_many(
        self,
        geometry: Geometry,
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
        geometry : Geometry
            Of this scene.
        transforms : (n, 4, 4) float
        names : sequence of str, optional
            One for each.
        mask : int, 0 to 2^32 - 1
        colour : (3,) float, optional
            Of all of them.
        material : Material, optional
            Of all of them.

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
        self.geometry_id(geometry)
        matrices = check_transforms(transforms)
        if isinstance(names, str) or (names is not None and len(names) != len(matrices)):
            raise SceneError(f"{len(matrices):,} transforms need as many names, or none, not {shorten(names)}")
        look = check_colour(colour), check_material(material)
        return self._store.place(geometry, matrices, names, geometry.name, check_mask(mask), *look)

    @property
    def geometries(self) -> tuple[Geometry, ...]:
        """All geometries; the index is the id."""
        return self._store.handles()[0]

    @property
    def instances(self) -> tuple[Instance, ...]:
        """All instances; the index is the id."""
        return self._store.handles()[1]

    @property
    def is_empty(self) -> bool:
        """Whether nothing is placed, so that no ray hits anything."""
        return not self._store.has_instances

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
        found = self._store.find_instance(name)
        if found is None:
            raise SceneError(_say_unknown("instance", name, [instance.name for instance in self.instances]))
        return found

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
        found = self._store.find_geometry(name)
        if found is None:
            raise SceneError(_say_unknown("geometry", name, [geometry.name for geometry in self.geometries]))
        return found

    def snapshot(self) -> SceneState:
        """Return what the scene holds now. It is immutable, and the same object until something is added.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320))
        >>> scene.snapshot().geometry_ids
        array([0], dtype=int32)
        """
        return self._store.snapshot()

    def geometry_id(self, geometry: Geometry) -> int:
        """Return the id of a geometry; raise `SceneError` unless it is one of this scene.

        Examples
        --------
        >>> import clbvh
        >>> ball = clbvh.Scene().add(clbvh.make_shape("icosphere", triangles=320))
        >>> clbvh.Scene().geometry_id(ball)
        Traceback (most recent call last):
        clbvh.errors.SceneError: Geometry(0, 'icosphere', ...) belongs to another scene: add its shape to this one
        """
        if not isinstance(geometry, Geometry):
            raise SceneError(f"expected a geometry that Scene.add returned, not {shorten(geometry)}")
        if geometry.owner is not self._store:
            raise SceneError(f"{geometry!r} belongs to another scene: add its shape to this one")
        return geometry.id

    def instance_ids(self, instances: Instance | int | Iterable[Instance | int]) -> NDArray[np.int64]:
        """Return the ids of instances, (n,) int64.

        Parameters
        ----------
        instances : Instance or int, or a sequence of instances or ids
            The tuple `Scene.instances` itself takes no time, nor does an array of ids.

        Raises
        ------
        SceneError
            One is not an instance of this scene.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320))
        >>> scene.instance_ids([scene.find("icosphere")])
        array([0])
        """
        mine = self.instances
        if instances is mine:
            return np.arange(len(mine))
        if isinstance(instances, Instance | int):
            instances = (instances,)
        if isinstance(instances, np.ndarray) and instances.dtype.kind in "iu" and instances.ndim == 1:
            ids = instances.astype(np.int64)
        else:
            try:
                given = list(instances)
            except TypeError:
                raise SceneError(f"expected instances that Scene.place returned, not {shorten(instances)}") from None
            ids = np.array([self._instance_id(instance) for instance in given], np.int64)
        wrong = (ids < 0) | (ids >= len(mine))
        if wrong.any():
            raise SceneError(f"there is no instance {ids[wrong][0]}: the scene has {len(mine):,} (from 0)")
        return ids

    def _instance_id(self, instance: Instance | int) -> int:
        if isinstance(instance, Integral) and not isinstance(instance, bool):
            number = int(instance)
            return number if abs(number) <= np.iinfo(np.int64).max else -1
        if not isinstance(instance, Instance):
            raise SceneError(f"expected an instance that Scene.place returned, not {shorten(instance)}")
        if instance.geometry.owner is not self._store:
            raise SceneError(f"{instance!r} belongs to another scene")
        return instance.id

    def __copy__(self) -> Self:
        """Return a scene of the same geometries and instances; what is added to either is not in the other."""
        copied = object.__new__(type(self))
        vars(copied).update(vars(self))
        vars(copied)["_store"] = self._store.copy()
        return copied


def _find_parts(source: Any) -> Parts:
    if isinstance(source, str | os.PathLike):
        return parts_of_file(source)
    if isinstance(source, SceneContents):
        return parts_of_state(source.snapshot())
    if isinstance(source, HasGraph):
        return parts_of_graph(source)
    raise SceneError(f"expected the path of a file, a trimesh.Scene or a clbvh.Scene, not {shorten(source)}")


def _say_unknown(kind: str, name: object, names: list[str]) -> str:
    known = ", ".join(map(shorten, names[:5])) + (", ..." if len(names) > 5 else "")
    return f"the scene has no {kind} {shorten(name)}; " + (f"it has {known}" if names else "it has none")
