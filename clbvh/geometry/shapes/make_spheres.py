"""Procedural spheres: the same name, count and seed give the same spheres, and no file is needed.

`weekend` is the last scene of Peter Shirley's "Ray Tracing in One Weekend": a field of small spheres around three large
ones. `galaxy` has a bulge, a disk, and spiral arms.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError
from ...support.memory import check_memory
from ..appearance.material import Material
from ..mesh import MAX_FACE_COUNT
from ..spheres import Spheres
from .make_shape import check_options, check_whole, list_options

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
) -> Spheres:
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
    return Spheres(centres * radius, radii, name="galaxy")


# The ground is a sphere so large that it looks flat: this radius, or this many sides of the field.
_GROUND_RADIUS, _GROUND_SIDES = 1000.0, 4.0

_LARGE_RADIUS, _SMALL_RADIUS = 1.0, 0.2
_LARGE_X = (0.0, -4.0, 4.0)

# How far a small sphere moves within its cell of side 1. Two of them in neighbouring cells never touch.
_SHIFT = 0.55
_GAP = 0.02  # between a small sphere and a large one, at least

# Shares of the small spheres: the rest is glass.
_DIFFUSE, _METAL = 0.80, 0.15
_LEAST_METAL, _MOST_ROUGHNESS = 0.5, 0.5

# Small spheres beyond this number have the materials of others.
_MOST_MATERIALS = 1000


def make_weekend(count: int, generator: np.random.Generator) -> Spheres:
    """Return the ground, three large spheres, and as many small ones as are left of `count`."""
    small_count = max(count - 1 - len(_LARGE_X), 0)
    x, z = _scatter(small_count, generator)
    side = 2 * max(np.max(np.abs(x), initial=0.0), np.max(np.abs(z), initial=0.0))
    ground_radius = max(_GROUND_RADIUS, _GROUND_SIDES * side)
    radii = np.concatenate(
        ([ground_radius], np.full(len(_LARGE_X), _LARGE_RADIUS), np.full(small_count, _SMALL_RADIUS))
    )
    centres = np.zeros((len(radii), 3))
    centres[:, 0] = np.concatenate(([0.0], _LARGE_X, x))
    centres[1 + len(_LARGE_X) :, 2] = z
    # Every sphere touches the ground: farther from the middle, lower.
    distance_squared = centres[1:, 0] ** 2 + centres[1:, 2] ** 2
    centres[1:, 1] = np.sqrt((ground_radius + radii[1:]) ** 2 - distance_squared) - ground_radius
    centres[0, 1] = -ground_radius
    materials = (*_LARGE_MATERIALS, *_draw_materials(min(small_count, _MOST_MATERIALS), generator))
    is_large = np.arange(len(radii)) < len(_LARGE_MATERIALS)
    numbers = np.arange(len(radii)) - len(_LARGE_MATERIALS)
    ids = np.where(is_large, np.arange(len(radii)), len(_LARGE_MATERIALS) + numbers % _MOST_MATERIALS)
    return Spheres(centres[:count], radii[:count], name="weekend", materials=materials, material_ids=ids[:count])


def _scatter(count: int, generator: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return x and z of small spheres: one in each cell of a grid, from its middle outwards."""
    # Each large sphere keeps a few cells free.
    half = math.ceil((math.sqrt(count + 9 * len(_LARGE_X)) + 1) / 2)
    cells = np.arange(-half, half)
    column, row = (grid.reshape(-1) for grid in np.meshgrid(cells, cells))
    # The larger side of the square around the middle, then row by row.
    ring = np.maximum(np.maximum(column, -1 - column), np.maximum(row, -1 - row))
    order = np.argsort(ring, kind="stable")
    shift = _SHIFT * generator.random((2, len(order)))
    x, z = column[order] + shift[0], row[order] + shift[1]
    # Two spheres on a plane touch where their centres are twice the root of the product of their radii apart.
    least = 2 * math.sqrt(_LARGE_RADIUS * _SMALL_RADIUS) + _GAP
    is_free = np.all([np.hypot(x - large, z) >= least for large in _LARGE_X], axis=0)
    return x[is_free][:count], z[is_free][:count]


