"""The state of a scene at one moment, from which a tracer works. Immutable; knows no handles."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError
from ..geometry.appearance.material import Material
from ..geometry.mesh import Mesh
from ..geometry.spheres import Shape, with_material
from .handles import ALL_BITS

# The first array in the file of a saved scene, which tells it from other files: see `serialize.py`.
SAVED_SCENE = "clbvh_scene"


@dataclass(frozen=True, eq=False)
class SceneState:
    """The geometries of a scene and their instances; arrays are read-only.

    Attributes
    ----------
    shapes : tuple of Mesh or Spheres
        The geometries' shapes, by geometry id.
    names : tuple of str
        Names of the geometries.
    geometry_ids : (n,) int32
        The geometry of each instance.
    transforms : (n, 4, 4) float64
        Transform of each instance, from its geometry's coordinates to the scene's.
    masks : (n,) uint32
    instance_names : tuple of str
    colours : (n, 3) float64
        Linear colour of each instance in pictures; NaN where it has none of its own.
    materials : tuple of Material
        Materials that instances have of their own.
    material_ids : (n,) int32
        The material of each instance, -1 where it has that of its geometry.

    Examples
    --------
    >>> import clbvh
    >>> state = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320)).snapshot()
    >>> state.names, state.instance_names, state.transforms.shape
    (('icosphere',), ('icosphere',), (1, 4, 4))
    """

    shapes: tuple[Shape, ...]
    names: tuple[str, ...]
    geometry_ids: NDArray[np.int32]
    transforms: NDArray[np.float64]
    masks: NDArray[np.uint32]
    instance_names: tuple[str, ...]
    colours: NDArray[np.float64]
    materials: tuple[Material, ...]
    material_ids: NDArray[np.int32]

    def __post_init__(self) -> None:
        for array in (self.geometry_ids, self.transforms, self.masks, self.colours, self.material_ids):
            array.flags.writeable = False

    def __reduce__(self) -> tuple[Any, ...]:
        # Through the constructor, because pickled arrays forget that they are read-only.
        return SceneState, tuple(getattr(self, field.name) for field in dataclasses.fields(self))

    @property
    def geometry_count(self) -> int:
        """Number of geometries, also of those that no instance places."""
        return len(self.shapes)

    @property
    def instance_count(self) -> int:
        """Number of instances."""
        return len(self.geometry_ids)

    @property
    def placed_prim_count(self) -> int:
        """Primitives of all instances."""
        counts = np.array([shape.prim_count for shape in self.shapes], np.int64)
        return int(counts[self.geometry_ids].sum())

    def _describe(self) -> str:
        """Return the counts of the objects, for a `repr`."""
        if isinstance(self.lone_shape, Mesh):
            return f"triangles={self.lone_shape.face_count:,}"
        return f"instances={self.instance_count:,}, primitives={self.placed_prim_count:,}"

    def material_of(self, instance_id: int) -> Material | None:
        """Return the material that an instance has of its own.

        Examples
        --------
        >>> import clbvh
        >>> clbvh.Scene(clbvh.make_shape("icosphere", triangles=320)).snapshot().material_of(0) is None
        True
        """
        number = int(self.material_ids[instance_id])
        return None if number < 0 else self.materials[number]

    @property
    def lone_shape(self) -> Shape | None:
        """The only shape that is placed, if it is in the scene's own coordinates and visible to all rays."""
        if self.instance_count != 1 or self.masks[0] != ALL_BITS or (self.transforms[0] != np.eye(4)).any():
            return None
        return self.shapes[self.geometry_ids[0]]

    def check_ids(self, instance_ids: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return ids of the scene; raise `SceneError` unless their instances were there at this moment.

        Examples
        --------
        >>> import clbvh
        >>> import numpy as np
        >>> clbvh.Scene(clbvh.make_shape("icosphere", triangles=320)).snapshot().check_ids(np.array([0]))
        array([0])
        """
        if len(instance_ids) and (newest := int(instance_ids.max())) >= self.instance_count:
            raise SceneError(f"instance {newest} was placed after the tracer or renderer was opened: open a new one")
        return instance_ids

    def with_transforms(self, instance_ids: ArrayLike, transforms: ArrayLike) -> SceneState:
        """Return the state with other transforms of some instances: (k,) valid ids, (k, 4, 4) valid matrices.

        Examples
        --------
        >>> import clbvh
        >>> state = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320)).snapshot()
        >>> state.with_transforms([0], [clbvh.Transform(translate=(0, 0, 5)).matrix]).transforms[0, :3, 3]
        array([0., 0., 5.])
        """
        moved = self.transforms.copy()
        moved[np.asarray(instance_ids, np.int64)] = transforms
        return dataclasses.replace(self, transforms=moved)

    def with_shape(self, geometry_id: int, shape: Shape) -> SceneState:
        """Return the state with another shape of one geometry.

        Examples
        --------
        >>> import clbvh
        >>> state = clbvh.Scene(clbvh.make_shape("icosphere", triangles=320)).snapshot()
        >>> state.with_shape(0, clbvh.make_shape("knot", triangles=1000)).shapes
        (Mesh('knot', vertices=497, faces=994),)
        """
        return dataclasses.replace(self, shapes=(*self.shapes[:geometry_id], shape, *self.shapes[geometry_id + 1 :]))


def dress_shapes(state: SceneState) -> tuple[tuple[Shape, ...], NDArray[np.integer]]:
    """Return shapes with their materials, and the shape of each instance.

    Returns
    -------
    shapes : tuple of Mesh or Spheres
        The geometries, by their ids; then one for each pair of a geometry and a material that instances have of their
        own. It shares the arrays of its geometry.
    shape_ids : (n,) int

    Examples
    --------
    >>> import clbvh
    >>> from clbvh.scene.state import dress_shapes
    >>> scene = clbvh.Scene()
    >>> ball = scene.add(clbvh.make_shape("icosphere", triangles=320))
    >>> plain, golden = scene.place(ball), scene.place(ball, material=clbvh.Material(metallic=1.0))
    >>> shapes, shape_ids = dress_shapes(scene.snapshot())
    >>> len(shapes), shape_ids
    (2, array([0, 1]))
    """
    shape_ids = state.geometry_ids.astype(np.int64)
    own = np.flatnonzero(state.material_ids >= 0)
    if len(own) == 0:
        return state.shapes, shape_ids
    pairs = np.stack((state.geometry_ids[own], state.material_ids[own]), axis=1)
    chosen, numbers = np.unique(pairs, axis=0, return_inverse=True)
    shape_ids[own] = len(state.shapes) + numbers.reshape(-1)
    dressed = (
        with_material(state.shapes[geometry], state.materials[material]) for geometry, material in chosen.tolist()
    )
    return (*state.shapes, *dressed), shape_ids
