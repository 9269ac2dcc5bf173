"""The meshes, rays and points of the conformance check: small, fixed, and the same bytes on every machine.

Coordinates come from integers, from generators of uniform numbers and from IEEE arithmetic alone, never from a library
of mathematical functions, whose last bits differ between machines.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import Mesh
from ..geometry.shapes.solids import make_icosphere

# Rays or points of each kind, see `make_rays` and `make_points`.
_AROUND, _AT_VERTICES, _AT_EDGES, _INSIDE, _LIMITED = 72, 60, 48, 30, 30
_SPREAD_POINTS, _VERTEX_POINTS, _CENTRE_POINTS = 48, 24, 24

# The ball's vertices lie on a grid: the sphere's own last bits come from a library.
_BALL_TRIANGLES, _BALL_GRID = 320, 2.0**10

_SOUP_TRIANGLES, _NEEDLES = 150, 60
_PLATE_CELLS = 6

# A corner of Bavaria in UTM coordinates, metres: float32 resolves half a metre there.
_FAR_ORIGIN = (448_000.0, 5_411_000.0, 300.0)

# Exact to scale by: hits must not depend on the size of a mesh.
_SMALL_SCALE = 2.0**-20


class Rays(NamedTuple):
    """Rays as queries take them.

    Attributes
    ----------
    origins, directions : (n, 3) float64
    t_min, t_max : (n,) float64
    """

    origins: NDArray[np.float64]
    directions: NDArray[np.float64]
    t_min: NDArray[np.float64]
    t_max: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Case:
    """A mesh, and what is asked of it.

    Attributes
    ----------
    name : str
    vertices : (V, 3) float64
    faces : (F, 3) int64
    rays : Rays
    points : (n, 3) float64
    is_closed : bool
        Whether points can be inside.
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    rays: Rays
    points: NDArray[np.float64]
    is_closed: bool

    @cached_property
    def mesh(self) -> Mesh:
        """The mesh of these vertices and faces."""
        return Mesh.from_arrays(self.vertices, self.faces, name=self.name)


def make_cases() -> list[Case]:
    """Return all cases, the same every time."""
    ball_vertices, ball_faces = _make_ball()
    meshes = {
        "single": _make_single(),
        "soup": _make_soup(np.random.default_rng(1)),
        "needles": _make_needles(np.random.default_rng(2)),
        "plates": _make_plates(np.random.default_rng(3)),
        "ball": (ball_vertices, ball_faces),
        "small ball": (ball_vertices * _SMALL_SCALE, ball_faces),
        "far ball": (ball_vertices + np.array(_FAR_ORIGIN), ball_faces),
    }
    cases = []
    for seed, (name, (vertices, faces)) in enumerate(meshes.items()):
        generator = np.random.default_rng(seed)
        rays, points = make_rays(vertices, faces, generator), make_points(vertices, faces, generator)
        cases.append(Case(name, vertices, faces, rays, points, is_closed=name.endswith("ball")))
    return cases


def make_rays(vertices: NDArray[np.float64], faces: NDArray[np.int64], generator: np.random.Generator) -> Rays:
    """Return rays of five kinds, one after the other.

    From all around at points of the box; along the axes, exactly through vertices; from outside at the middles of
    edges; from within the box in any direction; and between limits.
    """
    lower, size = vertices.min(axis=0), np.ptp(vertices, axis=0).max()
    middle = lower + np.ptp(vertices, axis=0) / 2

    def in_box(count: int, growth: float = 1.0) -> NDArray[np.float64]:
        return middle + (generator.random((count, 3)) - 0.5) * growth * size

    corners = vertices[faces]
    chosen = generator.integers(len(vertices), size=_AT_VERTICES)
    along = np.eye(3)[np.arange(_AT_VERTICES) % 3] * np.where(np.arange(_AT_VERTICES) % 2, 1.0, -1.0)[:, None]
    triangle, corner = generator.integers(len(faces), size=_AT_EDGES), generator.integers(3, size=_AT_EDGES)
    edge_middles = (corners[triangle, corner] + corners[triangle, (corner + 1) % 3]) / 2

    far, inside, limited = in_box(_AROUND, 5.0), in_box(_INSIDE), in_box(_LIMITED, 3.0)
    beside = in_box(_AT_EDGES, 4.0)
    origins = np.concatenate([far, vertices[chosen] - 2 * size * along, beside, inside, limited])
    directions = np.concatenate(
        [in_box(_AROUND) - far, along, edge_middles - beside, in_box(_INSIDE) - inside, in_box(_LIMITED) - limited]
    )
    t_min, t_max = np.zeros(len(origins)), np.full(len(origins), np.inf)
    t_min[-_LIMITED:], t_max[-_LIMITED:] = generator.random(_LIMITED), 1.0 + generator.random(_LIMITED)
    return Rays(origins, directions, t_min, t_max)


