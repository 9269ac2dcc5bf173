"""Where each instance of a world is, and how far the device may see a ray of it from where the ray is.

Everything is in float64, and in a unit of about the instance's size around its centre: so neither a world's unit nor
its distance from zero costs a digit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...geometry.spheres import Shape
from ...scene.state import SceneState

# Rotations, mirrors and uniform scales in float64 stretch all directions alike, but for this.
_SIMILAR = 2.0**-40

# Which side of a box each of its corners has, along each axis.
_CORNERS = np.indices((2, 2, 2)).reshape(3, -1).T == 1

# The boxes of shapes are rounded to float32.
_ROOM = 1.0 + 2.0**-20


class Tolerance(NamedTuple):
    """How far the device may be off; the bound that the oracle grants it.

    Attributes
    ----------
    entering : float
        Of a ray or a point inside an instance, as a share of its reach: the radius of the instance plus the distance
        from which it is seen. The map to local coordinates rounds each coordinate about four times, and the tests of
        primitives about six; 16 times 2^-24 is granted for all.
    pair : float
        Of a position in the world, as a share of its distance from the instance and of the size of the world: a pair of
        float32 has 48 bits.
    near : float
        A ray that starts farther away than this many radii of the instance is advanced to before it: 32 half diagonals
        of its box, along one axis.
    order : float
        Of t, where hits of different instances are compared, and where t is compared with limits, as a share of t or of
        the size of the world: t is a float32 there.
    """

    entering: float = 2.0**-20
    pair: float = 2.0**-44
    near: float = 64.0
    order: float = 2.0**-22


# What loops know of an instance: `view_t` of cl/host/check/oracle.cl.
_VIEW = np.dtype(
    [
        *((name, "i8") for name in ("instance_id", "geometry_id", "mask")), ("unit", "f8"), ("centre", "f8", 3),
        *((name, "f8") for name in ("radius", "growth", "local_growth", *Tolerance._fields, "world_radius")),
    ]
)  # fmt: skip


class Instance(NamedTuple):
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

    def view(self, tolerance: Tolerance, size: float) -> NDArray[np.float64]:
        """Return the numbers of the instance as loops take them, with the tolerance and the radius of the world."""
        numbers = np.zeros(1, _VIEW)
        for name in ("instance_id", "geometry_id", "mask", "unit", "centre", "radius", "growth", "local_growth"):
            numbers[name] = getattr(self, name)
        for name, value in tolerance._asdict().items():
            numbers[name] = value
        numbers["world_radius"] = size
        return numbers.view(np.float64)


def find_instances(world: SceneState) -> list[Instance]:
    """Return all instances, in the order of their ids."""
    geometry_ids = np.asarray(world.geometry_ids, np.int64)
    transforms = np.asarray(world.transforms, np.float64).reshape(-1, 4, 4)
    if len(transforms) == 0:
        return []
    linear, scales = transforms[:, :3, :3], np.array([shape.scale for shape in world.shapes])[geometry_ids]
    origins = np.array([shape.origin for shape in world.shapes])[geometry_ids]
    centres = np.einsum("nij,nj->ni", linear, origins) + transforms[:, :3, 3]

    # A power of two first, so that squares stay within float64.
    sizes = np.ldexp(1.0, np.frexp(np.abs(linear).max(axis=(1, 2)) / scales)[1])
    local_to_world = linear / scales[:, None, None] / sizes[:, None, None]
    radii = _find_radii(world, geometry_ids, local_to_world)
    exponents = np.where(radii > 0.0, np.frexp(radii)[1], 0)
    units = sizes * np.ldexp(1.0, exponents)
    to_world = local_to_world / np.ldexp(1.0, exponents)[:, None, None]
    to_local = np.linalg.inv(to_world)
    growths = (np.abs(to_world) @ np.abs(to_local)).sum(axis=2).max(axis=1)
    local_growths = np.abs(to_local).sum(axis=2).max(axis=1)
    radii = np.ldexp(radii, -exponents)
    return [
        Instance(
            index, geometry_id, int(world.masks[index]), world.shapes[geometry_id], float(units[index]), centres[index],
            to_world[index], to_local[index], float(radii[index]), float(growths[index]), float(local_growths[index]),
        )
        for index, geometry_id in enumerate(geometry_ids.tolist())
    ]  # fmt: skip


def _find_radii(
    world: SceneState, geometry_ids: NDArray[np.int64], local_to_world: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return (n,) float64: the distance of the farthest corner of each instance's box from local zero."""
    boxes = np.array([shape.local_box for shape in world.shapes], np.float64)
    corners = np.where(_CORNERS, boxes[:, None, 1], boxes[:, None, 0])
    placed = np.einsum("nij,ncj->nci", local_to_world, corners[geometry_ids])
    radii = np.linalg.norm(placed, axis=2).max(axis=1)
    # Where all directions are stretched alike, the same for all instances.
    stretches = np.linalg.svd(local_to_world, compute_uv=False)
    is_similar = stretches[:, 0] - stretches[:, 2] <= _SIMILAR * stretches[:, 0]
    farthest = np.linalg.norm(corners, axis=2).max(axis=1)[geometry_ids]
    return np.where(is_similar, stretches[:, 0] * farthest, radii) * _ROOM


def world_radius(instances: list[Instance]) -> float:
    """Return half the diagonal of the box around the bounding spheres of all instances, in the world's unit."""
    if not instances:
        return 0.0
    lower = np.min([each.centre - each.radius * each.unit for each in instances], axis=0)
    upper = np.max([each.centre + each.radius * each.unit for each in instances], axis=0)
    return float(np.linalg.norm(upper / 2 - lower / 2))
