"""Procedural spheres: the same name, count and seed give the same spheres, and no file is needed.

Owns the table of the generators and the checks of their arguments, like `make_shape` for meshes.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable

import numpy as np

from ...errors import ConfigError
from ...support.memory import check_memory
from ..mesh import MAX_FACE_COUNT
from .galaxy import make_galaxy
from .sphere_set import SphereSet
from .weekend import make_weekend

SPHERE_SETS: dict[str, Callable[..., SphereSet]] = {"galaxy": make_galaxy, "weekend": make_weekend}

# While the spheres are made: their random numbers, and twice their centres and radii.
_BYTES_PER_SPHERE = 300


def make_spheres(name: str, *, count: int, seed: int = 0, **options: float) -> SphereSet:
    """Make procedural spheres.

    Parameters
    ----------
    name : str
        One of `SPHERE_SETS`.
    count : int
        From 1.
    seed : int, optional
        From 0; another seed gives another set of the same kind.
    **options : float
        Of the set, with these defaults:

        - `galaxy`: a spiral galaxy in the plane of x and z: ``arms=2`` with ``winding=2.6`` radians for each factor of
          e in distance, ``radius=10`` of the disk, ``thickness=0.03`` of it in radii, ``bulge=0.18``, the share of the
          spheres in the middle; ``size=1`` scales the spheres, which are the smaller the more there are.
        - `weekend`: a ground, three large spheres of glass, chalk and metal, and around them small ones of all three,
          none of which touches another; without options. With 480 spheres about the last scene of Peter Shirley's book
          "Ray Tracing in One Weekend".

    Returns
    -------
    SphereSet
        Centres (count, 3) float64, radii (count,) float64, materials and (count,) int32 material ids; a galaxy has no
        materials.

    Raises
    ------
    ConfigError
        No such set or option, a value outside its range, or more spheres than fit the memory.

    Examples
    --------
    >>> from clbvh.geometry.shapes.make_spheres import make_spheres
    >>> made = make_spheres("galaxy", count=1000, seed=4)
    >>> made.centres.shape, made.radii.shape
    ((1000, 3), (1000,))
    """
    known = list_spheres_options(name)
    for key, value in options.items():
        if key not in known:
            raise ConfigError(f"the spheres '{name}' have no option '{key}': they have {', '.join(known)}")
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
            raise ConfigError(f"the option '{key}' of the spheres '{name}' must be a number from 0, not {value!r}")
    for key, number, least in (("count", count, 1), ("seed", seed, 0)):
        if isinstance(number, bool) or not isinstance(number, int | np.integer) or number < least:
            raise ConfigError(f"{key} must be a whole number from {least}, not {number!r}")
    if count > MAX_FACE_COUNT:
        raise ConfigError(f"{count:,} spheres are too many: the limit is {MAX_FACE_COUNT:,}")
    check_memory(f"{count:,} spheres", int(count) * _BYTES_PER_SPHERE, ConfigError)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused by the spheres
        return SPHERE_SETS[name](int(count), np.random.default_rng(int(seed)), **options)


def list_spheres_options(name: str) -> tuple[str, ...]:
    """Return the names of a set's own options; raise `ConfigError` if there is no such set."""
    if name not in SPHERE_SETS:
        raise ConfigError(f"there are no spheres '{name}': take one of {', '.join(SPHERE_SETS)}")
    return tuple(key for key in inspect.signature(SPHERE_SETS[name]).parameters if key not in ("count", "generator"))
