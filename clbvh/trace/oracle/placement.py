"""Where each instance of a scene is, and how far the device may see a ray of it from where the ray is.

Everything is in float64, and in a unit of about the instance's size around its centre: so neither a scene's unit nor
its distance from zero costs a digit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ...geometry.shape import Shape

# Rotations, mirrors and uniform scales in float64 stretch all directions alike, but for this.
_SIMILAR = 2.0**-40

# Which side of a box each of its corners has, along each axis.
_CORNERS = np.indices((2, 2, 2)).reshape(3, -1).T == 1

# The boxes of shapes are rounded to float32.
_ROOM = 1.0 + 2.0**-20


class SceneLike(Protocol):
    """The fields of a `SceneState` that the oracle reads."""

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """The shape of each geometry."""

    @property
    def geometry_ids(self) -> NDArray[np.int32]:
        """(n,) int32: the geometry of each instance."""

    @property
    def transforms(self) -> NDArray[np.float64]:
        """(n, 4, 4) float64: from a geometry's coordinates to the world's."""

    @property
    def masks(self) -> NDArray[np.uint32]:
        """(n,) uint32."""


@dataclass(frozen=True)
class Blur:
    """How far the device may be off; the bound that the oracle grants it.

    Attributes
    ----------
    entering : float
        Of a ray or a point inside an instance, as a share of its reach: the radius of the instance plus the distance
        from which it is seen. The map to local coordinates rounds each coordinate about four times, and the tests of
        primitives about six; 16 times 2^-24 is granted for all.
    pair : float
        Of a position in the world, as a share of its distance from the instance and of the size of the scene: a pair of
        float32 has 48 bits.
    near : float
        A ray that starts farther away than this many radii of the instance is advanced to before it: 32 half diagonals
        of its box, along one axis.
    order : float
        Of t, where hits of different instances are compared, and where t is compared with limits, as a share of t or of
        the size of the scene: t is a float32 there.
    """

    entering: float = 2.0**-20
    pair: float = 2.0**-44
    near: float = 64.0
    order: float = 2.0**-22


class Placement(NamedTuple):
    """An instance, in a unit of about its size around the zero of its geometry's local coordinates.

    Attributes
    ----------
    instance_id, geometry_id : int
    mask : int
    shape : Mesh or Spheres
    unit : float
        A power of two: the length of a unit in the world.
    centre : (3,) float64, world
        Where local zero is.
    to_world, to_local : (3, 3) float64
        Between local coordinates and the unit's.
    radius : float, units
        No primitive is farther from the centre.
    growth : float
        By how much the way into local coordinates and back can magnify the relative error of a coordinate: 1 to 3 for
        rotations, whatever the scale along the axes of the geometry, and more for a shear.
    local_growth : float
        The largest sum of a row of `to_local`, without signs: an error of a coordinate becomes this in local units.
    """

    instance_id: int
    geometry_id: int
    mask: int
    shape: Shape
    unit: float
    centre: NDArray[np.float64]
    to_world: NDArray[np.float64]
    to_local: NDArray[np.float64]
    radius: float
    growth: float
    local_growth: float

    def to_unit(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (n, 3) points of the world in units, seen from the centre."""
        return (points - self.centre) / self.unit

    def blurs(
        self, blur: Blur, origins: NDArray[np.float64], size: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return how far the device may see rays from where they are, in units, and in local units.

        Parameters
        ----------
        blur : Blur
        origins : (n, 3) float64, units, seen from the centre
        size : float, world units
            The radius of the scene.
        """
        distances = np.linalg.norm(origins, axis=1)
        reach = self.radius + np.minimum(distances, blur.near * self.radius)
        rounded = blur.pair * (distances + size / self.unit)
        entering = blur.entering * reach
        return self.growth * entering + rounded, self.local_growth * (entering + rounded)


def place_instances(scene: SceneLike) -> list[Placement]:
    """Return the placements of all instances, in the order of their ids."""
    farthest = [_radius(shape, np.eye(3)) for shape in scene.shapes]
    return [
        _place(index, int(geometry_id), int(mask), scene.shapes[geometry_id], transform, farthest[geometry_id])
        for index, (geometry_id, mask, transform) in enumerate(
            zip(scene.geometry_ids, scene.masks, np.asarray(scene.transforms, np.float64), strict=True)
        )
    ]


def _place(
    index: int, geometry_id: int, mask: int, shape: Shape, transform: NDArray[np.float64], farthest: float
) -> Placement:
    """Return the placement of an instance; `farthest` is the radius of its shape, in local units."""
    linear = transform[:3, :3]
    centre = linear @ shape.origin + transform[:3, 3]

    # A power of two first, so that squares stay within float64.
    size = 2.0 ** math.frexp(float(np.abs(linear).max()) / shape.scale)[1]
    local_to_world = linear / shape.scale / size
    stretches = np.linalg.svd(local_to_world, compute_uv=False)
    # Without a pass over the primitives where all directions are stretched alike.
    is_similar = stretches[0] - stretches[2] <= _SIMILAR * stretches[0]
    radius = float(stretches[0]) * farthest if is_similar else _radius(shape, local_to_world)
    exponent = math.frexp(radius)[1] if radius > 0.0 else 0
    unit = size * 2.0**exponent
    to_world = local_to_world / 2.0**exponent
    to_local = np.asarray(np.linalg.inv(to_world), np.float64)
    growth = float((np.abs(to_world) @ np.abs(to_local)).sum(axis=1).max())
    return Placement(
        index, geometry_id, mask, shape, unit, centre, to_world, to_local, radius / 2.0**exponent, growth,
        float(np.abs(to_local).sum(axis=1).max()),
    )  # fmt: skip


def _radius(shape: Shape, to_world: NDArray[np.float64]) -> float:
    """Return the distance of the farthest corner of the shape's box."""
    lower, upper = shape.local_box.astype(np.float64)
    corners = np.where(_CORNERS, upper, lower) @ to_world.T
    return float(np.linalg.norm(corners, axis=1).max()) * _ROOM


def scene_radius(placements: list[Placement]) -> float:
    """Return half the diagonal of the box around the bounding spheres of all instances, in the world's unit."""
    lower = np.min([placed.centre - placed.radius * placed.unit for placed in placements], axis=0)
    upper = np.max([placed.centre + placed.radius * placed.unit for placed in placements], axis=0)
    return float(np.linalg.norm(upper / 2 - lower / 2))
