"""Which normals a picture uses: those of the file, or smooth ones that end at edges.

A mesh without normals is smoothed by the default angle: scans and other fine meshes look smooth, and solids of few
faces, such as those of STL files, keep their edges by the angle itself. What a file declares flat (`s off` in OBJ) has
flat normals when it comes from its reader.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..mesh import Mesh
from .smooth_normals import DEFAULT_CREASE_ANGLE, smooth_normals_by_angle


def find_corner_normals(mesh: Mesh, angle_degrees: float | None = None) -> NDArray[np.float32]:
    """Return the normals at the corners of a mesh's faces, (F, 3, 3) float32 unit vectors.

    Parameters
    ----------
    mesh : Mesh
    angle_degrees : float, optional
        Smooth normals by this angle, also where the mesh has normals of its own. None: those of the mesh, or smooth
        ones by 40 degrees if it has none.

    Raises
    ------
    ConfigError
        See `smooth_normals_by_angle`.

    Examples
    --------
    >>> import clbvh
    >>> from clbvh.geometry.appearance.find_normals import find_corner_normals
    >>> find_corner_normals(clbvh.make_shape("icosphere", triangles=320)).shape
    (320, 3, 3)
    """
    if angle_degrees is None and mesh.appearance is not None and mesh.appearance.normals is not None:
        return mesh.appearance.normals
    return smooth_normals_by_angle(mesh, DEFAULT_CREASE_ANGLE if angle_degrees is None else angle_degrees)
