"""Objects of a scene file: their sources, their copies, and how they are loaded and placed in a scene.

Objects of the same source share one geometry, and its tree. Copies may stand on random points of a surface, as many per
area everywhere: Osada, Funkhouser, Chazelle and Dobkin, "Shape Distributions", 2002, section 3.1. Must not know the
file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError, InternalError, MeshError, SceneError
from ..geometry.appearance.material import Material
from ..geometry.loading.spheres_file import SPHERES_SUFFIXES, read_spheres
from ..geometry.mesh import Mesh
from ..geometry.shapes.make_spheres import make_spheres
from ..geometry.spheres import Spheres
from ..scene.handles import ALL_BITS, Geometry
from ..scene.store import UniqueNames
from ..support.memory import check_memory
from .guesses import known_up
from .scene import MeshSource, Scene
from .vectors import Vector, check_vector


@dataclass(frozen=True, eq=False)
class SceneObject:
    """A mesh or spheres, placed in a scene once or many times.

    Attributes
    ----------
    label : str
        Of this object alone.
    source : MeshSource or SpheresSource
    matrix : (4, 4) float64
        From the source's coordinates to the scene's; of each copy before the copy itself is moved.
    repeat : Grid, Scatter or None
    colour : (3,) float, or None
        Linear. None: the scene's `surface`.
    material : Material, or None
        None: those of the source.
    mask : int
        32 bits: rays see the object whose mask has a bit of it.
    """

    label: str
    source: MeshSource | SpheresSource
    matrix: NDArray[np.float64]
    repeat: Grid | Scatter | None = None
    colour: Vector | None = None
    mask: int = ALL_BITS
    material: Material | None = None

    @property
    def count(self) -> int:
        """The number of copies."""
        return 1 if self.repeat is None else self.repeat.count


@dataclass(frozen=True)
class SpheresSource:
    """The source of spheres: exactly one of `path`, `generator` and `centres`.

    Attributes
    ----------
    path : str
        An NPZ or CSV file, see `read_spheres`.
    generator : str
        A procedural set, with `count`, `seed` and its own `options`.
    centres : tuple of (3,) float
    radii : float, or tuple of float
        One for all spheres, or one each. None where the file has radii, or the set.

    Raises
    ------
    SceneError
        Radii are missing, or given twice.
    """

    path: str | None = None
    generator: str | None = None
    count: int = 100_000
    seed: int = 0
    options: dict[str, float] = field(default_factory=dict)
    centres: tuple[tuple[float, ...], ...] | None = None
    radii: float | tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.centres is not None and self.radii is None:
            raise SceneError("centres need radii: one for all of them, or a list with one for each")
        if isinstance(self.radii, tuple) and len(self.radii) != len(self.centres or ()):
            raise SceneError(f"{len(self.radii)} radii do not fit {len(self.centres or ())} centres")

    @property
    def name(self) -> str:
        """The name of the spheres where the scene has no label."""
        return Path(self.path).stem if self.path is not None else self.generator or "spheres"

    def load(self) -> Spheres:
        """Return the spheres; raise `MeshError`, `ConfigError` or `SceneError` if there are none."""
        if self.generator is not None:
            made = make_spheres(self.generator, count=self.count, seed=self.seed, **self.options)
            looks = {"materials": made.materials, "material_ids": made.material_ids}
            return Spheres.from_arrays(made.centres, made.radii, name=self.name, **looks)
        if self.centres is not None:
            return Spheres.from_arrays(np.array(self.centres), np.array(self.radii), name=self.name)
        centres, radii = read_spheres(str(self.path))
        if radii is not None and self.radii is not None:
            raise SceneError(f"{self.path}: the file has its own radii: leave 'radii' out")
        if radii is not None:
            return Spheres.from_arrays(centres, radii, name=self.name)
        if self.radii is None:
            raise SceneError(f"{self.path}: the file has no radii: give 'radii', one for all")
        return Spheres.from_arrays(centres, self.radii, name=self.name)


def is_spheres_file(name: str) -> bool:
    """Return whether a text names a file of spheres, rather than a procedural set."""
    return Path(name).suffix.lower() in SPHERES_SUFFIXES or Path(name).name != name


# Copies of all objects of a scene: 128 MB of matrices. Each costs some microseconds of Python, too.
MAX_COPIES = 1_000_000

# Random numbers, matrices and their products while copies are placed, and the handle and the name of an instance.
_BYTES_PER_COPY = 1000

ALIGNMENTS = ("up", "normal")

# Opposite directions have no shortest rotation between them. Below this value of 1 + cosine they count as opposite.
_OPPOSITE = 1e-18


@dataclass(frozen=True)
class Grid:
    """Copies in rows, columns and storeys, around the object's own position.

    Attributes
    ----------
    counts : (3,) int
        Along x, y and z.
    spacing : (3,) float, the scene's units
        Between neighbours.

    Raises
    ------
    SceneError
        A count is less than 1, there are too many copies, or a spacing is not finite.
    """

    counts: tuple[int, int, int]
    spacing: Vector

    def __post_init__(self) -> None:
        if min(self.counts) < 1:
            raise SceneError(f"a grid needs counts from 1, not {list(self.counts)}")
        check_vector("the grid's spacing", self.spacing)
        check_copies(self.count)

    @property
    def count(self) -> int:
        """The number of copies."""
        return math.prod(self.counts)

    def matrices(self, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the (count, 4, 4) float64 transforms, x fastest; `matrix` (4, 4) is that of the object."""
        axes = [
            (np.arange(number) - (number - 1) / 2) * step
            for number, step in zip(self.counts, self.spacing, strict=True)
        ]
        z, y, x = np.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
        copies = np.repeat(matrix[None], self.count, axis=0)
        copies[:, :3, 3] += np.stack((x, y, z), axis=-1).reshape(-1, 3)
        return copies


