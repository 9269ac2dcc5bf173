"""A galaxy of spheres: a bulge, a disk, and spiral arms."""

from __future__ import annotations

import numpy as np

from ...errors import ConfigError
from .sphere_set import SphereSet

# Shares of the spheres outside the bulge; the rest of them is in the arms.
_DISK, _HALO = 0.27, 0.025

# In disk radii: the mean distance of the bulge's spheres, the scale length of the disk, and the radius of the halo.
_BULGE_SIZE, _DISK_LENGTH, _HALO_SIZE = 0.07, 0.28, 1.1

_ARM_WIDTH = 0.055  # standard deviation across an arm at the rim, in disk radii
_SIZE_SPREAD = 0.45  # standard deviation of the logarithm of a radius
_INNERMOST = 0.08  # where the arms begin, in disk radii

_MOST_ARMS = 100


def make_galaxy(
    count: int,
    generator: np.random.Generator,
    *,
    arms: float = 2,
    winding: float = 2.6,
    radius: float = 10.0,
    thickness: float = 0.03,
    bulge: float = 0.18,
    size: float = 1.0,
) -> SphereSet:
    """Return the spheres; `make_spheres` describes the options."""
    if arms != int(arms) or not 1 <= arms <= _MOST_ARMS:
        raise ConfigError(f"the option 'arms' of the spheres 'galaxy' must be 1 to {_MOST_ARMS}, not {arms!r}")
    if bulge > 1:
        raise ConfigError(f"the option 'bulge' of the spheres 'galaxy' must be at most 1, not {bulge!r}")
    # All numbers of a sphere are drawn whatever part it is in, so that its part does not shift the draws of the others.
    part, along, around, which = generator.random((4, count))
    sideways = generator.normal(size=(3, count))
    sizes = np.exp(_SIZE_SPREAD * generator.normal(size=count))

    # A disk whose density falls off exponentially has radii of a gamma distribution, cut off here at its rim.
    disk = np.minimum(-_DISK_LENGTH * (np.log1p(-along) + np.log1p(-which * 0.999)), 1.2)
    # The arms are logarithmic spirals, brighter inside.
    arm = _INNERMOST + (1 - _INNERMOST) * along**1.3
    is_bulge = part < bulge
    disk_end, halo_end = (bulge + (1 - bulge) * share for share in (_DISK, _DISK + _HALO))
    is_disk = ~is_bulge & (part < disk_end)
    is_halo = (part >= disk_end) & (part < halo_end)
    is_arm = ~(is_bulge | is_disk | is_halo)

    distance = np.where(is_arm, arm, disk)
    angle = np.where(
        is_arm,
        np.log(arm / _INNERMOST) * winding + np.floor(which * arms) * (2 * np.pi / arms),
        around * 2 * np.pi,
    )
    spread = np.where(is_arm, _ARM_WIDTH * (0.35 + distance), 0.0)
    centres = np.empty((count, 3))
    centres[:, 0] = distance * np.cos(angle) + spread * sideways[0]
    centres[:, 1] = thickness * sideways[1]
    centres[:, 2] = distance * np.sin(angle) + spread * sideways[2]
    centres[is_bulge] = _BULGE_SIZE * sideways.T[is_bulge] * [1, 0.75, 1]
    direction = sideways.T[is_halo] / np.maximum(np.linalg.norm(sideways.T[is_halo], axis=1), 1e-9)[:, None]
    centres[is_halo] = _HALO_SIZE * np.cbrt(along[is_halo])[:, None] * direction
    # The more spheres, the smaller: together they cover about as much.
    radii = size * radius * 0.35 / np.sqrt(max(count, 1)) * sizes
    return SphereSet(centres * radius, radii)
