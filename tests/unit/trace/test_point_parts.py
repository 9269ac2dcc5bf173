"""Parts of point queries: of equally near faces the one that faces the point; trees over chosen instances."""

import numpy as np
import pytest
import trimesh

from clbvh import Mesh, Scene, Spheres, Tracer, make_shape
from clbvh.geometry.smooth_normals import find_vertex_faces
from clbvh.integrations.trimesh.nearest import choose_facing
from clbvh.trace.points.refine import ClosestPoints

TOLERANCE = 1e-8


def choose(mesh, points, closest):
    """What was found, after the choice."""
    chosen = ClosestPoints(*(array.copy() for array in closest))
    choose_facing(np.ascontiguousarray(points, float), mesh, find_vertex_faces(mesh), TOLERANCE, chosen)
    return chosen


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


@pytest.mark.parametrize("is_soup", [False, True])
@pytest.mark.parametrize("shape", ["boxes", "blobs"])
def test_no_face_faces_more_directly(session, shape, is_soup):
    mesh = make_shape(shape, triangles=300)
    if is_soup:
        mesh = Mesh.from_arrays(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * mesh.face_count).reshape(-1, 3))
    points = mesh.origin + np.random.default_rng(75).uniform(-1, 1, (500, 3)) * np.ptp(mesh.vertices, axis=0).max()
    with Tracer(mesh, device=session.info) as tracer:
        found = tracer.closest_point(points)
    chosen, cosines = choose(mesh, points, found), cosines_of(mesh, points)
    np.testing.assert_allclose(cosines[np.arange(500), chosen.prim_id], cosines.max(axis=1), atol=1e-6)
    np.testing.assert_allclose(chosen.distance, found.distance, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(points - chosen.point, axis=1), chosen.distance, rtol=1e-9)
    # The test can fail: the device's choice is another one.
    assert (cosines[np.arange(500), found.prim_id] < cosines.max(axis=1) - 1e-3).sum() > 10


def test_the_face_that_faces_special_points():
    ball, corner = make_shape("icosphere", triangles=80), np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    sheet = Mesh.from_arrays(corner[:3], [[0, 1, 2], [0, 2, 1]])
    on_ball = int(np.flatnonzero((ball.faces == 0).any(axis=1)).max())
    tetrahedra = [
        Mesh.from_arrays(corner * scale, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]) for scale in (1e100, 1e-100)
    ]
    for mesh, point, nearest, distance, face, expected in (
        (sheet, [0.2, 0.2, 1.0], [0.2, 0.2, 0], 1.0, 0, 0),
        (sheet, [0.2, 0.2, -1.0], [0.2, 0.2, 0], 1.0, 0, 1),
        (ball, ball.vertices[0], ball.vertices[0], 0.0, on_ball, on_ball),
        (ball, [3.0, 0, 0], [np.nan] * 3, np.inf, -1, -1),
        (ball, [1e300, 0, 0], ball.vertices[0], 1e300, 3, 3),
        # Above the tolerance faces are chosen whatever the size.
        (tetrahedra[0], [1e99, 2e99, 3e100], [0, 0, 1e100], 2.0124612e100, 1, 3),
        (tetrahedra[1], [1e-101, 2e-101, 3e-100], [0, 0, 1e-100], 2.0124612e-100, 1, 1),
    ):
        found = ClosestPoints(np.array([distance]), np.array([nearest], float), np.array([face], np.int32))
        assert choose(mesh, np.array([point], float), found).prim_id.tolist() == [expected], (point, face)


@pytest.mark.parametrize("chosen", [1, 60])
def test_points_see_the_chosen_instances_alone(session, chosen):
    generator = np.random.default_rng(chosen)
    shapes = make_shape("icosphere", triangles=80), Spheres(generator.normal(size=(5, 3)), 0.4)
    places = np.tile(np.eye(4), (120, 1, 1))
    places[:, :3, 3] = generator.uniform(-9, 9, (120, 3))
    ids = np.sort(generator.choice(120, chosen, replace=False))
    scenes = Scene(), Scene()
    for scene, numbers in zip(scenes, (range(120), ids), strict=True):
        geometries = [scene.add(shape) for shape in shapes]
        for number in numbers:
            scene.place(geometries[number % 2], places[number])
    points = generator.uniform(-10, 10, (500, 3))
    points[::2] = places[generator.choice(ids, 250), :3, 3] + generator.uniform(-0.5, 0.5, (250, 3))
    with Tracer(scenes[0], device=session.info) as tracer, Tracer(scenes[1], device=session.info) as expected:
        found, other = tracer.closest_point(points, instance=ids), expected.closest_point(points)
        np.testing.assert_allclose(found.distance, other.distance, rtol=1e-12)
        np.testing.assert_array_equal(found.prim_id, other.prim_id)
        np.testing.assert_array_equal(found.instance_id, ids[other.instance_id])
        np.testing.assert_array_equal(tracer.contains(points, instance=ids), expected.contains(points))
        signed = tracer.signed_distance(points, instance=ids)
        np.testing.assert_allclose(signed, expected.signed_distance(points), rtol=1e-12)
        assert (signed > 0).any()
        assert np.isinf(tracer.closest_point(points, instance=[]).distance).all()
