"""Normals at the corners of faces, smooth where a surface bends a little and sharp along its edges; and tangents.

A picture uses the normals of the file. A mesh without normals is smoothed by the default angle: scans and other fine
meshes look smooth, and solids of few faces, such as those of STL files, keep their edges by the angle itself. Normals
of the faces around a point are weighted by the faces' angles there, as in `topology.py`.

Tangents follow Mikkelsen, "Simulation of wrinkled surfaces revisited", 2008, by whose rules textures of normals are
baked: corners with the same point, normal and texture coordinates share a tangent, the mean of those of their faces
weighted by the faces' angles there. Faces whose texture is mirrored have tangents of their own.
"""

from __future__ import annotations

import math
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from ..support.host_threads import HostThreads
from .appearance.appearance import Appearance, find_flat_normals, make_unchecked, normalize
from .joined_shapes import JoinedMeshes
from .mesh import Mesh
from .topology import NORMALS, EqualPoints, find_corner_faces, find_points

DEFAULT_CREASE_ANGLE = 40.0  # degrees

# A mesh of more faces is not smoothed in pictures, where it has no normals of its own: it would take 1 us and 170 bytes
# a face, and its facets are smaller than pixels.
MOST_SMOOTHED = 1 << 24

# Of cosines, in units of 1.
_ROUNDING = 1e-9


def smooth_normals_by_angle(mesh: Mesh, angle_degrees: float = DEFAULT_CREASE_ANGLE) -> NDArray[np.float32]:
    """Return normals at the corners of faces that do not smooth over edges sharper than an angle.

    The normal at a corner is the mean of the normals of those faces around the point that differ from the corner's own
    face by less than the angle, weighted by their angles at the point. Vertices with equal coordinates are one point,
    so a file may repeat them for each face.

    Parameters
    ----------
    mesh : Mesh
    angle_degrees : float from 0 to 180
        0 gives the normals of the faces themselves; above 90 the mean over all faces around a point, nearly always.

    Returns
    -------
    (F, 3, 3) float32
        Unit vectors on the side from which the corners of faces run anticlockwise. A face without an area has the mean
        over all faces around its corners, or (0, 0, 1) if none has an area.

    Raises
    ------
    ConfigError
        The angle is out of range.

    Notes
    -----
    In O(V log V + F), mostly on all cores; about 0.3 s of processor time for 871,306 faces. Where more than 256 corners
    meet in one point, each is compared with 256 of them.

    Examples
    --------
    >>> import clbvh
    >>> import trimesh
    >>> box = trimesh.creation.box()
    >>> mesh = clbvh.Mesh.from_arrays(box.vertices, box.faces)
    >>> normals = clbvh.smooth_normals_by_angle(mesh, 40)
    >>> float(abs(normals).max(axis=2).min())  # flat: along an axis at each corner
    1.0
    """
    if isinstance(angle_degrees, bool) or not isinstance(angle_degrees, Real) or not 0 <= angle_degrees <= 180:
        raise ConfigError(f"the crease angle must be 0 to 180 degrees, not {angle_degrees!r}")
    return _smooth_faces(mesh.vertices, mesh.faces, mesh.scale, find_points(mesh.vertices), angle_degrees)


def smooth_small(joined: JoinedMeshes, angle_degrees: float) -> NDArray[np.float32]:
    """Return the normals of meshes that are joined, (F, 3, 3): `smooth_normals_by_angle` of each, all at once."""
    # The meshes keep their points to themselves.
    points = find_points(np.column_stack((joined.vertices, joined.owners)))
    vertices = joined.vertices * joined.scales[joined.owners, None]  # exact: by powers of two
    return _smooth_faces(vertices, joined.faces, 1.0, points, angle_degrees)


def _smooth_faces(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    scale: float,
    points: EqualPoints,
    angle_degrees: float,
) -> NDArray[np.float32]:
    count = len(faces)
    normals, angles = np.empty((count, 3), np.float64), np.empty((count, 3), np.float64)
    smooth = np.empty((count, 3, 3), np.float32)
    # At 180 degrees even opposite faces count.
    least_cosine = math.cos(math.radians(angle_degrees)) if angle_degrees < 180 else -2.0
    half_cosine = math.cos(math.radians(angle_degrees) / 2) + _ROUNDING
    tables = faces, normals, angles, *find_corner_faces(points, faces).widened()
    with HostThreads() as threads:
        threads.for_ranges(
            count, lambda first, end: NORMALS.measure_faces(vertices, faces, scale, first, end, normals, angles)
        )
        threads.for_ranges(
            len(points.first),
            lambda first, end: NORMALS.smooth_corners(*tables, least_cosine, half_cosine, first, end, smooth),
        )
    return smooth


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


