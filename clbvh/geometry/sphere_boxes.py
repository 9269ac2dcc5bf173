"""The boxes of spheres as a mesh, so that any builder builds a tree over spheres.

A builder sees the boxes of triangles and nothing else. A triangle between two opposite corners of a box has that box.
"""

from __future__ import annotations

import numpy as np

from ..support.compiled import compiled
from .mesh import Mesh
from .shape import Shape
from .spheres import Spheres

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
