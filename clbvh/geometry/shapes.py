"""Procedural meshes: the same name, size and seed give the same mesh, and no file is needed.

Owns the shapes and the choice of a resolution for a wanted number of triangles. All of it is float64 numpy on whole
arrays: 871,200 triangles take about a second.

The random numbers come from numpy's PCG64, whose stream is the same everywhere. Sines and powers may differ in the
last bit between processors, and so may coordinates.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from .mesh import Mesh
from .noise import fractal_noise
from .palace import make_palace
from .solids import CUBE_CORNERS, CUBE_FACES, Solid, cut_quads


def make_shape(name: str, *, triangles: int, seed: int = 0, **options: float) -> Mesh:
    """Make a procedural mesh.

    Parameters
    ----------
    name : str
        One of `SHAPES`.
    triangles : int
        How many are wanted. What is delivered is the largest number not above it that the shape can have.
    seed : int, optional
        From 0; another seed gives another mesh of the same kind.
    **options : float
        Of the shape, with these defaults:

        - `knot`: a closed tube along a torus knot, covered with a braid. ``turns=2`` around the axis and ``loops=3``
          through the hole; ``thickness=0.5`` of the tube, for radii 2 and 0.9 of the torus; ``strands=4`` each way
          around the tube, which cross ``crossings=44`` times along it; ``relief=0.2`` and ``roughness=0.03``, the
          heights of braid and noise in tube radii. 2 m n triangles, where 8 n^2 is about the number wanted.
        - `terrain`: mountains over a square of side 10, y up, ``height=2.4``. Open. 2 m n triangles, m about n.
        - `blobs`: a cloud of overlapping dented balls, ``spread=1`` its radius, ``size=1`` the balls' scale. Multiples
          of 20, 80, 320 or 1280, the more the larger the mesh.
        - `boxes`: a cloud of overlapping boxes that lie anyhow; the same options. Multiples of 12.
        - `icosphere`: the unit sphere, closed. 20 n^2.
        - `palace`: halls with columns, stairs, windows and vases, y up, in metres: a scene with huge, long thin and
          tiny triangles. Not closed. Any number, less up to a few hundred.

    Returns
    -------
    Mesh
        Called after the shape.

    Raises
    ------
    ConfigError
        No such shape or option, a value outside its range, or fewer triangles than the shape needs.

    Examples
    --------
    >>> make_shape("knot", triangles=871_200, seed=1).face_count
    871200
    >>> make_shape("icosphere", triangles=1000).face_count
    980
    """
    shape = SHAPES.get(name)
    if shape is None:
        raise ConfigError(f"there is no shape '{name}': take one of {', '.join(SHAPES)}")
    known = [key for key in inspect.signature(shape).parameters if key not in ("triangles", "generator")]
    for key, value in options.items():
        if key not in known:
            raise ConfigError(f"the shape '{name}' has no option '{key}': it has {', '.join(known) or 'none'}")
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
            raise ConfigError(f"the option '{key}' of the shape '{name}' must be a number from 0, not {value!r}")
    for key, number in (("triangles", triangles), ("seed", seed)):
        if isinstance(number, bool) or not isinstance(number, int | np.integer) or number < 0:
            raise ConfigError(f"{key} must be a whole number from 0, not {number!r}")
    vertices, faces = shape(int(triangles), np.random.default_rng(int(seed)), **options)
    return Mesh.from_arrays(vertices, faces, name=name)


def _make_knot(
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
    for key, value in {"turns": turns, "loops": loops, "strands": strands, "crossings": crossings}.items():
        if value != int(value) or value < 1:
            raise ConfigError(f"the option '{key}' of the shape 'knot' must be a whole number from 1, not {value!r}")
    if math.gcd(int(turns), int(loops)) != 1:
        raise ConfigError(f"a knot's turns and loops have no common divisor, but {turns} and {loops} do")
    # With these proportions the cells of a plain knot are about square: its curve is nine times as long as a turn
    # around the tube.
    _require("knot", triangles, 2 * 9 * 3**2)
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

    # The braid: two families of strands wind in opposite senses; where they cross, one lies above the other by turns.
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


def _make_terrain(triangles: int, generator: np.random.Generator, *, height: float = 2.4) -> Solid:
    _require("terrain", triangles, 2)
    columns = math.isqrt(triangles // 2)
    rows = triangles // (2 * columns)
    z, x = np.meshgrid(np.linspace(-5, 5, rows + 1), np.linspace(-5, 5, columns + 1), indexing="ij")
    place = np.column_stack((x.ravel(), z.ravel()))

    # Ranges bend, because the plane is warped before the ridges are drawn on it. The finest octave is four cells of
    # the grid wide; those that a larger mesh adds leave the others as they are.
    bend = np.column_stack([fractal_noise(place * 0.25, generator, octaves=2) for _ in range(2)])
    rolling = fractal_noise(place * 0.15, generator, octaves=3)
    octaves = max(int(math.log2(columns / 4)), 1)
    ridges = fractal_noise(place * 0.2 + 0.35 * bend, generator, octaves=octaves, ridged=True)
    # Valleys are broad and calm, peaks narrow and rough; towards the border all goes down to a level shore.
    shore = np.prod(1 - (place / 5) ** 8, axis=1)
    y = height * shore * (ridges**1.6 + 0.3 * rolling)

    vertices = np.column_stack((place[:, 0], y, place[:, 1]))
    row, column = np.divmod(np.arange(rows * columns), columns)
    corner = row * (columns + 1) + column
    below = corner + columns + 1
    return vertices, cut_quads(corner, below, below + 1, corner + 1)


def _make_blobs(triangles: int, generator: np.random.Generator, *, spread: float = 1.0, size: float = 1.0) -> Solid:
    _require("blobs", triangles, 20)
    # As round as leaves at least 300 of them.
    frequency = next((n for n in (8, 4, 2) if triangles >= 300 * 20 * n * n), 1)
    ball, ball_faces = _make_icosphere(20 * frequency**2, generator)
    count = triangles // len(ball_faces)
    centres, radii = _scatter(count, generator, spread, size)

    # Each ball has dents of its own: a few waves across it.
    waves = generator.normal(size=(count, 3, 3)) * 1.6
    phases = generator.uniform(0, 2 * np.pi, (count, 3, 1))
    dents = np.sin(waves @ ball.T + phases).mean(axis=1)
    vertices = centres[:, None, :] + (radii[:, None] * (1 + 0.15 * dents))[..., None] * ball
    return _repeat_faces(vertices, ball_faces)


def _make_boxes(triangles: int, generator: np.random.Generator, *, spread: float = 1.0, size: float = 1.0) -> Solid:
    _require("boxes", triangles, 12)
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


def _make_icosphere(triangles: int, generator: np.random.Generator) -> Solid:
    _require("icosphere", triangles, 20)
    frequency = math.isqrt(triangles // 20)
    golden = (1 + math.sqrt(5)) / 2
    tips = np.array([[0, y, golden * z] for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    tips = np.concatenate((tips, np.roll(tips, 1, axis=1), np.roll(tips, 2, axis=1)))
    # The faces of the icosahedron are the triples of tips that are 2 apart from each other.
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

    # Points on a common edge have the same tips with the same weights, so whole numbers tell that they are one.
    marks = np.sort(np.where(weights > 0, sides[:, None, :] * (frequency + 1) + weights, 0), axis=2)
    base = 12 * (frequency + 1)
    keys = (marks[..., 0] * base + marks[..., 1]) * base + marks[..., 2]
    _, first, vertex_of = np.unique(keys, return_index=True, return_inverse=True)
    points = np.einsum("nw,swx->snx", weights.astype(np.float64), tips[sides]).reshape(-1, 3)[first]
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points, vertex_of.reshape(len(sides), -1)[:, cells].reshape(-1, 3)


def _make_palace(triangles: int, generator: np.random.Generator) -> Solid:
    _require("palace", triangles, 12)
    return make_palace(triangles, generator)


def _scatter(
    count: int, generator: np.random.Generator, spread: float, size: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return centres in a ball, and radii at which neighbours overlap."""
    direction = generator.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    centres = spread * np.cbrt(generator.uniform(size=count))[:, None] * direction
    radii = size * spread / np.cbrt(count) * np.exp(generator.normal(-0.1, 0.35, count))
    return centres, radii


def _repeat_faces(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Solid:
    """Join copies of one mesh: (n, v, 3) vertices, each with the same (f, 3) faces."""
    count, vertex_count, _ = vertices.shape
    offsets = np.arange(count)[:, None, None] * vertex_count
    return vertices.reshape(-1, 3), (faces[None] + offsets).reshape(-1, 3)


def _require(name: str, triangles: int, least: int) -> None:
    if triangles < least:
        raise ConfigError(f"the shape '{name}' needs at least {least} triangles, not {triangles}")


SHAPES: dict[str, Callable[..., Solid]] = {
    "knot": _make_knot,
    "terrain": _make_terrain,
    "blobs": _make_blobs,
    "boxes": _make_boxes,
    "icosphere": _make_icosphere,
    "palace": _make_palace,
}
