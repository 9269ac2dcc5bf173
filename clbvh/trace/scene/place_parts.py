"""The meshes of several instances as one mesh in the scene's unit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError
from ...geometry import Mesh
from ...scene.state import SceneState
from ...support.compiled import compiled
from ...support.memory import check_memory
from ..hits.scene_arrays import SceneArrays, place_vector

# Of a vertex and of a face, in the arrays and in the copies that a mesh makes of them.
_VERTEX_BYTES, _FACE_BYTES = 60, 25


def place_parts(
    state: SceneState, arrays: SceneArrays, instance_ids: NDArray[np.int64]
) -> tuple[Mesh, NDArray[np.float64], NDArray[np.bool_]]:
    """Return the meshes of instances as one.

    Parameters
    ----------
    state : SceneState
    arrays : SceneArrays
        Of the state.
    instance_ids : (n,) int64
        At least one triangle mesh; all are mirrored, or none is.

    Returns
    -------
    mesh : Mesh
        The vertices and the faces of one instance after the other. Its zero is in the first one: far from the scene's
        zero, float64 would round the vertices by more than the differences of two of them.
    transform : (4, 4) float64
        From the mesh's coordinates to the scene's: a translation, and a mirror if it is one that has placed the
        instances. So the corners of a face run as in its own mesh.
    is_degenerate : (F,) bool
        Whether no ray hits a triangle in its own mesh, see `Mesh.degenerate_faces`.

    Raises
    ------
    SceneError
        The mesh does not fit the free memory.
    """
    shapes = [state.shapes[geometry_id] for geometry_id in state.geometry_ids[instance_ids]]
    vertex_counts = np.array([len(shape.vertices) for shape in shapes if isinstance(shape, Mesh)])
    face_counts = np.array([shape.prim_count for shape in shapes])
    vertices, faces = np.empty((vertex_counts.sum(), 3)), np.empty((face_counts.sum(), 3), np.int32)
    check_memory("the merged meshes of the scene", len(vertices) * _VERTEX_BYTES + len(faces) * _FACE_BYTES, SceneError)
    is_degenerate = np.empty(len(faces), np.bool_)
    first, transform = instance_ids[0], np.eye(4)
    transform[:3, 3] = arrays.offset[first] + arrays.linear[first] @ arrays.origin[arrays.geometry_id[first]]
    transform[0, 0] = -1.0 if arrays.is_mirrored[first] else 1.0
    _place(arrays, instance_ids, vertex_counts, face_counts, transform, vertices, faces, is_degenerate)
    return Mesh.from_arrays(vertices, faces, name="merged meshes"), transform, is_degenerate


@compiled
def _place(arrays, instance_ids, vertex_counts, face_counts, transform, vertices, faces, is_degenerate):
    local = np.empty((3, 3))
    first_vertex, first_face = 0, 0
    side = transform[0, 0]
    for part in range(len(instance_ids)):
        instance = instance_ids[part]
        geometry = arrays.geometry_id[instance]
        origin, scale = arrays.origin[geometry], arrays.scale[geometry]
        source_vertex, source_face = arrays.first_vertex[geometry], arrays.first_face[geometry]
        centre = place_vector(arrays, instance, origin[0], origin[1], origin[2])
        x = centre[0] + arrays.offset[instance, 0] - transform[0, 3]
        y = centre[1] + arrays.offset[instance, 1] - transform[1, 3]
        z = centre[2] + arrays.offset[instance, 2] - transform[2, 3]
        for vertex in range(vertex_counts[part]):
            point = arrays.vertices[source_vertex + vertex]
            moved = place_vector(arrays, instance, point[0] - origin[0], point[1] - origin[1], point[2] - origin[2])
            vertices[first_vertex + vertex, 0] = side * (moved[0] + x)
            vertices[first_vertex + vertex, 1] = moved[1] + y
            vertices[first_vertex + vertex, 2] = moved[2] + z
        for face in range(face_counts[part]):
            for corner in range(3):
                vertex = arrays.faces[source_face + face, corner]
                faces[first_face + face, corner] = first_vertex + vertex
                for axis in range(3):
                    # As the mesh has it in float32.
                    position = (arrays.vertices[source_vertex + vertex, axis] - origin[axis]) * scale
                    local[corner, axis] = np.float64(np.float32(position))
            is_degenerate[first_face + face] = _is_flat(local)
        first_vertex += vertex_counts[part]
        first_face += face_counts[part]


@compiled
def _is_flat(corners):
    """Return whether three points lie on one line, or in one point; exact for coordinates that float32 has."""
    ux, uy, uz = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
    vx, vy, vz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
    return uy * vz == uz * vy and uz * vx == ux * vz and ux * vy == uy * vx
