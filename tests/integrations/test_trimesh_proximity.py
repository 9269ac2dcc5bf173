"""The proximity queries for trimesh: their contract, known answers, and what trimesh finds by trying every face."""

import numpy as np
import pytest
import trimesh

from clbvh.integrations import trimesh as engine
from clbvh.integrations.trimesh import ProximityQuery, RayMeshIntersector

SHAPES = {
    "box": trimesh.creation.box,
    "torus": lambda: trimesh.creation.torus(1.0, 0.3, major_sections=24, minor_sections=12),
    "soup": lambda: trimesh.creation.icosphere(2).submesh([np.arange(0, 320, 3)], append=True),
}


@pytest.fixture
def box(session):
    return trimesh.creation.box()


class TestContract:
    def test_dtypes_and_shapes_of_some_points_and_of_none(self, box):
        given = [[2.0, 0.1, 0.2], [0.1, 0.2, 0.3]]
        for points in (given, np.array(given, np.float32), np.empty((0, 3))):
            count, query = len(points), ProximityQuery(box)
            expected = [((count, 3), np.float64), ((count,), np.float64), ((count,), np.int64)]
            for answer, kinds in (
                (query.on_surface(points), expected),
                (query.vertex(points), expected[1:]),
                (engine.max_tangent_sphere(box, points), expected[:2]),
                ([query.signed_distance(points)], expected[1:2]),
                ([engine.thickness(box, points)], expected[1:2]),
                ([engine.longest_ray(box, points, points)], expected[1:2]),
            ):
                assert [(array.shape, array.dtype) for array in answer] == kinds

    def test_vertex_takes_any_shape(self, box):
        query = ProximityQuery(box)
        distance, vertex_id = query.vertex([0.5, 0.5, 2.5])
        assert (type(distance), type(vertex_id), distance) == (float, int, 2.0)
        assert box.vertices[vertex_id].tolist() == [0.5, 0.5, 0.5]
        assert [array.shape for array in query.vertex(np.ones((2, 4, 3)))] == [(2, 4), (2, 4)]

    def test_vertices_without_a_face_count(self, session):
        for faces in ([], [[0, 1, 2]]):
            mesh = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0]], faces, process=False)
            assert ProximityQuery(mesh).vertex([[4, 0, 0], [0.9, 0, 0]])[1].tolist() == [3, 1]


