"""Handles of the geometries and instances of a scene, and the checks of the arguments that place them.

Handles own nothing: the scene does.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from numbers import Integral
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError
from ..geometry.appearance.material import Material
from ..geometry.arrays import read_numbers
from ..geometry.spheres import Shape


@dataclass(frozen=True, eq=False, repr=False)
class Geometry:
    """A shape that a scene holds; `Scene.add` makes it, and `Scene.place` places it.

    Attributes
    ----------
    id : int
        Its number in the scene, from 0 in the order of adding: the `geometry_id` of hits.
    name : str
        Unique among the geometries of the scene.
    shape : Mesh or Spheres
        The shape, in the coordinates of its file.

    Examples
    --------
    >>> import clbvh
    >>> scene = clbvh.Scene()
    >>> ball = scene.add(clbvh.make_shape("icosphere", triangles=320))
    >>> ball
    Geometry(0, 'icosphere', Mesh('icosphere', vertices=162, faces=320))
    """

    id: int
    name: str
    shape: Shape
    owner: Any = field(repr=False)

    def __repr__(self) -> str:
        return f"Geometry({self.id}, {self.name!r}, {self.shape!r})"


# Bits of a mask. A ray sees the instances whose mask shares a bit with its own.
ALL_BITS = 2**32 - 1

Vector: TypeAlias = tuple[float, float, float]
"""Three numbers: a point or a direction."""

Colour: TypeAlias = tuple[float, float, float]
"""Linear red, green and blue, 0 to 1."""


@dataclass(frozen=True, eq=False, repr=False)
class Instance:
    """A geometry at a position in a scene; `Scene.place` makes it.

    Attributes
    ----------
    id : int
        Its number in the scene, from 0 in the order of placing: the `instance_id` of hits.
    name : str
        Unique among the instances of the scene.
    geometry : Geometry
    matrix : (4, 4) float64, read-only
        Transform from the geometry's coordinates to the scene's.
    mask : int, 0 to 2^32 - 1
        A ray sees the instance if its own mask shares a bit with this one.
    colour : (3,) float, or None
        Linear colour in pictures; None: `View.surface`.
    material : Material, or None
        Material of all its primitives; None: the materials of the geometry.

    Examples
    --------
    >>> import clbvh
    >>> scene = clbvh.Scene()
    >>> ball = scene.add(clbvh.make_shape("icosphere", triangles=320), name="ball")
    >>> left, right = scene.place(ball), scene.place(ball, clbvh.Transform(translate=(5, 0, 0)))
    >>> left
    Instance(0, 'ball', of='ball')
    >>> right.id, right.name, right.geometry is ball
    (1, 'ball 2', True)
    """

    id: int
    name: str
    geometry: Geometry
    matrix: NDArray[np.float64] = field(repr=False)
    mask: int
    colour: tuple[float, float, float] | None = None
    material: Material | None = None

    @property
    def transform(self) -> NDArray[np.float64]:
        """(4, 4) float64: from the geometry's coordinates to the scene's; a copy.

        Examples
        --------
        >>> import clbvh
        >>> scene = clbvh.Scene()
        >>> ball = scene.add(clbvh.make_shape("icosphere", triangles=320))
        >>> scene.place(ball, clbvh.Transform(translate=(5, 0, 0))).transform[:3, 3]
        array([5., 0., 0.])
        """
        return self.matrix.copy()

    def __repr__(self) -> str:
        return f"Instance({self.id}, {self.name!r}, of={self.geometry.name!r})"


Instances: TypeAlias = Instance | int | str | Iterable[Instance | int | str]
"""An instance of a scene, or several: each by its handle, its id or its name."""

# Handles that a tuple shows.
_MOST_SHOWN = 6

_MAX_SHOWN = 60  # characters of a wrong value in a message


def check_mask(mask: int) -> int:
    """Return the mask of instances; raise `SceneError` unless it is one."""
    if isinstance(mask, bool) or not isinstance(mask, Integral) or not 0 <= mask <= ALL_BITS:
        raise SceneError(f"a mask must be a whole number from 0 to 2^32 - 1, not {shorten(mask)}")
    return int(mask)


def check_masks(masks: ArrayLike, count: int) -> NDArray[np.uint32]:
    """Return the masks of instances, (count,) or one for all; raise `SceneError` unless they are masks."""
    array = read_numbers(masks, "the masks", SceneError)
    if array.shape not in ((), (count,)):
        raise SceneError(f"{count:,} instances need one mask or as many, not an array of shape {array.shape}")
    if array.size and (array.dtype.kind == "f" or array.min() < 0 or array.max() > ALL_BITS):
        raise SceneError(f"masks must be whole numbers from 0 to 2^32 - 1, not {shorten(masks)}")
    return array.astype(np.uint32)


def check_colour(colour: ArrayLike | None) -> Colour | None:
    """Return the colour of instances, if there is one; raise `SceneError` unless it is a colour."""
    expected = "a colour must be three finite numbers: linear red, green and blue"
    return None if colour is None else read_vector(colour, expected)


def read_vector(values: ArrayLike, expected: str) -> Vector:
    """Return three numbers; raise `SceneError` with the sentence about what was expected unless they are finite."""
    try:
        array = np.asarray(values)
    except ValueError:  # rows of different lengths
        array = np.empty(0)
    if array.shape != (3,) or array.dtype.kind not in "iuf" or not np.isfinite(array).all():
        raise SceneError(f"{expected}, not {shorten(values)}")
    return float(array[0]), float(array[1]), float(array[2])


def check_material(material: Any) -> Material | None:
    """Return the material of instances, if there is one; raise `SceneError` unless it is a material."""
    if material is not None and not isinstance(material, Material):
        raise SceneError(f"a material must be a clbvh.Material, not {shorten(material)}")
    return material


_Handle = TypeVar("_Handle", Geometry, Instance)


class Handles(tuple[_Handle, ...]):
    """A tuple of handles, of which a notebook shows a few."""

    def __repr__(self) -> str:
        if len(self) <= _MOST_SHOWN:
            return super().__repr__()
        first = ", ".join(map(repr, self[: _MOST_SHOWN - 1]))
        return f"({first}, ..., {self[-1]!r}: {len(self):,} in all)"


def shorten(value: object) -> str:
    """Return a wrong value as a message quotes it."""
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}..."
