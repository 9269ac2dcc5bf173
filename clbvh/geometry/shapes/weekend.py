"""A field of small spheres around three large ones: the last scene of Peter Shirley's "Ray Tracing in One Weekend"."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..appearance.material import Material
from .sphere_set import SphereSet

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


def make_weekend(count: int, generator: np.random.Generator) -> SphereSet:
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
    return SphereSet(centres[:count], radii[:count], materials, ids[:count].astype(np.int32))


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
