"""Copies of an object: in a grid, or on random points of a surface, as many per area everywhere.

Osada, Funkhouser, Chazelle and Dobkin, "Shape Distributions", 2002, section 3.1. Must not know of scene files: their
tables are converted into the classes here, whose fields are the keys.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import force_setattr
from numpy.typing import NDArray

from ..errors import MeshError, SceneError
from ..support.memory import check_memory
from .handles import Vector

# Copies of all objects of a scene: 128 MB of matrices. Each costs some microseconds of Python, too.
MAX_COPIES = 1_000_000

# Memory of a copy while copies are placed: random numbers, matrices and their products, a handle and a name.
_BYTES_PER_COPY = 1000

ALIGNMENTS = ("up", "normal")

# Opposite directions have no shortest rotation between them. Below this value of 1 + cosine they count as opposite.
_OPPOSITE = 1e-18


Count = Annotated[int, Meta(ge=1)]


class Grid(Struct, frozen=True, forbid_unknown_fields=True):
    """Copies in rows, columns and storeys, around the object's own position.

    Attributes
    ----------
    grid : (3,) int
        Copies along x, y and z.
    spacing : (3,) float, the scene's units
        Distance between neighbours along x, y and z.

    Raises
    ------
    SceneError
        There are too many copies.
    """

    grid: tuple[Count, Count, Count]
    spacing: Vector

    def __post_init__(self) -> None:
        check_copies(self.count)

    @property
    def count(self) -> int:
        """The number of copies."""
        return math.prod(self.grid)

    def matrices(self, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the (count, 4, 4) float64 transforms, x fastest; `matrix` (4, 4) is that of the object."""
        axes = [
            (np.arange(number) - (number - 1) / 2) * step for number, step in zip(self.grid, self.spacing, strict=True)
        ]
        z, y, x = np.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
        copies = np.repeat(matrix[None], self.count, axis=0)
        copies[:, :3, 3] += np.stack((x, y, z), axis=-1).reshape(-1, 3)
        return copies


class Scatter(Struct, frozen=True, forbid_unknown_fields=True):
    """Copies at random points of another object's surface: as many per area everywhere.

    Attributes
    ----------
    on : str
        The label of the other object.
    count : int
    seed : int
        The same seed gives the same copies; a larger count keeps the first ones.
    scale : float, or (2,) float
        Scale of each copy, on top of the object's own; two numbers: the range that it is drawn from.
        Stored as two numbers.
    align : str
        One of `ALIGNMENTS`: ``up`` leaves the copies upright, ``normal`` tilts their up direction to the surface's
        normal.
    turn : bool
        True: each copy is turned about its up direction by a random angle.

    Raises
    ------
    SceneError
        A value is out of range, or there are too many copies.
    """

    on: str
    count: Count
    seed: Annotated[int, Meta(ge=0)] = 0
    scale: float | tuple[float, float] = 1.0
    align: str = "up"
    turn: bool = True

    def __post_init__(self) -> None:
        low, high = self.scale if isinstance(self.scale, tuple) else (self.scale, self.scale)
        if not 0 < low <= high:
            raise SceneError(f"the scale must be above 0, and the smallest before the largest, not {low:g}, {high:g}")
        force_setattr(self, "scale", (low, high))
        if self.align not in ALIGNMENTS:
            raise SceneError(f"align must be one of {', '.join(ALIGNMENTS)}, not '{self.align}'")
        check_copies(self.count)

    def matrices(
        self, matrix: NDArray[np.float64], vertices: NDArray[np.float64], faces: NDArray[np.int32], up: Vector
    ) -> NDArray[np.float64]:
        """Return the transforms of the copies.

        Parameters
        ----------
        matrix : (4, 4) float64
            The object's own transform, which comes first: the origin that it leads to lies on the surface.
        vertices, faces : (V, 3) float64 and (F, 3) int32
            The surface, in the scene's coordinates.
        up : (3,) float
            The scene's up direction.

        Returns
        -------
        (count, 4, 4) float64

        Raises
        ------
        MeshError
            The surface has no area.
        SceneError
            The up direction is zero.
        """
        # One row of random numbers per copy, so that copy i depends on the seed and on i alone.
        draws = np.random.default_rng(self.seed).random((self.count, DRAWS_PER_POINT + 2))
        points, normals = sample_surface(vertices, faces, draws[:, :DRAWS_PER_POINT], name=self.on)
        if not any(up):
            raise SceneError("up must not be zero: copies stand upright by it")
        # Scaled first: the sum of the squares of large numbers overflows.
        upward = np.asarray(up, np.float64) / max(map(abs, up))
        upward /= np.linalg.norm(upward)
        low, high = self.scale  # type: ignore[misc]
        linear = np.eye(3)[None] * (low + (high - low) * draws[:, -2])[:, None, None]
        if self.turn:
            linear = _turn_about(upward, 2 * np.pi * draws[:, -1]) @ linear
        if self.align == "normal":
            linear = _turn_onto(upward, normals) @ linear
        around = np.zeros((self.count, 4, 4))
        around[:, :3, :3] = linear
        around[:, :3, 3] = points
        around[:, 3, 3] = 1
        return around @ matrix


