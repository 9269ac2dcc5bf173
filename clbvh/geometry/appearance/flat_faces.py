"""Faces that a file declares flat, in a mesh whose other normals follow from its shape."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..mesh import Mesh
from .appearance import Appearance, make_unchecked
from .flat_normals import find_flat_normals
from .smooth_normals import smooth_normals_by_angle


def flatten(mesh: Mesh, faces: NDArray[np.bool_]) -> Appearance:
    """Return the appearance of a mesh with flat normals on some faces, and smooth ones on the rest.

    Parameters
    ----------
    mesh : Mesh
    faces : (F,) bool
        Those that are flat.
    """
    flat = np.repeat(find_flat_normals(mesh.vertices[mesh.faces[faces]])[:, None], 3, axis=1)
    if faces.all():
        normals = flat
    else:
        normals = smooth_normals_by_angle(mesh)
        normals[faces] = flat
    return make_unchecked(**(vars(mesh.appearance or Appearance()) | {"normals": normals}))
