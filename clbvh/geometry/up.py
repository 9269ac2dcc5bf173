"""Which way is up in a mesh: by the rule of its format, by what it would stand on, or by the habit of its format.

Only y and z are considered: programs use one of the two.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .mesh import Mesh

Y_UP, Z_UP = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

_Y, _Z = 1, 2
_NAMES = "xyz"
_UPS = {_Y: Y_UP, _Z: Z_UP}

# Formats whose rule is to have y up, and the habits of those without a rule: STL comes from CAD and goes to printers.
RULED_SUFFIXES = (".gltf", ".glb")
_HABITS = {"stl": _Z, "off": _Z}

# Triangles looked at; the result is the same for any number from about 1,000 of the bunny and the dragon of Stanford.
_MAX_TRIANGLES = 50_000

# Shares of the points that are taken for strays at either end of an axis.
_STRAYS = 0.001

# A mesh stands on what lies in this share of its height above its lowest point.
_CONTACT = 0.02

# What a mesh stands on spans at least this share of it both ways, and this many times as much as on the other axis.
_LEAST_BASE, _MARGIN = 0.2, 2.0

# Nothing stands on less than this share of its own height: a rifle on its butt has 0.02, a man on his feet 0.06.
_LEAST_WIDTH = 0.04

# What is this many times as high as it is wide, and would fall over, is not upright by the habit of a format.
_TOPPLING = 2.0

# A mesh whose height is below this share of its sides is flat like a landscape.
_FLAT = 0.2


class Up(NamedTuple):
    """The direction that is up, and why, as a sentence without its full stop.

    It is a guess where something speaks for it; neither the rule of a format nor y for lack of a reason is one.
    """

    vector: tuple[float, float, float]
    reason: str
    is_guess: bool


def find_up(source_format: str, mesh: Mesh) -> Up:
    """Return the direction that is up in a mesh.

    Parameters
    ----------
    source_format : str
        Of the mesh's file: ``"stl"``, also as the end of a name, ``".STL"``; empty for a mesh of no file.
    mesh : Mesh

    Returns
    -------
    vector : (3,) float
        (0, 1, 0) or (0, 0, 1).
    reason : str
        For the user.
    is_guess : bool
        False for the rule of a format, and for y where nothing speaks for either.

    Examples
    --------
    >>> import clbvh
    >>> import trimesh
    >>> from clbvh.geometry.up import find_up
    >>> cone = trimesh.creation.cone(radius=1, height=2)
    >>> find_up("obj", clbvh.Mesh.from_arrays(cone.vertices, cone.faces))
    Up(vector=(0.0, 0.0, 1.0), reason='z is up: the mesh stands on a wide base along z, but not along y', is_guess=True)
    >>> find_up("glb", clbvh.make_shape("icosphere", triangles=320)).reason
    'y is up: that is the rule of glTF files'
    """
    kind = source_format.lower().lstrip(".")
    if f".{kind}" in RULED_SUFFIXES:
        return _say(_Y, "that is the rule of glTF files", is_guess=False)
    return guess_up(mesh, kind)


def guess_up(mesh: Mesh, source_format: str = "") -> Up:
    """Return the direction that is probably up in a mesh whose format has no rule; see `find_up`."""
    return guess_up_of_points(sample_points(mesh), source_format)


def guess_up_of_points(points: NDArray[np.float64], source_format: str = "") -> Up:
    """Return the direction that is probably up in points on a surface, (n, 3)."""
    lower, upper = np.quantile(points, [_STRAYS, 1 - _STRAYS], axis=0)
    sides = upper - lower
    for axis in (_Z, _Y):
        if 0 < sides[axis] < _FLAT * np.delete(sides, axis).min():
            return _say(axis, f"the mesh is flat along {_NAMES[axis]}, like a landscape")
    bases = {axis: _find_base(points, lower, sides, axis) for axis in (_Y, _Z)}
    for axis, other in ((_Y, _Z), (_Z, _Y)):
        if bases[axis] >= max(_LEAST_BASE, _MARGIN * bases[other]):
            names = f"along {_NAMES[axis]}, but not along {_NAMES[other]}"
            return _say(axis, f"the mesh stands on a wide base {names}")
    kind = source_format.lower().lstrip(".")
    if kind not in _HABITS:
        return _say(_Y, "nothing in its shape says otherwise", is_guess=False)
    usual, other = _HABITS[kind], _Z if _HABITS[kind] == _Y else _Y
    if bases[usual] == 0 and sides[usual] > _TOPPLING * np.delete(sides, usual).max():
        return _say(other, f"the mesh is long along {_NAMES[usual]}, and would not stand on its end")
    return _say(usual, f"most {kind.upper()} files have it so, and nothing in its shape says otherwise")


def _say(axis: int, reason: str, *, is_guess: bool = True) -> Up:
    return Up(_UPS[axis], f"{_NAMES[axis]} is up: {reason}", is_guess)


def sample_points(mesh: Mesh, most: int = _MAX_TRIANGLES) -> NDArray[np.float64]:
    """Return the corners of at most `most` faces, (n, 3) in local units, spread evenly over the list of faces."""
    step = -(-mesh.face_count // most)
    return mesh.local_vertices[mesh.faces[::step].ravel()].astype(np.float64)


def _find_base(points: NDArray[np.float64], lower: NDArray[np.float64], sides: NDArray[np.float64], axis: int) -> float:
    """Return the share of the mesh's sides that its lowest points span, both ways; 0 if it would fall over."""
    if not (sides > 0).all():
        return 0.0
    low = points[points[:, axis] <= lower[axis] + _CONTACT * sides[axis]]
    across = [other for other in range(3) if other != axis]
    begin, end = np.quantile(low[:, across], [_CONTACT, 1 - _CONTACT], axis=0)
    centre = points[:, across].mean(axis=0)
    is_wide = (end - begin >= _LEAST_WIDTH * sides[axis]).all()
    is_standing = is_wide and ((begin < centre) & (centre < end)).all()
    return float(np.min((end - begin) / sides[across])) if is_standing else 0.0