def check_copies(count: int) -> None:
    """Raise `SceneError` if a scene would have too many instances; for a check before memory is taken."""
    if count > MAX_COPIES:
        raise SceneError(f"{count:,} copies are too many: the limit is {MAX_COPIES:,} in a scene file")
    check_memory(f"{count:,} copies", count * _BYTES_PER_COPY, SceneError)


def _cross_matrix(axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrices (n, 3, 3) of the cross products with (n, 3) vectors."""
    matrices = np.zeros((len(axes), 3, 3))
    matrices[:, 2, 1], matrices[:, 0, 2], matrices[:, 1, 0] = axes.T
    return matrices - matrices.transpose(0, 2, 1)


def _turn_about(axis: NDArray[np.float64], angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotations (n, 3, 3) about one (3,) axis of length 1: Rodrigues' formula."""
    cross = _cross_matrix(axis[None])
    return np.eye(3) + np.sin(angles)[:, None, None] * cross + (1 - np.cos(angles))[:, None, None] * (cross @ cross)


def _turn_onto(begin: NDArray[np.float64], ends: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the shortest rotations (n, 3, 3) that turn a (3,) direction into (n, 3) others, all of length 1."""
    # 1 + cosine, from the sum of the directions: where they are nearly opposite, 1 + dot would cancel.
    versed = ((begin + ends) ** 2).sum(axis=1) / 2
    is_opposite = versed < _OPPOSITE
    cross = _cross_matrix(np.cross(begin, ends))
    turns = np.eye(3) + cross + cross @ cross / np.where(is_opposite, 1.0, versed)[:, None, None]
    # Half a turn about any axis at right angles.
    aside = np.cross(begin, np.eye(3)[np.argmin(np.abs(begin))])
    aside /= np.linalg.norm(aside)
    turns[is_opposite] = 2 * np.outer(aside, aside) - np.eye(3)
    return turns


# Random numbers for each point: one that chooses the triangle, and two for the place on it.
DRAWS_PER_POINT = 3


def sample_surface(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], draws: NDArray[np.float64], *, name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points on triangles, and the normals of their triangles.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int32
    draws : (n, 3) float64
        Random numbers, at least 0 and less than 1. Point i depends on row i alone.
    name : str
        Name of the surface, for messages.

    Returns
    -------
    points : (n, 3) float64
        Uniform over the area; triangles without area have none.
    normals : (n, 3) float64
        Unit normals, on the side from which a triangle's corners run counter-clockwise.

    Raises
    ------
    MeshError
        All triangles together have no area.
    """
    corner = vertices[faces[:, 0]]
    # Edges are halved and scaled to at most 1: products of very large or small numbers would leave float64's range.
    edges = np.stack([vertices[faces[:, end]] / 2 - corner / 2 for end in (1, 2)])
    longest = float(np.abs(edges).max())
    scaled = edges / longest if longest > 0 else edges
    crosses = np.cross(scaled[0], scaled[1])
    areas = np.sqrt((crosses**2).sum(axis=1))
    # Summed in the order of the faces, so that the same draws give the same points everywhere.
    sums = np.cumsum(areas)
    if not sums[-1] > 0:
        raise MeshError(f"{name}: nothing can be scattered on a surface without area")
    # The first sum above the drawn one belongs to a triangle with an area. The total itself is never drawn: a number
    # less than 1 times the total is rounded to less than the total.
    chosen = np.searchsorted(sums, draws[:, 0] * sums[-1], side="right")
    # Points of the parallelogram's other half are turned into the triangle.
    u, v = draws[:, 1, None], draws[:, 2, None]
    is_outside = u + v > 1
    u, v = np.where(is_outside, 1 - u, u), np.where(is_outside, 1 - v, v)
    points = corner[chosen] + 2 * (u * edges[0, chosen] + v * edges[1, chosen])
    return points, crosses[chosen] / areas[chosen, None]
