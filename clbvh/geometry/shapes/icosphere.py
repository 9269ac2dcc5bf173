"""The unit sphere, as a subdivided icosahedron."""

from __future__ import annotations

import math

import numpy as np

from .solids import Solid, require_triangles


def make_icosphere(triangles: int, generator: np.random.Generator) -> Solid:
    """Return the sphere; the generator is not drawn from."""
    require_triangles("icosphere", triangles, 20)
    frequency = math.isqrt(triangles // 20)
    golden = (1 + math.sqrt(5)) / 2
    tips = np.array([[0, y, golden * z] for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    tips = np.concatenate((tips, np.roll(tips, 1, axis=1), np.roll(tips, 2, axis=1)))
    # The faces of the icosahedron are the triples of tips at distance 2 from each other.
    near = np.isclose(np.linalg.norm(tips[:, None] - tips[None], axis=2), 2)
    sides = np.array(
        [(i, j, k) for i in range(12) for j in range(i) for k in range(j) if near[i, j] and near[j, k] and near[i, k]]
    )
    inward = np.linalg.det(tips[sides]) < 0
    sides[inward] = sides[inward][:, ::-1]

    # Each side gets a triangular lattice; the weights of its three tips are whole numbers that add up to `frequency`.
    weight_a, weight_b = np.divmod(np.arange((frequency + 1) ** 2), frequency + 1)
    kept = weight_a + weight_b <= frequency
    weights = np.column_stack((weight_a, weight_b, frequency - weight_a - weight_b))[kept]
    position_of = np.cumsum(kept) - 1
    at = position_of[np.flatnonzero(kept & (weight_a + weight_b < frequency))]
    a, b = weights[at, 0], weights[at, 1]
    up = np.column_stack(
        (
            position_of[a * (frequency + 1) + b],
            position_of[(a + 1) * (frequency + 1) + b],
            position_of[a * (frequency + 1) + b + 1],
        )
    )
    has_down = a + b < frequency - 1
    corner = position_of[((a + 1) * (frequency + 1) + b + 1)[has_down]]
    down = np.column_stack((up[has_down, 2], up[has_down, 1], corner))
    cells = np.concatenate((up, down))

    # Points on a common edge have equal tips with equal weights, so whole numbers identify them.
    marks = np.sort(np.where(weights > 0, sides[:, None, :] * (frequency + 1) + weights, 0), axis=2)
    base = 12 * (frequency + 1)
    keys = (marks[..., 0] * base + marks[..., 1]) * base + marks[..., 2]
    _, first, vertex_of = np.unique(keys, return_index=True, return_inverse=True)
    points = np.einsum("nw,swx->snx", weights.astype(np.float64), tips[sides]).reshape(-1, 3)[first]
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points, vertex_of.reshape(len(sides), -1)[:, cells].reshape(-1, 3)
