"""Procedural meshes: the same name, size and seed give the same mesh, and no file is needed.

Owns the table of the shapes and the checks of their arguments; each shape chooses its resolution for the wanted number
of triangles. All of them are float64 numpy on whole arrays: 871,200 triangles take about a second.

The random numbers come from numpy's PCG64, whose stream is the same everywhere. Sines and powers may differ in the
last bit between processors, and so may coordinates.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping

import numpy as np

from ...errors import ConfigError, MeshError
from ..mesh import Mesh, check_face_count
from .palace import make_palace
from .solids import Solid, make_blobs, make_boxes, make_cube, make_icosphere, make_square
from .terrain import make_knot, make_terrain

SHAPES: dict[str, Callable[..., Solid]] = {
    "knot": make_knot,
    "terrain": make_terrain,
    "blobs": make_blobs,
    "boxes": make_boxes,
    "icosphere": make_icosphere,
    "palace": make_palace,
    "square": make_square,
    "cube": make_cube,
}


def make_shape(name: str, *, triangles: int, seed: int = 0, **options: float) -> Mesh:
    """Make a procedural mesh.

    Parameters
    ----------
    name : str
        One of `SHAPES`.
    triangles : int
        The wanted number. The mesh has the largest number the shape can have that is not above it.
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
        - `boxes`: a cloud of overlapping boxes at any angle; the same options. Multiples of 12.
        - `icosphere`: the unit sphere, closed. 20 n^2.
        - `palace`: halls with columns, stairs, windows and vases, y up, in metres: a scene with huge, long thin and
          tiny triangles. Not closed. Up to a few hundred triangles fewer than wanted.
        - `square`: of side 1 around the origin, facing up. Open. 2.
        - `cube`: of side 1 around the origin. 12.

    Returns
    -------
    Mesh
        Named after the shape.

    Raises
    ------
    ConfigError
        No such shape or option, a value outside its range, fewer triangles than the shape needs, or more than fit the
        memory.
    MeshError
        The options are so large that a coordinate is not finite.

    Examples
    --------
    >>> import clbvh
    >>> clbvh.make_shape("knot", triangles=871_200, seed=1).face_count
    871200
    >>> clbvh.make_shape("icosphere", triangles=1000).face_count
    980
    """
    check_options(f"shape '{name}'", list_options("is no shape", SHAPES, name), options)
    check_whole(triangles=(triangles, 0), seed=(seed, 0))
    try:
        check_face_count(int(triangles))
    except MeshError as error:
        raise ConfigError(f"the shape '{name}' cannot be made: {error}") from error
    with np.errstate(over="ignore", invalid="ignore"):  # coordinates that are not finite are refused below
        vertices, faces = SHAPES[name](int(triangles), np.random.default_rng(int(seed)), **options)
    return Mesh.from_arrays(vertices, faces, name=name)


def check_options(subject: str, known: tuple[str, ...], options: dict[str, float]) -> None:
    """Raise `ConfigError` unless options have known names and are numbers from 0."""
    for key, value in options.items():
        if key not in known:
            raise ConfigError(f"the {subject} has no option '{key}': it has {', '.join(known) or 'none'}")
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
            raise ConfigError(f"the option '{key}' of the {subject} must be a number from 0, not {value!r}")


def check_whole(**numbers: tuple[int, int]) -> None:
    """Raise `ConfigError` unless each number is a whole one, and at least the one beside it."""
    for key, (number, least) in numbers.items():
        if isinstance(number, bool) or not isinstance(number, int | np.integer) or number < least:
            raise ConfigError(f"{key} must be a whole number from {least}, not {number!r}")


def list_options(phrase: str, makers: Mapping[str, Callable[..., object]], name: str) -> tuple[str, ...]:
    """Return the names of a maker's own options; raise `ConfigError` with the phrase if there is no such maker."""
    if name not in makers:
        raise ConfigError(f"there {phrase} '{name}': take one of {', '.join(makers)}")
    return tuple(inspect.signature(makers[name]).parameters)[2:]  # behind the number and the generator
