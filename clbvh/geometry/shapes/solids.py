"""Plain solids: boxes, the unit sphere, clouds of either, and the parts of other procedural shapes.

Vertices are float64, faces int64.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import ConfigError
from ..local_frame import rotation_matrix

Solid = tuple[NDArray[np.float64], NDArray[np.int64]]


def require_triangles(name: str, triangles: int, least: int) -> None:
    """Raise `ConfigError` unless there are enough triangles for the smallest mesh of the shape."""
    if triangles < least:
        raise ConfigError(f"the shape '{name}' needs at least {least} triangles, not {triangles}")


def cut_quads(
    a: NDArray[np.int64], b: NDArray[np.int64], c: NDArray[np.int64], d: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return two triangles per quad a, b, c, d, next to each other."""
    return np.column_stack((a, b, c, a, c, d)).reshape(-1, 3)


# The corners of a cube, x slowest, and its six sides seen from outside.
CUBE_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
CUBE_FACES = cut_quads(
    *np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]).T
)


def make_box(lower: ArrayLike, upper: ArrayLike) -> Solid:
    """Return a box along the axes between two corners, each (3,)."""
    lower, upper = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
    return np.where(CUBE_CORNERS < 0, lower, upper), CUBE_FACES


def make_beam(begin: ArrayLike, end: ArrayLike, width: float) -> Solid:
    """Return a beam of square cross-section between two (3,) points, of which none is straight above the other."""
    begin, end = np.asarray(begin, np.float64), np.asarray(end, np.float64)
    along = (end - begin) / 2
    side = np.cross(along, [0.0, 1.0, 0.0])
    side *= width / 2 / np.linalg.norm(side)
    upward = np.cross(side, along)
    upward *= width / 2 / np.linalg.norm(upward)
    return (begin + end) / 2 + CUBE_CORNERS @ np.array([along, upward, side]), CUBE_FACES


def make_lathe(centre: ArrayLike, radii: ArrayLike, heights: ArrayLike, sides: int) -> Solid:
    """Return a profile turned about the y axis, open at both ends.

    Parameters
    ----------
    centre : (3,) float
        The point on the axis at height 0.
    radii, heights : (k,) float
        The profile, from bottom to top.
    sides : int
        Quads around the axis; 2 (k - 1) sides triangles in all.
    """
    radii, heights = np.asarray(radii, np.float64), np.asarray(heights, np.float64)
    angle = np.arange(sides) * (2 * np.pi / sides)
    rings = np.empty((len(radii), sides, 3))
    rings[..., 0] = radii[:, None] * np.cos(angle)
    rings[..., 1] = heights[:, None]
    rings[..., 2] = radii[:, None] * np.sin(angle)
    ring, column = np.divmod(np.arange((len(radii) - 1) * sides), sides)
    next_column = (column + 1) % sides
    here, above = ring * sides, (ring + 1) * sides
    faces = cut_quads(here + column, above + column, above + next_column, here + next_column)
    return rings.reshape(-1, 3) + np.asarray(centre, np.float64), faces


_HALF = 0.5
_SQUARE_CORNERS = np.array([[-_HALF, 0, -_HALF], [-_HALF, 0, _HALF], [_HALF, 0, _HALF], [_HALF, 0, -_HALF]])
_SQUARE_FACES = cut_quads(*np.arange(4).reshape(4, 1))


def make_square(triangles: int, generator: np.random.Generator) -> Solid:
    """Return a square of side 1 that faces up, around the origin."""
    require_triangles("square", triangles, len(_SQUARE_FACES))
    return _SQUARE_CORNERS.copy(), _SQUARE_FACES


def make_cube(triangles: int, generator: np.random.Generator) -> Solid:
    """Return a cube of side 1 around the origin."""
    require_triangles("cube", triangles, len(CUBE_FACES))
    return make_box([-_HALF] * 3, [_HALF] * 3)


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
    # They fill half of a square grid: `number` counts them, and the neighbours of slot i are i + 1 and i + `row`.
    row = frequency + 1
    a, b = np.divmod(np.arange(row**2), row)
    weights = np.column_stack((a, b, frequency - a - b))[a + b <= frequency]
    number = np.cumsum(a + b <= frequency) - 1
    up, down = np.flatnonzero(a + b < frequency)[:, None], np.flatnonzero(a + b < frequency - 1)[:, None]
    cells = number[np.concatenate((up + np.array([0, row, 1]), down + np.array([1, row, row + 1])))]

    # Points on a common edge have equal tips with equal weights, so whole numbers identify them.
    marks = np.sort(np.where(weights > 0, sides[:, None, :] * row + weights, 0), axis=2)
    base = 12 * row
    keys = (marks[..., 0] * base + marks[..., 1]) * base + marks[..., 2]
    _, first, vertex_of = np.unique(keys, return_index=True, return_inverse=True)
    points = np.einsum("nw,swx->snx", weights.astype(np.float64), tips[sides]).reshape(-1, 3)[first]
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points, vertex_of.reshape(len(sides), -1)[:, cells].reshape(-1, 3)


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
    rotation = rotation_matrix(x, y, z, w).transpose(2, 0, 1)
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
