"""A closed tube along a torus knot, covered with a braid."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError
from .noise import fractal_noise
from .solids import Solid, cut_quads, require_triangles


def make_knot(
    triangles: int,
    generator: np.random.Generator,
    *,
    turns: float = 2,
    loops: float = 3,
    thickness: float = 0.5,
    strands: float = 4,
    crossings: float = 44,
    relief: float = 0.2,
    roughness: float = 0.03,
) -> Solid:
    """Return the knot; `make_shape` describes the options."""
    for key, value in {"turns": turns, "loops": loops, "strands": strands, "crossings": crossings}.items():
        if value != int(value) or value < 1:
            raise ConfigError(f"the option '{key}' of the shape 'knot' must be a whole number from 1, not {value!r}")
    if math.gcd(int(turns), int(loops)) != 1:
        raise ConfigError(f"a knot's turns and loops have no common divisor, but {turns} and {loops} do")
    # With these proportions the cells of a plain knot are about square: its curve is nine times as long as a turn
    # around the tube.
    require_triangles("knot", triangles, 2 * 9 * 3**2)
    across = math.isqrt(triangles // (2 * 9))
    along = triangles // (2 * across)

    # The curve, and a frame across it: the normal of the torus that it lies on, which closes with the curve.
    t = np.arange(along) * (2 * np.pi / along)
    radial = np.column_stack((np.cos(turns * t), np.sin(turns * t), np.zeros(along)))
    onward = np.column_stack((-np.sin(turns * t), np.cos(turns * t), np.zeros(along)))
    axial = np.array([0.0, 0.0, 1.0])
    reach, lift = (2 + 0.9 * np.cos(loops * t))[:, None], 0.9 * np.sin(loops * t)[:, None]
    curve = reach * radial + lift * axial
    normal = np.cos(loops * t)[:, None] * radial + np.sin(loops * t)[:, None] * axial
    tangent = loops * (-lift * radial + (reach - 2) * axial) + turns * reach * onward
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, normal)

    # The braid: two families of strands wind in opposite senses; where they cross, they take turns on top.
    angle = np.arange(across) * (2 * np.pi / across)
    around, forth = strands * angle[None, :], crossings * t[:, None]
    over = 0.35 * np.cos(around)
    braid = np.maximum(_strand(around + forth) + over, _strand(around - forth) - over)
    radius = thickness * (1 + relief * np.maximum(braid - 0.7, -0.55))

    outward = np.cos(angle)[None, :, None] * normal[:, None, :] + np.sin(angle)[None, :, None] * side[:, None, :]
    surface = curve[:, None, :] + radius[..., None] * outward
    wear = fractal_noise(surface.reshape(-1, 3) * (1.5 / thickness), generator, octaves=3).reshape(radius.shape)
    surface += (thickness * roughness * wear)[..., None] * outward

    # The grid closes in both directions.
    row, column = np.divmod(np.arange(along * across), across)
    next_row, next_column = (row + 1) % along, (column + 1) % across
    faces = cut_quads(
        row * across + column,
        row * across + next_column,
        next_row * across + next_column,
        next_row * across + column,
    )
    return surface.reshape(-1, 3), faces


def _strand(phase: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the height of strands that lie at each multiple of 2 pi: rounded, from 1 down to below 0 between them."""
    distance = np.abs((phase + np.pi) % (2 * np.pi) - np.pi)
    return np.cos(distance * 0.62)
