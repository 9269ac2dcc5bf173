"""Of the faces that are equally near, the one that faces the point."""

import numpy as np
import pytest
import trimesh

from clbvh import Mesh, Tracer, make_shape
from clbvh.geometry.smooth_normals import find_vertex_faces
from clbvh.integrations.trimesh.nearest import choose_facing
from clbvh.trace.points.refine import ClosestPoints

TOLERANCE = 1e-8


def choose(mesh, points, closest):
    """A copy of what was found, after the choice."""
    chosen = ClosestPoints(*(array.copy() for array in closest))
    choose_facing(np.ascontiguousarray(points, float), mesh, find_vertex_faces(mesh), TOLERANCE, chosen)
    return chosen


def expected_faces(mesh, points):
    """The face of largest cosine among all that are as near as the nearest one, and the cosines of all those."""
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


@pytest.mark.parametrize("is_soup", [False, True])
@pytest.mark.parametrize("shape", ["boxes", "icosphere", "blobs"])
def test_no_face_faces_more_directly(session, shape, is_soup):
    mesh = make_shape(shape, triangles=300)
    if is_soup:
        corners = mesh.vertices[mesh.faces].reshape(-1, 3)
        mesh = Mesh.from_arrays(corners, np.arange(len(corners)).reshape(-1, 3))
    points = mesh.origin + np.random.default_rng(75).uniform(-1, 1, (500, 3)) * np.ptp(mesh.vertices, axis=0).max()
    with Tracer(mesh, device=session.info) as tracer:
        found = tracer.closest_point(points)
    chosen = choose(mesh, points, found)
    cosines = expected_faces(mesh, points)
    reached = cosines[np.arange(len(points)), chosen.prim_id]
    np.testing.assert_allclose(reached, cosines.max(axis=1), atol=1e-6)
    np.testing.assert_allclose(chosen.distance, found.distance, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(points - chosen.point, axis=1), chosen.distance, rtol=1e-9)
    # The test can fail: the device's choice is another one.
    before = cosines[np.arange(len(points)), found.prim_id]
    assert (before < cosines.max(axis=1) - 1e-3).sum() > 10


def test_a_sheet_with_two_sides():
    mesh = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 1]])
    points = np.array([[0.2, 0.2, 1.0], [0.2, 0.2, -1.0]])
    found = ClosestPoints(np.ones(2), np.array([[0.2, 0.2, 0.0]] * 2), np.zeros(2, np.int32))
    assert choose(mesh, points, found).prim_id.tolist() == [0, 1]


def test_on_the_surface_the_face_stays():
    mesh = make_shape("icosphere", triangles=80)
    points = mesh.vertices[:10]
    faces = np.array([np.flatnonzero((mesh.faces == vertex).any(axis=1)).max() for vertex in range(10)], np.int32)
    found = ClosestPoints(np.zeros(10), points.copy(), faces)
    np.testing.assert_array_equal(choose(mesh, points, found).prim_id, faces)


def test_coplanar_faces_have_the_smallest_number():
    mesh = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    points = np.array([[0.5, 0.5, 2.0], [-1.0, -1.0, 0.3]])
    found = ClosestPoints(np.array([2.0, np.sqrt(2.09)]), np.array([[0.5, 0.5, 0], [0, 0, 0]]), np.ones(2, np.int32))
    assert choose(mesh, points, found).prim_id.tolist() == [0, 0]


def test_without_a_face_nothing_changes():
    mesh = make_shape("icosphere", triangles=80)
    found = ClosestPoints(np.array([np.inf]), np.full((1, 3), np.nan), np.array([-1], np.int32))
    chosen = choose(mesh, np.array([[3.0, 0, 0]]), found)
    assert chosen.prim_id.tolist() == [-1]
    assert np.isinf(chosen.distance[0])


@pytest.mark.parametrize("scale", [1e-100, 1e-20, 1e20, 1e100])
def test_sizes(scale):
    """A tetrahedron, and a point over a vertex: above the tolerance faces are chosen whatever the size."""
    mesh = Mesh.from_arrays(
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * scale, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    )
    point = np.array([[0.1, 0.2, 3.0]]) * scale
    found = ClosestPoints(
        np.array([np.linalg.norm([0.1, 0.2, 2.0])]) * scale, np.array([[0, 0, 1.0]]) * scale, np.array([1], np.int32)
    )
    expected = 3 if scale**2 > TOLERANCE else 1
    assert choose(mesh, point, found).prim_id.tolist() == [expected]


@pytest.mark.parametrize("far", [1e10, 1e200, 1e300])
def test_far_points_keep_their_faces(far):
    mesh = make_shape("icosphere", triangles=80)
    found = ClosestPoints(np.array([far]), mesh.vertices[:1].copy(), np.array([3], np.int32))
    assert choose(mesh, np.array([[far, 0, 0]]), found).prim_id.tolist() == [3]
