"""Normals at the corners of faces: smooth where a surface bends a little, and sharp along its edges.

The normals of the faces around a point are weighted by the faces' angles there, as in `vertex_normals.py`.
"""

from __future__ import annotations

import math
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError
from ...support.compiled import compiled
from ...support.host_threads import HostThreads
from ..corners import measure_corner
from ..mesh import Mesh
from ..vertex_faces import find_vertex_faces

DEFAULT_CREASE_ANGLE = 40.0  # degrees

# Corners at one point that are compared with each other, all with all. Where there are more, the normals are gathered
# in a grid of directions first: the point of a cone of a million faces would take hours.
_MOST_COMPARED = 256
_GRID = 32  # cells along a side of the octahedral map, so that a cell is about 5 degrees wide

# A sum of unit vectors is no direction if it is shorter than this share of their weights.
_LEAST_SHARE = 1e-6

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
    meet in one point, differences of normals are measured between cells of about 5 degrees.

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
    normals = np.empty((mesh.face_count, 3), np.float64)
    angles = np.empty((mesh.face_count, 3), np.float64)
    point_ids, begin, around = find_vertex_faces(mesh)
    smooth = np.empty((mesh.face_count, 3, 3), np.float32)
    # At 180 degrees even opposite faces count.
    least_cosine = math.cos(math.radians(angle_degrees)) if angle_degrees < 180 else -2.0
    half_cosine = math.cos(math.radians(angle_degrees) / 2) + _ROUNDING
    tables = mesh.faces, normals, angles, point_ids, begin, around
    with HostThreads() as threads:
        threads.for_ranges(
            mesh.face_count,
            lambda first, end: _find_faces(mesh.vertices, mesh.faces, mesh.scale, first, end, normals, angles),
        )
        threads.for_ranges(
            len(begin) - 1, lambda first, end: _smooth(*tables, least_cosine, half_cosine, first, end, smooth)
        )
    return smooth


@compiled(error_model="numpy")
def _find_faces(vertices, faces, scale, begin, end, normals, angles):
    """Write the unit normals of some faces, zero without an area, and the angles at their corners."""
    for face in range(begin, end):
        for corner in range(3):
            nx, ny, nz, length, angles[face, corner] = measure_corner(vertices, faces, scale, face, corner)
            if corner == 0:
                unit = 1.0 if length == 0.0 else length
                normals[face, 0], normals[face, 1], normals[face, 2] = nx / unit, ny / unit, nz / unit


