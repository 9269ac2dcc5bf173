"""Boxes as a mesh, so that any builder builds a tree over them: over spheres, or over the instances of a scene.

A builder sees the boxes of triangles and nothing else. A triangle between two opposite corners of a box has that box.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..support.compiled import compiled
from .mesh import Mesh
from .spheres import Shape, Spheres

# A box grows by this share of the largest half side of all boxes, which is at most 1 in local coordinates and at least
# 1/2 there: rounding a coordinate to float32 moves it by 2^-25 of that at most.
_GROWTH = 2.0**-23


def box_mesh(lower: NDArray[np.float64], upper: NDArray[np.float64], name: str) -> Mesh:
    """Return a mesh whose triangle i is a diagonal of box i.

    Parameters
    ----------
    lower, upper : (n, 3) float64
        Corners of the boxes, at least one, with ``lower <= upper``.
    name : str
        For messages.

    Returns
    -------
    Mesh
        Of n degenerate triangles. In local coordinates, the box of each contains what float64 has of its box.

    Raises
    ------
    MeshError
        A corner is not finite, or the boxes together are too small or too large, see `Mesh.from_arrays`.
    """
    least, greatest = lower.min(axis=0), upper.max(axis=0)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused by the mesh
        growth = _GROWTH * float(np.max(greatest / 2 - least / 2))
        corners = np.stack((lower - growth, upper + growth), axis=1).reshape(-1, 3)
    first = 2 * np.arange(len(lower), dtype=np.int32)
    return Mesh.from_arrays(corners, np.stack((first, first + 1, first), axis=1), name=name)


# A box grows by this share of its sphere's radius: the rounding of the sphere test, see docs/internals/padding.md.
_MARGIN = 2.0**-18

# The share of a coordinate that rounding it to float32 moves it by, a little more than 2^-24; and the same of numbers
# below the normal ones.
_ROUNDING, _LEAST_ROUNDING = 2.0**-24 + 2.0**-40, 2.0**-149


def mesh_of(shape: Shape) -> Mesh:
    """Return the mesh over which the tree of a shape is built: a mesh itself, and the boxes of spheres."""
    return shape if isinstance(shape, Mesh) else sphere_boxes(shape)


def sphere_boxes(spheres: Spheres) -> Mesh:
    """Return a mesh whose triangle i is a diagonal of the box of sphere i.

    Parameters
    ----------
    spheres : Spheres

    Returns
    -------
    Mesh
        Of degenerate triangles, with the origin and the scale of the spheres. The box of each triangle contains the
        local sphere and a margin of 2^-18 of its radius; no local coordinate is beyond -1 or 1.

    Notes
    -----
    O(n), in this thread: about 20 ms for 1,000,000 spheres. 84 bytes per sphere.
    """
    count = spheres.prim_count
    local = np.empty((2 * count, 3), np.float32)
    vertices = np.empty((2 * count, 3), np.float64)
    faces = np.empty((count, 3), np.int32)
    _write_boxes(
        spheres.local_centres, spheres.local_radii, spheres.origin, 1.0 / spheres.scale, local, vertices, faces
    )
    return Mesh(vertices, faces, local, spheres.origin, spheres.scale, spheres.name)


@compiled
def sphere_reach(radius):
    """Return how far the box of a sphere reaches from its centre, before rounding: float64, local coordinates."""
    return radius * (1.0 + _MARGIN)


@compiled
def bound_sphere(centre, reach):
    """Return the least and the greatest coordinate of a sphere's box along an axis: float32, rounded outwards."""
    lower = np.float64(centre) - reach
    upper = np.float64(centre) + reach
    return (
        np.float32(lower - (abs(lower) * _ROUNDING + _LEAST_ROUNDING)),
        np.float32(upper + (abs(upper) * _ROUNDING + _LEAST_ROUNDING)),
    )


@compiled
def _write_boxes(centres, radii, origin, unit, local, vertices, faces):
    """Write the corners of each box, in local coordinates and in the spheres' own, and the triangle between them."""
    for sphere in range(len(radii)):
        reach = sphere_reach(radii[sphere])
        for axis in range(3):
            local_lower, local_upper = bound_sphere(centres[sphere, axis], reach)
            local[2 * sphere, axis], local[2 * sphere + 1, axis] = local_lower, local_upper
            vertices[2 * sphere, axis] = local_lower * unit + origin[axis]
            vertices[2 * sphere + 1, axis] = local_upper * unit + origin[axis]
        faces[sphere, 0], faces[sphere, 1], faces[sphere, 2] = 2 * sphere, 2 * sphere + 1, 2 * sphere