class TestClosestPoint:
    @pytest.mark.parametrize("shape", SHAPES)
    def test_against_every_face(self, session, shape):
        mesh, generator = SHAPES[shape](), np.random.default_rng(90)
        near = mesh.triangles_center[generator.integers(0, len(mesh.faces), 200)]
        points = np.concatenate((generator.uniform(-1.5, 1.5, (300, 3)), near + generator.normal(0, 0.02, (200, 3))))
        closest, distance, triangle_id = engine.closest_point(mesh, points)
        expected, expected_distance, _ = trimesh.proximity.closest_point_naive(mesh, points)
        np.testing.assert_allclose(distance, expected_distance, atol=2e-6)
        np.testing.assert_allclose(np.linalg.norm(closest - points, axis=1), distance, atol=1e-12)
        assert (np.linalg.norm(closest - expected, axis=1) < 1e-9).mean() > 0.95
        on = trimesh.triangles.closest_point(mesh.triangles[triangle_id], points)
        np.testing.assert_allclose(on, closest, atol=1e-9)

    def test_the_face_that_faces_the_point(self, box):
        _, _, triangle_id = engine.closest_point(box, [[0.6, 0.6, 2.0], [2.0, 0.6, 0.6], [0.6, 2.0, 0.6]])
        np.testing.assert_allclose(box.face_normals[triangle_id], [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-12)


class TestSignedDistance:
    def test_a_sphere_and_a_box(self, box):
        points = np.random.default_rng(93).uniform(-1.5, 1.5, (3000, 3))
        distance = engine.signed_distance(trimesh.creation.icosphere(4), points)
        np.testing.assert_allclose(distance, 1 - np.linalg.norm(points, axis=1), atol=4e-3)
        beyond = np.abs(points) - 0.5
        outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
        expected = np.where(outside > 0, -outside, -beyond.max(axis=1))
        np.testing.assert_allclose(engine.signed_distance(box, points), expected, atol=1e-6)

    def test_on_the_surface_it_is_positive_and_in_the_plane_of_a_face_negative(self, box):
        distance = engine.signed_distance(box, [[0.5, 0.1, 0.2], [0.5, 0.5, 0.5]])
        assert ((distance >= 0) & (distance < 1e-8)).all()
        assert (engine.signed_distance(box, np.add(box.bounds[0], [[100, 0, 0], [100, 100, 100]])) < 0).all()


class TestThickness:
    def test_a_plate_with_a_slot(self, session):
        """Two plates of thickness 1 and 3, with a gap of 2."""
        plates = [trimesh.creation.box(extents=[40, 40, height]) for height in (1, 3)]
        plates[1].apply_translation([0, 0, 0.5 + 2 + 1.5])
        mesh = trimesh.util.concatenate(plates)
        points = np.array([[0, 0, 0.5], [1, 1, 2.5], [1, 1, 5.5], [0, 0, -0.5]])
        for method in ("ray", "max_sphere"):
            np.testing.assert_allclose(engine.thickness(mesh, points, method=method), [1, 3, 3, 1], rtol=1e-5)
            np.testing.assert_allclose(engine.reach(mesh, points, method=method), [2, 2, np.inf, np.inf], rtol=1e-5)

    def test_spheres_that_are_bounded_by_a_vertex(self, session):
        """In a valley of 90 degrees: the ray goes up and away, the sphere touches the other slope."""
        corners = [[0, -9, 0], [0, 9, 0], [5, -9, 5], [5, 9, 5], [-5, -9, 5], [-5, 9, 5]]
        valley = trimesh.Trimesh(corners, [[0, 2, 1], [1, 2, 3], [0, 1, 4], [1, 5, 4]])
        at, normals = np.array([[2.0, 0.5, 2.0]]), [[-(0.5**0.5), 0, 0.5**0.5]]
        centers, radii = engine.max_tangent_sphere(valley, at, normals=normals, inwards=False)
        # The centre is over the valley's bottom line.
        np.testing.assert_allclose(centers, [[0, 0.5, 4]], atol=1e-3)
        np.testing.assert_allclose(radii, [8**0.5], atol=1e-3)
        up = [[0, 0, 1.0]]
        assert np.isinf(engine.reach(valley, at, normals=up, method="ray"))
        assert np.isfinite(engine.reach(valley, at, normals=up))

    def test_rays_do_not_meet_the_surface_that_they_start_from(self, box):
        points, ways = [[0.2, 0.1, 0.5], [0.2, 0.1, 0.5 + 1e-7], [0.2, 0.1, 0.4]], [[0, 0, -4.0]] * 3
        np.testing.assert_allclose(engine.longest_ray(box, points, ways), [1, 1, 0.9], atol=1e-6)
        layers = trimesh.util.concatenate([box.copy().apply_translation([0, 0, k * 1e-7]) for k in range(9)])
        assert engine.longest_ray(layers, [[0.1, 0.2, 0.5]], [[0, 0, -1]]) == pytest.approx([1.0], abs=1e-5)
        none = engine.longest_ray(box, [[0, 0, 0], [np.nan, 0, 0], [0, 0, 0]], [[0, 0, 0], [0, 0, 1], [0, 0, 1]])
        assert none.tolist() == [np.inf, np.inf, 0.5]


class TestOptions:
    def test_ones_own_come_before_those_of_the_ray_engine(self, box):
        box.ray = RayMeshIntersector(box, layout="bvh4")
        engine.closest_point(box, [[0, 0, 2]])
        assert box.ray._tracer.open_tracer.layout == "bvh4"
        assert "layout='bvh4'" in repr(ProximityQuery(box))
        assert "layout='bvh2'" in repr(ProximityQuery(box, layout="bvh2"))