@compiled(error_model="numpy")
def _smooth(
    faces, normals, angles, point_ids, begin, around, least_cosine, half_cosine, first_point, end_point, smooth
):
    """Write the normals at the corners in some points."""
    cells = np.empty(_GRID * _GRID, np.int64)
    sums = np.empty((_GRID * _GRID, 4))
    cell_of = np.full(_GRID * _GRID, -1)
    for point in range(first_point, end_point):
        first, end = begin[point], begin[point + 1]
        # Where all normals are within half the angle of one, no two differ by more: nearly everywhere, nearly always.
        x, y, z = 0.0, 0.0, 0.0
        for slot in range(first, end):
            face = around[slot]
            angle = _angle_at(faces, angles, point_ids, face, point)
            x, y, z = x + angle * normals[face, 0], y + angle * normals[face, 1], z + angle * normals[face, 2]
        length = math.sqrt(x * x + y * y + z * z)
        is_smooth = length > 0.0
        for slot in range(first, end):
            face = around[slot]
            cosine = x * normals[face, 0] + y * normals[face, 1] + z * normals[face, 2]
            if not cosine > half_cosine * length:
                is_smooth = False
                break
        if is_smooth:
            for slot in range(first, end):
                _store(faces, point_ids, around[slot], point, x / length, y / length, z / length, smooth)
            continue
        cell_count = 0
        if end - first > _MOST_COMPARED:
            cell_count = _gather(faces, normals, angles, point_ids, around, first, end, point, cells, cell_of, sums)
        for slot in range(first, end):
            face = around[slot]
            nx, ny, nz = normals[face, 0], normals[face, 1], normals[face, 2]
            has_area = nx != 0.0 or ny != 0.0 or nz != 0.0
            least = least_cosine if has_area else -2.0
            x, y, z, weight = 0.0, 0.0, 0.0, 0.0
            if cell_count == 0:
                for other_slot in range(first, end):
                    other = around[other_slot]
                    ox, oy, oz = normals[other, 0], normals[other, 1], normals[other, 2]
                    if other == face or nx * ox + ny * oy + nz * oz > least:
                        angle = _angle_at(faces, angles, point_ids, other, point)
                        x, y, z, weight = x + angle * ox, y + angle * oy, z + angle * oz, weight + angle
            else:
                own = _cell_of(nx, ny, nz) if has_area else -1
                for index in range(cell_count):
                    cell = cells[index]
                    ox, oy, oz = sums[index, 0], sums[index, 1], sums[index, 2]
                    length = math.sqrt(ox * ox + oy * oy + oz * oz)
                    if cell == own or nx * ox + ny * oy + nz * oz > least * length:
                        x, y, z, weight = x + ox, y + oy, z + oz, weight + sums[index, 3]
            length = math.sqrt(x * x + y * y + z * z)
            if not length > _LEAST_SHARE * weight:
                # The normals cancel each other: the corner has that of its own face.
                x, y, z, length = nx, ny, nz, 1.0
                if not has_area:
                    x, y, z = 0.0, 0.0, 1.0
            _store(faces, point_ids, face, point, x / length, y / length, z / length, smooth)


@compiled
def _store(faces, point_ids, face, point, x, y, z, smooth):
    for corner in range(3):
        if point_ids[faces[face, corner]] == point:
            smooth[face, corner, 0], smooth[face, corner, 1], smooth[face, corner, 2] = x, y, z


@compiled
def _angle_at(faces, angles, point_ids, face, point):
    """Return the angle of a face at a point. One with two corners there has no area, and so no angle."""
    for corner in range(3):
        if point_ids[faces[face, corner]] == point:
            return angles[face, corner]
    return 0.0


@compiled
def _gather(faces, normals, angles, point_ids, around, first, end, point, cells, cell_of, sums):
    """Add up the normals around a point in cells of directions; return the number of cells in use."""
    count = 0
    for slot in range(first, end):
        face = around[slot]
        nx, ny, nz = normals[face, 0], normals[face, 1], normals[face, 2]
        angle = _angle_at(faces, angles, point_ids, face, point)
        if angle == 0.0:
            continue
        cell = _cell_of(nx, ny, nz)
        if cell_of[cell] < 0:
            cell_of[cell], cells[count] = count, cell
            sums[count, 0], sums[count, 1], sums[count, 2], sums[count, 3] = 0.0, 0.0, 0.0, 0.0
            count += 1
        index = cell_of[cell]
        sums[index, 0] += angle * nx
        sums[index, 1] += angle * ny
        sums[index, 2] += angle * nz
        sums[index, 3] += angle
    for index in range(count):
        cell_of[cells[index]] = -1
    return count


@compiled
def _cell_of(x, y, z):
    """Return the cell of a direction in a grid over the octahedral map of the sphere.

    Meyer et al., "On Floating-Point Normal Vectors", 2010.
    """
    size = abs(x) + abs(y) + abs(z)
    u, v = x / size, y / size
    if z < 0.0:
        folded_u = (1.0 - abs(v)) * (1.0 if u >= 0.0 else -1.0)
        v = (1.0 - abs(u)) * (1.0 if v >= 0.0 else -1.0)
        u = folded_u
    column = min(int((u + 1.0) * (0.5 * _GRID)), _GRID - 1)
    row = min(int((v + 1.0) * (0.5 * _GRID)), _GRID - 1)
    return row * _GRID + column
