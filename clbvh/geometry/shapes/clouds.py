"""Clouds of overlapping solids: dented balls, or boxes at any angle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .icosphere import make_icosphere
from .solids import CUBE_CORNERS, CUBE_FACES, Solid, require_triangles


def make_blobs(triangles: int, generator: np.random.Generator, *, spread: float = 1.0, size: float = 1.0) -> Solid:
    """Return the cloud; `make_shape` describes the options."""
    require_triangles("blobs", triangles, 20)
    # The roundest balls of which there are at least 300.
    frequency = next((n for n in (8, 4, 2) if triangles >= 300 * 20 * n * n), 1)
    ball, ball_faces = make_icosphere(20 * frequency**2, generator)
    count = triangles // len(ball_faces)
    centres, radii = _scatter(count, generator, spread, size)

    # Each ball has its own dents: a few waves across it.
    waves = generator.normal(size=(count, 3, 3)) * 1.6
    phases = generator.uniform(0, 2 * np.pi, (count, 3, 1))
    dents = np.sin(waves @ ball.T + phases).mean(axis=1)
    vertices = centres[:, None, :] + (radii[:, None] * (1 + 0.15 * dents))[..., None] * ball
    return _repeat_faces(vertices, ball_faces)


def make_boxes(triangles: int, generator: np.random.Generator, *, spread: float = 1.0, size: float = 1.0) -> Solid:
    """Return the cloud; `make_shape` describes the options."""
    require_triangles("boxes", triangles, 12)
    count = triangles // 12
    centres, radii = _scatter(count, generator, spread, size)

    # A random rotation is a random unit quaternion (Ken Shoemake, "Uniform Random Rotations", 1992).
    q = generator.normal(size=(count, 4))
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    sides = radii[:, None] * generator.uniform(0.35, 1.0, (count, 3))
    vertices = centres[:, None, :] + (CUBE_CORNERS * sides[:, None, :]) @ rotation.transpose(0, 2, 1)
    return _repeat_faces(vertices, CUBE_FACES)


def _scatter(
    count: int, generator: np.random.Generator, spread: float, size: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return centres in a ball, (count, 3), and radii so large that neighbours overlap, (count,)."""
    direction = generator.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    centres = spread * np.cbrt(generator.uniform(size=count))[:, None] * direction
    radii = size * spread / np.cbrt(count) * np.exp(generator.normal(-0.1, 0.35, count))
    return centres, radii


def _repeat_faces(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Solid:
    """Return n copies of one mesh as one: (n, v, 3) vertices, each copy with the same (f, 3) faces."""
    count, vertex_count, _ = vertices.shape
    offsets = np.arange(count)[:, None, None] * vertex_count
    return vertices.reshape(-1, 3), (faces[None] + offsets).reshape(-1, 3)
