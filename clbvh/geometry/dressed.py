"""Shapes in another material: the same geometry, whose trees are the same, with other looks."""

from __future__ import annotations

import copy
from typing import TypeVar

from .appearance.appearance import make_unchecked
from .appearance.material import Material
from .mesh import Mesh
from .spheres import Spheres

_Shape = TypeVar("_Shape", Mesh, Spheres)


def with_material(shape: _Shape, material: Material) -> _Shape:
    """Return a shape all of whose primitives have one material.

    Parameters
    ----------
    shape : Mesh or Spheres
        Its normals and texture coordinates are kept; its colours and materials are not.
    material : Material

    Returns
    -------
    Mesh or Spheres
        Shares all arrays with the given one.

    Examples
    --------
    >>> import clbvh
    >>> from clbvh.geometry.dressed import with_material
    >>> ball = clbvh.make_shape("icosphere", triangles=320)
    >>> with_material(ball, clbvh.Material(metallic=1.0)).appearance
    Appearance(materials=1)
    """
    looks = shape.appearance
    normals, uvs = (None, None) if looks is None else (looks.normals, looks.uvs)
    # Neither by a constructor, which would copy the arrays and check them again.
    dressed = copy.copy(shape)
    appearance = make_unchecked(normals=normals, uvs=uvs, colours=None, materials=(material,), material_ids=None)
    object.__setattr__(dressed, "appearance", appearance)
    return dressed