# A sum of unit vectors is no direction if it is shorter than this.
_LEAST_LENGTH = 1e-6


def find_tangents(mesh: Mesh, normals: NDArray[np.float32], uvs: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return tangents at the corners of faces, and on which side of them v grows.

    Parameters
    ----------
    mesh : Mesh
    normals : (F, 3, 3) float32
        Unit vectors at the corners.
    uvs : (F, 3, 2) float32
        Texture coordinates at the corners; v grows upwards in the texture.

    Returns
    -------
    (F, 3, 4) float32
        Unit vectors at right angles to the normals, and 1, or -1 where the texture is mirrored: v grows along that
        number times the cross product of normal and tangent. Where texture coordinates have no direction, any tangent.

    Notes
    -----
    In O(F log F); about 2.7 s for 871,306 faces on one x86-64 core.
    """
    points = mesh.local_vertices[mesh.faces].astype(np.float64)
    # A factor for all coordinates of a face changes no direction, and no product of these overflows.
    sides = np.asarray(uvs, np.float64)[:, 1:] - np.asarray(uvs, np.float64)[:, :1]
    largest = np.abs(sides).max(axis=(1, 2), initial=0.0, keepdims=True)
    sides = np.divide(sides, largest, out=np.zeros_like(sides), where=largest > 0)
    first, second = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    signs = np.where(sides[:, 0, 0] * sides[:, 1, 1] < sides[:, 0, 1] * sides[:, 1, 0], -1.0, 1.0)
    along_u = signs[:, None] * (sides[:, 1, 1:] * first - sides[:, 0, 1:] * second)

    unit_normals = normals.astype(np.float64)
    flat, has_direction = _flatten(np.broadcast_to(along_u[:, None], points.shape), unit_normals)
    angles = np.empty((mesh.face_count, 3))
    NORMALS.measure_faces(mesh.vertices, mesh.faces, mesh.scale, 0, mesh.face_count, np.empty_like(angles), angles)
    weighted = (np.where(has_direction, angles, 0.0)[..., None] * flat).reshape(-1, 3)
    groups = _find_groups(mesh, normals, uvs, signs)
    sums = np.stack([np.bincount(groups.ids, axis) for axis in weighted.T], axis=-1)
    mean, has_direction = _flatten(sums[groups.ids].reshape(points.shape).astype(np.float64), unit_normals)
    tangents = np.where(has_direction[..., None], mean, _find_any_tangents(unit_normals))
    return np.concatenate((tangents, np.broadcast_to(signs[:, None, None], (*tangents.shape[:2], 1))), axis=2).astype(
        np.float32
    )


def _find_groups(
    mesh: Mesh, normals: NDArray[np.float32], uvs: NDArray[np.float32], signs: NDArray[np.float64]
) -> EqualPoints:
    """Find the corners that share a tangent, (3 F,)."""
    by_point = find_points(mesh.vertices).ids[mesh.faces].reshape(-1)
    by_normal = find_points(normals.reshape(-1, 3).astype(np.float64)).ids
    by_uv = find_points(np.column_stack((uvs.reshape(-1, 2), np.repeat(signs, 3)))).ids
    return find_points(np.column_stack((by_point, by_normal, by_uv)).astype(np.float64))


def _flatten(
    vectors: NDArray[np.float64], normals: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return unit vectors at right angles to normals, and whether there are any that the vectors give."""
    unit, is_direction = normalize(vectors)
    flat = unit - np.einsum("...i,...i->...", unit, normals)[..., None] * normals
    lengths = np.linalg.norm(flat, axis=-1)
    is_direction = is_direction & (lengths > _LEAST_LENGTH)
    return flat / np.where(is_direction, lengths, 1.0)[..., None], is_direction


def _find_any_tangents(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vectors at right angles to normals."""
    axes = np.eye(3)[np.abs(normals).argmin(axis=-1)]
    return np.asarray(normalize(np.cross(normals, axes))[0], np.float64)