def make_points(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], generator: np.random.Generator
) -> NDArray[np.float64]:
    """Return points in and around the box, vertices, where faces are equally near, and centres of faces."""
    middle = vertices.min(axis=0) + np.ptp(vertices, axis=0) / 2
    spread = middle + (generator.random((_SPREAD_POINTS, 3)) - 0.5) * 1.5 * np.ptp(vertices, axis=0).max()
    chosen = generator.integers(len(vertices), size=_VERTEX_POINTS)
    a, b, c = vertices[faces[generator.integers(len(faces), size=_CENTRE_POINTS)]].transpose(1, 0, 2)
    return np.concatenate([spread, vertices[chosen], (a + b + c) / 3])


_Solid = tuple[NDArray[np.float64], NDArray[np.int64]]


def _make_single() -> _Solid:
    """Return one triangle, a tree of one leaf."""
    return np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.25], [0.0, 1.0, 0.5]]), np.array([[0, 1, 2]])


def _make_soup(generator: np.random.Generator) -> _Solid:
    """Return triangles of all sizes anywhere, every tenth of them without area."""
    centres = generator.random((_SOUP_TRIANGLES, 1, 3))
    sizes = 2.0 ** -generator.integers(0, 6, (_SOUP_TRIANGLES, 1, 1))
    corners = centres + sizes * (generator.random((_SOUP_TRIANGLES, 3, 3)) - 0.5)
    corners[::10, 2] = corners[::10, 1]
    return corners.reshape(-1, 3), np.arange(3 * _SOUP_TRIANGLES).reshape(-1, 3)


def _make_needles(generator: np.random.Generator) -> _Solid:
    """Return triangles that are a hundred times as long as they are wide."""
    begins = generator.random((_NEEDLES, 3))
    widths = 2.0**-6 * generator.random((_NEEDLES, 3))
    corners = np.stack((begins, begins + widths, generator.random((_NEEDLES, 3))), axis=1)
    return corners.reshape(-1, 3), np.arange(3 * _NEEDLES).reshape(-1, 3)


def _make_plates(generator: np.random.Generator) -> _Solid:
    """Return terraces on a grid of integers, each face twice: every hit is a tie, and vertices are met exactly."""
    heights = generator.integers(0, 3, (_PLATE_CELLS + 1, _PLATE_CELLS + 1))
    places = list(product(range(_PLATE_CELLS + 1), repeat=2))
    vertices = np.array([(x, y, heights[x, y]) for x, y in places], np.float64)
    row = _PLATE_CELLS + 1
    faces = np.array(
        [
            face
            for x, y in product(range(_PLATE_CELLS), repeat=2)
            for first in [x * row + y]
            for face in ((first, first + row, first + 1), (first + 1, first + row, first + row + 1))
        ]
    )
    return vertices, np.concatenate((faces, faces[::-1]))


def _make_ball() -> _Solid:
    """Return a closed mesh with vertices on a grid."""
    vertices, faces = make_icosphere(_BALL_TRIANGLES, np.random.default_rng(0))
    return np.rint(vertices * _BALL_GRID) / _BALL_GRID, faces