def _draw_materials(count: int, generator: np.random.Generator) -> list[Material]:
    """Return materials of small spheres."""
    kinds, roughness = generator.random((2, count))
    first, second = generator.random((2, count, 3))
    materials = []
    for number, kind in enumerate(kinds):
        if kind < _DIFFUSE:
            colour = first[number] * second[number]
            materials.append(_make_chalk(tuple(colour.tolist())))
        elif kind < _DIFFUSE + _METAL:
            colour = _LEAST_METAL + (1 - _LEAST_METAL) * first[number]
            rough = float(_MOST_ROUGHNESS * roughness[number])
            materials.append(Material(base_colour=tuple(colour.tolist()), metallic=1.0, roughness=rough))
        else:
            materials.append(_GLASS)
    return materials


def _make_chalk(colour: tuple[float, float, float], name: str = "") -> Material:
    """Return a surface without a highlight: all light that it reflects is scattered."""
    return Material(name, base_colour=colour, roughness=1.0, ior=1.0)


_GLASS = Material("glass", base_colour=(1.0, 1.0, 1.0), roughness=0.0, transmission=1.0)
_LARGE_MATERIALS = (
    _make_chalk((0.5, 0.5, 0.5), "ground"),
    _GLASS,
    _make_chalk((0.4, 0.2, 0.1), "brown"),
    Material("metal", base_colour=(0.7, 0.6, 0.5), metallic=1.0, roughness=0.0),
)


SPHERE_SETS: dict[str, Callable[..., Spheres]] = {"galaxy": make_galaxy, "weekend": make_weekend}

# While the spheres are made: their random numbers, and twice their centres and radii.
_BYTES_PER_SPHERE = 300


def make_spheres(name: str, *, count: int, seed: int = 0, **options: float) -> Spheres:
    """Make procedural spheres.

    Parameters
    ----------
    name : str
        One of `SPHERE_SETS`.
    count : int
        From 1.
    seed : int, optional
        From 0; another seed gives another set of the same kind.
    **options : float
        Of the set, with these defaults:

        - `galaxy`: a spiral galaxy in the plane of x and z: ``arms=2`` with ``winding=2.6`` radians for each factor of
          e in distance, ``radius=10`` of the disk, ``thickness=0.03`` of it in radii, ``bulge=0.18``, the share of the
          spheres in the middle; ``size=1`` scales the spheres, which are the smaller the more there are.
        - `weekend`: a ground, three large spheres of glass, chalk and metal, and around them small ones of all three,
          none of which touches another; without options. With 480 spheres about the last scene of Peter Shirley's book
          "Ray Tracing in One Weekend".

    Returns
    -------
    Spheres
        Named after the set; a galaxy has no materials.

    Raises
    ------
    ConfigError
        No such set or option, a value outside its range, or more spheres than fit the memory.
    MeshError
        The options are so large that a coordinate is not finite.

    Examples
    --------
    >>> from clbvh.geometry.shapes.make_spheres import make_spheres
    >>> make_spheres("galaxy", count=1000, seed=4)
    Spheres('galaxy', count=1,000)
    """
    check_options(f"set of spheres '{name}'", list_options("are no spheres", SPHERE_SETS, name), options)
    check_whole(count=(count, 1), seed=(seed, 0))
    if count > MAX_FACE_COUNT:
        raise ConfigError(f"{count:,} spheres are too many: the limit is {MAX_FACE_COUNT:,}")
    check_memory(f"{count:,} spheres", int(count) * _BYTES_PER_SPHERE, ConfigError)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused by the spheres
        return SPHERE_SETS[name](int(count), np.random.default_rng(int(seed)), **options)
