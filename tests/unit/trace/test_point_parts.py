"""Of equally near faces, trimesh's functions have the one that faces the point most directly."""

import numpy as np
import pytest
import trimesh

from clbvh import Mesh, Tracer, make_shape
from clbvh.geometry.smooth_normals import find_vertex_faces
from clbvh.integrations.trimesh.nearest import choose_facing
from clbvh.trace.points.refine import ClosestPoints

TOLERANCE = 1e-8


def cosines_of(mesh, points):
    """How directly each face that is as near as the nearest one faces each point; -inf for the others."""
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    cosines = []
    for point in points:
        ways = point - trimesh.triangles.closest_point(corners, np.tile(point, (len(corners), 1)))
        squared = (ways**2).sum(axis=1)
        cosine = (ways * normals).sum(axis=1) / np.sqrt(squared)
        cosines.append(np.where(squared < squared.min() + TOLERANCE, cosine, -np.inf))
    return np.array(cosines)


@pytest.mark.parametrize("shape", ["boxes", "blobs"])
def test_no_face_faces_more_directly(session, shape):
    mesh = make_shape(shape, triangles=300)
    if shape == "boxes":  # of which no two triangles share a vertex
        mesh = Mesh.from_arrays(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * mesh.face_count).reshape(-1, 3))
    points = mesh.origin + np.random.default_rng(75).uniform(-1, 1, (500, 3)) * np.ptp(mesh.vertices, axis=0).max()
    with Tracer(mesh, device=session.info) as tracer:
        found = tracer.closest_point(points)
    chosen, cosines = ClosestPoints(*(array.copy() for array in found)), cosines_of(mesh, points)
    choose_facing(points, mesh, find_vertex_faces(mesh), TOLERANCE, chosen)
    np.testing.assert_allclose(cosines[np.arange(500), chosen.prim_id], cosines.max(axis=1), atol=1e-6)
    np.testing.assert_allclose(chosen.distance, found.distance, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(points - chosen.point, axis=1), chosen.distance, rtol=1e-9)
    # The test can fail: the device's choice is another one.
    assert (cosines[np.arange(500), found.prim_id] < cosines.max(axis=1) - 1e-3).sum() > 10
