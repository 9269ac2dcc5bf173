"""A building, with the triangles of architectural scenes that scans lack: huge, and long and thin, among tiny ones.

Halls side by side and one above the other, each with floor and walls of a few large triangles, doors and windows,
columns, a stair with a balustrade, beams, braces under the ceiling, vases and a chandelier. Lengths are metres, y is
up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .solids import CUBE_FACES, Solid, make_beam, make_box, make_lathe, require_triangles

# The triangles of a whole hall, most of them in its furniture; a test checks the number.
HALL_TRIANGLES = 6620

_HEIGHT = 4.2  # of a storey
_SLAB = 0.3  # thickness of floors
_WALL = 0.25
_NARROWEST, _WIDEST = 6.0, 11.0  # halls
_STOREYS = 3

# Vertices lie on a grid, so that parts that touch share theirs, in float32 too. The spacing is far below the smallest
# edge, and a power of two: about a quarter of a millimetre.
_SPACING = 2.0**-12
# Three whole numbers in one of 64 bits: 32 metres of height, 2048 of length and width, which a billion triangles need.
_HEIGHT_BITS, _SIDE_BITS = 17, 23


def make_palace(triangles: int, generator: np.random.Generator) -> Solid:
    """Return a palace of at most `triangles` triangles, part by part until the next one does not fit."""
    require_triangles("palace", triangles, len(CUBE_FACES))
    hall_count = -(-triangles // HALL_TRIANGLES)
    storeys = min(_STOREYS, hall_count)
    columns = math.ceil(math.sqrt(hall_count / storeys))
    x_lines, z_lines = (
        np.concatenate(([0.0], np.cumsum(generator.uniform(_NARROWEST, _WIDEST, columns)))) for _ in range(2)
    )
    vertices: list[NDArray[np.float64]] = []
    faces: list[NDArray[np.int64]] = []
    vertex_count = face_count = 0
    for hall in range(hall_count):
        storey, plot = hall % storeys, hall // storeys
        row, column = divmod(plot, columns)
        lower = np.array([x_lines[column], storey * _HEIGHT, z_lines[row]])
        upper = np.array([x_lines[column + 1], (storey + 1) * _HEIGHT, z_lines[row + 1]])
        for part_vertices, part_faces in _make_hall(lower, upper, generator):
            if face_count + len(part_faces) > triangles:
                return _join(vertices, faces)
            vertices.append(part_vertices)
            faces.append(part_faces + vertex_count)
            vertex_count += len(part_vertices)
            face_count += len(part_faces)
    return _join(vertices, faces)


def _join(vertices: list[NDArray[np.float64]], faces: list[NDArray[np.int64]]) -> Solid:
    """Move the vertices onto the grid, and merge equal ones."""
    steps: NDArray[np.int64] = np.rint(np.concatenate(vertices) / _SPACING).astype(np.int64)
    steps -= steps.min(axis=0)
    keys = (((steps[:, 0] << _SIDE_BITS) + steps[:, 2]) << _HEIGHT_BITS) + steps[:, 1]
    _, first, vertex_of = np.unique(keys, return_index=True, return_inverse=True)
    return steps[first].astype(np.float64) * _SPACING, vertex_of[np.concatenate(faces)]


def _make_hall(
    lower: NDArray[np.float64], upper: NDArray[np.float64], generator: np.random.Generator
) -> Iterator[Solid]:
    """Yield the parts of a hall between two corners, the large ones first."""
    x, y, z = lower
    far_x, _, far_z = upper
    floor = y + _SLAB
    ceiling = upper[1]
    inner_x, inner_z = (x + _WALL, far_x - _WALL), (z + _WALL, far_z - _WALL)

    yield make_box((x, y, z), (far_x, floor, far_z))
    yield from _make_walls(lower, upper, generator)
    for side in inner_z:
        yield make_box((inner_x[0], floor, side - 0.02), (inner_x[1], floor + 0.12, side + 0.02))
    for share in np.linspace(0.1, 0.9, 6):
        at = z + share * (far_z - z)
        yield make_box((inner_x[0], ceiling - 0.25, at - 0.06), (inner_x[1], ceiling, at + 0.06))
        yield make_beam((inner_x[0], ceiling - 1.0, at), (inner_x[0] + 0.9, ceiling - 0.2, at), 0.09)
        yield make_beam((inner_x[1], ceiling - 1.0, at), (inner_x[1] - 0.9, ceiling - 0.2, at), 0.09)

    # Columns along both sides, a stair against the back wall, vases and a chandelier.
    radius = generator.uniform(0.14, 0.22)
    for column_x in (x + 0.22 * (far_x - x), x + 0.78 * (far_x - x)):
        for share in (0.3, 0.7):
            yield from _make_column((column_x, floor, z + share * (far_z - z)), ceiling - 0.25 - floor, radius)
    yield from _make_stair(inner_x[0] + 0.6, floor, inner_z[0] + 0.1, far_x - x - 3.0)
    for _ in range(3):
        foot = (generator.uniform(*inner_x), floor, generator.uniform(z + 2.0, inner_z[1]))
        yield _make_vase(foot, generator)
    yield from _make_chandelier(((x + far_x) / 2, ceiling - 0.25, (z + far_z) / 2), generator)


def _make_walls(
    lower: NDArray[np.float64], upper: NDArray[np.float64], generator: np.random.Generator
) -> Iterator[Solid]:
    """Yield two walls, each around an opening: a door, and a window with bars."""
    x, y, z = lower
    far_x, _, far_z = upper
    floor, top = y + _SLAB, upper[1]
    for is_window in (False, True):
        # `along` runs with the wall, from `begin` to `end`; the opening is a piece of it.
        begin, end = (z, far_z) if is_window else (x, far_x)
        left = begin + generator.uniform(0.3, 0.6) * (end - begin)
        right = left + generator.uniform(1.2, 1.8)
        sill, lintel = (floor + 0.9, floor + 2.3) if is_window else (floor, floor + 2.2)
        pieces = [(begin, left, floor, top), (right, end, floor, top), (left, right, lintel, top)]
        if is_window:
            pieces.append((left, right, floor, sill))
        for piece_begin, piece_end, bottom, piece_top in pieces:
            if is_window:
                yield make_box((x, bottom, piece_begin), (x + _WALL, piece_top, piece_end))
            else:
                yield make_box((piece_begin, bottom, z), (piece_end, piece_top, z + _WALL))
    for share in np.linspace(0, 1, 12)[1:-1]:
        at = left + share * (right - left)
        yield make_box((x + 0.1, sill, at - 0.008), (x + 0.116, lintel, at + 0.008))


def _make_column(foot: tuple[float, float, float], height: float, radius: float) -> Iterator[Solid]:
    """Yield base, shaft and capital: the shaft has sides as long as it is high."""
    ring = np.array([1.5, 1.5, 1.3, 1.38, 1.25, 1.1, 1.0]) * radius
    rise = np.array([0.0, 0.06, 0.09, 0.13, 0.17, 0.19, 0.24])
    yield make_lathe(foot, ring, rise, 16)
    yield make_lathe(foot, [radius, 0.9 * radius], [0.24, height - 0.24], 24)
    yield make_lathe(foot, ring[::-1], height - rise[::-1], 16)


def _make_stair(x: float, y: float, z: float, length: float) -> Iterator[Solid]:
    """Yield steps up along x, two handrails, and the balusters under one of them."""
    steps, width, height = 14, 1.3, 2.4
    run, rise = length / steps, height / steps
    for step in range(steps):
        yield make_box((x + step * run, y, z), (x + (step + 1) * run, y + (step + 1) * rise, z + width))
    for side in (z + 0.05, z + width - 0.05):
        yield make_beam((x, y + 0.95, side), (x + length, y + height + 0.95, side), 0.06)
    for step in range(steps):
        foot = (x + (step + 0.5) * run, y + (step + 1) * rise, z + width - 0.05)
        yield make_lathe(foot, [0.02, 0.04, 0.02, 0.035, 0.015], [0.0, 0.15, 0.35, 0.6, 0.85], 8)


def _make_vase(foot: tuple[float, float, float], generator: np.random.Generator) -> Solid:
    """Return a turned vase of small triangles."""
    heights = np.linspace(0.0, generator.uniform(0.3, 0.9), 15)
    swing = generator.uniform(1.5, 5.0)
    radii = 0.05 + 0.12 * (1.2 + np.sin(np.linspace(0.3, swing, 15))) * generator.uniform(0.5, 1.0)
    return make_lathe(foot, radii, heights, 24)


def _make_chandelier(hook: tuple[float, float, float], generator: np.random.Generator) -> Iterator[Solid]:
    """Yield a chain and a ring of arms with a lamp on each: tiny triangles in the middle of an empty hall."""
    x, y, z = hook
    drop, reach = generator.uniform(0.6, 1.1), generator.uniform(0.4, 0.7)
    yield make_lathe((x, y - drop, z), [0.012, 0.012], [0.0, drop], 6)
    bulb = np.sin(np.linspace(0.15, np.pi - 0.15, 7)) * 0.045
    for arm in range(10):
        angle = 2 * np.pi * arm / 10
        tip = np.array([x + reach * math.cos(angle), y - drop + 0.12, z + reach * math.sin(angle)])
        yield make_beam((x, y - drop, z), tip, 0.016)
        yield make_lathe(tip, bulb, np.linspace(0.0, 0.1, 7), 10)