@dataclass(frozen=True)
class Scatter:
    """Copies at random points of another object's surface: as many per area everywhere.

    Attributes
    ----------
    on : str
        The label of the other object.
    count : int
    seed : int
        The same seed gives the same copies; a larger count keeps the first ones.
    scale : (2,) float
        The smallest and the largest scale of a copy, on top of the object's own.
    align : str
        One of `ALIGNMENTS`: ``up`` leaves the copies upright, ``normal`` tilts their up direction to the surface's
        normal.
    turn : bool
        Whether each copy is turned about its up direction, by a random angle.

    Raises
    ------
    SceneError
        A value is out of range, or there are too many copies.
    """

    on: str
    count: int
    seed: int = 0
    scale: tuple[float, float] = (1.0, 1.0)
    align: str = "up"
    turn: bool = True

    def __post_init__(self) -> None:
        if self.count < 1:
            raise SceneError(f"a scatter needs a count from 1, not {self.count}")
        if self.seed < 0:
            raise SceneError(f"the scatter's seed must be from 0, not {self.seed}")
        low, high = self.scale
        if not 0 < low <= high < math.inf:
            raise SceneError(f"the scatter's scale must be two numbers, 0 < smallest <= largest, not {[low, high]}")
        if self.align not in ALIGNMENTS:
            raise SceneError(f"the scatter's align must be one of {', '.join(ALIGNMENTS)}, not '{self.align}'")
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
            raise SceneError("the camera's up must not be zero: copies stand upright by it")
        # Not by the sum of the squares, which may leave float64.
        upward = np.asarray(up, np.float64) / max(map(abs, up))
        upward /= np.linalg.norm(upward)
        low, high = self.scale
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


def load_objects(scene: Scene, objects: Sequence[SceneObject]) -> None:
    """Load objects and place them in a scene, in their order.

    The instances of an object are named after its label: ``tree``, ``tree 2``, ``tree 3``.

    Parameters
    ----------
    scene : Scene
        Changed.
    objects : sequence of SceneObject
        As `read_objects` returns them.

    Raises
    ------
    MeshError, SceneError, ConfigError
        A source cannot be loaded, or a transform cannot be used; the message names the object.
    """
    names = UniqueNames("an object")
    for found in objects:
        names.add(found.label)
    geometries: list[tuple[SceneObject, Geometry]] = []
    for found in objects:
        try:
            geometry = _add(scene, found, geometries)
            geometries.append((found, geometry))
            # Products of numbers that are too large are not finite, and refused when they are placed.
            with np.errstate(over="ignore", invalid="ignore"):
                matrices = _place(found, geometries, scene)
            copies = [found.label, *(names.add_numbered(found.label) for _ in range(1, len(matrices)))]
            scene.place_many(
                geometry, matrices, names=copies, mask=found.mask, colour=found.colour, material=found.material
            )
        except (MeshError, SceneError, ConfigError) as error:
            raise type(error)(f"the object '{found.label}': {error}") from error


def _add(scene: Scene, found: SceneObject, others: list[tuple[SceneObject, Geometry]]) -> Geometry:
    """Return the geometry of an object: that of another one with the same source, or a new one."""
    for other, geometry in others:
        if other.source == found.source:
            return geometry
    return scene.add(found.source.load(), name=found.label)


def _place(found: SceneObject, geometries: list[tuple[SceneObject, Geometry]], scene: Scene) -> NDArray[np.float64]:
    """Return the transforms of an object's copies, (n, 4, 4)."""
    if found.repeat is None:
        return found.matrix[None]
    if not isinstance(found.repeat, Scatter):
        return found.repeat.matrices(found.matrix)
    target, geometry = next(pair for pair in geometries if pair[0].label == found.repeat.on)
    surface = geometry.shape
    if not isinstance(surface, Mesh):
        raise InternalError(f"copies are scattered on '{target.label}', which is {surface!r} and no mesh")
    vertices = surface.vertices @ target.matrix[:3, :3].T + target.matrix[:3, 3]
    if not np.isfinite(vertices).all():
        raise MeshError(f"the surface of '{target.label}' has coordinates that are not finite in the scene")
    faces = surface.faces
    # A mirrored triangle is seen from its other side, unless its corners are turned round.
    if np.linalg.slogdet(target.matrix[:3, :3])[0] < 0:
        faces = faces[:, ::-1]
    return found.repeat.matrices(found.matrix, vertices, faces, known_up(scene.up))


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
        Of the surface, for messages.

    Returns
    -------
    points : (n, 3) float64
        Uniform over the area; triangles without area have none.
    normals : (n, 3) float64
        Of length 1, on the side from which a triangle's corners run counter-clockwise.

    Raises
    ------
    MeshError
        All triangles together have no area.
    """
    corner = vertices[faces[:, 0]]
    # Edges are halved, and scaled to at most 1: products of float64's largest and smallest numbers have no room in it.
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
