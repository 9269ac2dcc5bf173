"""The proximity queries for trimesh: their contract, known answers, and what trimesh finds by trying every face."""

import inspect
import pickle

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh.errors import ConfigError, MeshError, QueryError
from clbvh.integrations import trimesh as engine
from clbvh.integrations.trimesh import ProximityQuery, RayMeshIntersector

# Declared by trimesh 5.2; the same in 4.6.
FUNCTIONS = {
    "closest_point": "(mesh, points)",
    "signed_distance": "(mesh, points)",
    "longest_ray": "(mesh, points, directions)",
    "max_tangent_sphere": "(mesh, points, inwards=True, normals=None, threshold=1e-06, max_iter=100)",
    "thickness": "(mesh, points, exterior=False, normals=None, method='max_sphere')",
}
METHODS = {"on_surface": "(points)", "signed_distance": "(points)", "vertex": "(points)"}

SHAPES = {
    "box": trimesh.creation.box,
    "icosphere": lambda: trimesh.creation.icosphere(2),
    "torus": lambda: trimesh.creation.torus(1.0, 0.3, major_sections=24, minor_sections=12),
    "annulus": lambda: trimesh.creation.annulus(0.5, 1.0, 0.7, sections=20),
    "soup": lambda: trimesh.creation.icosphere(2).submesh([np.arange(0, 320, 3)], append=True),
}


def bare(function, skipped=0):
    """The signature without annotations."""
    parameters = list(inspect.signature(function).parameters.values())[skipped:]
    return str(inspect.Signature([p.replace(annotation=inspect.Parameter.empty) for p in parameters]))


@pytest.fixture(params=SHAPES)
def mesh(request, session):
    return SHAPES[request.param]()


@pytest.fixture
def box(session):
    return trimesh.creation.box()


@pytest.fixture
def points(mesh):
    generator = np.random.default_rng(90)
    size = np.ptp(mesh.bounds, axis=0).max()
    anywhere = mesh.bounds.mean(axis=0) + generator.uniform(-1, 1, (300, 3)) * size
    close = mesh.triangles_center[generator.integers(0, len(mesh.faces), 200)] + generator.normal(0, 0.02, (200, 3))
    return np.concatenate((anywhere, close))


class TestContract:
    @pytest.mark.parametrize("name", FUNCTIONS)
    def test_functions(self, name):
        assert bare(getattr(engine, name)) == FUNCTIONS[name]
        assert bare(getattr(trimesh.proximity, name)) == FUNCTIONS[name]

    @pytest.mark.parametrize("name", METHODS)
    def test_methods(self, name):
        assert bare(getattr(ProximityQuery, name), 1) == METHODS[name]

    def test_reach_is_thickness_outside(self, box):
        assert bare(engine.reach) == "(mesh, points, normals=None, method='max_sphere')"
        assert np.isinf(engine.reach(box, [[0, 0, 0.5]])).all()

    def test_dtypes_and_shapes(self, box):
        query = ProximityQuery(box)
        given = [[2.0, 0.1, 0.2], [0.1, 0.2, 0.3]]
        expected = [((2, 3), np.float64), ((2,), np.float64), ((2,), np.int64)]
        for form in (given, np.array(given, np.float32), np.array(given), trimesh.caching.tracked_array(given)):
            assert [(a.shape, a.dtype) for a in query.on_surface(form)] == expected
        assert [(a.shape, a.dtype) for a in engine.closest_point(box, given)] == expected
        assert [(a.shape, a.dtype) for a in query.vertex(given)] == expected[1:]
        assert [(a.shape, a.dtype) for a in engine.max_tangent_sphere(box, given)] == expected[:2]
        for array in (
            query.signed_distance(given),
            engine.signed_distance(box, given),
            engine.thickness(box, given),
            engine.thickness(box, given, method="ray"),
            engine.reach(box, given),
            engine.longest_ray(box, given, given),
        ):
            assert (array.shape, array.dtype) == ((2,), np.float64)

    def test_no_points(self, box):
        none = np.empty((0, 3))
        shapes = [((0, 3), np.float64), ((0,), np.float64), ((0,), np.int64)]
        assert [(a.shape, a.dtype) for a in engine.closest_point(box, none)] == shapes
        assert [(a.shape, a.dtype) for a in ProximityQuery(box).vertex(none)] == shapes[1:]
        assert [(a.shape, a.dtype) for a in engine.max_tangent_sphere(box, none)] == shapes[:2]
        for function in (engine.signed_distance, engine.thickness, engine.reach):
            assert function(box, none).shape == (0,)
        assert engine.longest_ray(box, none, none).shape == (0,)

    def test_vertex_takes_any_shape(self, box):
        query = ProximityQuery(box)
        distance, vertex_id = query.vertex([0.5, 0.5, 2.5])
        assert (type(distance), type(vertex_id)) == (float, int)
        assert distance == 2
        assert box.vertices[vertex_id].tolist() == [0.5, 0.5, 0.5]
        assert [a.shape for a in query.vertex(np.ones((2, 4, 3)))] == [(2, 4), (2, 4)]

    @pytest.mark.parametrize("name", [*FUNCTIONS, "reach"])
    def test_wrong_points(self, box, name):
        function = getattr(engine, name)
        more = ([[0, 0, 1.0]],) if name == "longest_ray" else ()
        for wrong in ([], [0, 0, 0], np.ones((2, 2, 3)), np.ones((3, 2))):
            with pytest.raises(QueryError, match=r"points must be \(n,3\)"):
                function(box, wrong, *more)
        with pytest.raises(ValueError, match="could not convert"):
            function(box, [["a", "b", "c"]], *more)
        if name != "longest_ray":
            with pytest.raises(QueryError, match="not finite"):
                function(box, [[np.nan, 0, 0]])

    def test_wrong_vectors_and_methods(self, box):
        with pytest.raises(QueryError, match=r"normals must be \(n,3\)"):
            engine.thickness(box, [[0, 0, 0.5]], normals=[0, 0, 1])
        with pytest.raises(QueryError, match="normals must be as many as the 1 points, not 2"):
            engine.max_tangent_sphere(box, [[0, 0, 0.5]], normals=[[0, 0, 1], [0, 0, 1]])
        with pytest.raises(QueryError, match="directions must be as many as the 2 points, not 1"):
            engine.longest_ray(box, [[0, 0, 0.5]] * 2, [[0, 0, 1]])
        with pytest.raises(ConfigError, match="method must be 'max_sphere' or 'ray', not 'sphere'"):
            engine.thickness(box, [[0, 0, 0.5]], method="sphere")
        with pytest.raises(QueryError, match=r"points must be \(\.\.\., 3\)"):
            ProximityQuery(box).vertex([])
        with pytest.raises(QueryError, match=r"points\[1\] is not finite"):
            ProximityQuery(box).vertex([[0, 0, 0], [0, np.inf, 0]])

    def test_what_is_no_mesh(self, session):
        for function in (engine.closest_point, engine.signed_distance, engine.thickness, engine.max_tangent_sphere):
            with pytest.raises(MeshError, match=r"expected a clbvh\.Mesh, a trimesh\.Trimesh"):
                function(7, [[0, 0, 0]])
        with pytest.raises(MeshError, match=r"no (vertices|faces)"):
            engine.closest_point(trimesh.Trimesh(), [[0, 0, 0]])
        with pytest.raises(QueryError, match="without vertices"):
            ProximityQuery(trimesh.Trimesh()).vertex([[0, 0, 0]])

    def test_inputs_are_left_alone(self, box):
        points = np.random.default_rng(91).uniform(-1, 1, (50, 3))
        before = points.copy()
        points.flags.writeable = False
        for name in ("closest_point", "signed_distance", "thickness", "max_tangent_sphere"):
            getattr(engine, name)(box, points)
        np.testing.assert_array_equal(points, before)


class TestOtherMeshes:
    @pytest.mark.parametrize("form", ["mesh", "arrays", "path"])
    def test_what_people_have(self, session, box, tmp_path, form):
        arrays = np.array(box.vertices), np.array(box.faces)
        box.export(tmp_path / "box.ply")
        thing = {"mesh": clbvh.Mesh.from_arrays(*arrays), "arrays": arrays, "path": tmp_path / "box.ply"}[form]
        np.testing.assert_allclose(engine.signed_distance(thing, [[0, 0, 0.4], [0, 0, 2]]), [0.1, -1.5])
        np.testing.assert_allclose(engine.thickness(thing, [[0, 0, 0.5]]), [1.0])
        np.testing.assert_allclose(ProximityQuery(thing).vertex([[0.5, 0.5, 2.5]])[0], [2.0])

    def test_a_mesh_of_points_has_nearest_vertices(self, session):
        cloud = trimesh.Trimesh([[0, 0, 0], [1, 0, 0]], process=False)
        assert ProximityQuery(cloud).vertex([[0.9, 0, 0]])[1].tolist() == [1]


class TestClosestPoint:
    def test_against_every_face(self, mesh, points):
        closest, distance, triangle_id = engine.closest_point(mesh, points)
        expected, expected_distance, _ = trimesh.proximity.closest_point_naive(mesh, points)
        np.testing.assert_allclose(distance, expected_distance, atol=2e-6)
        np.testing.assert_allclose(np.linalg.norm(closest - points, axis=1), distance, atol=1e-12)
        sure = np.linalg.norm(closest - expected, axis=1) < 1e-9
        assert sure.mean() > 0.95
        on = trimesh.triangles.closest_point(mesh.triangles[triangle_id], points)
        np.testing.assert_allclose(on, closest, atol=1e-9)

    def test_the_face_that_faces_the_point(self, box):
        corner = [[0.6, 0.6, 2.0], [2.0, 0.6, 0.6], [0.6, 2.0, 0.6]]
        _, _, triangle_id = engine.closest_point(box, corner)
        np.testing.assert_allclose(box.face_normals[triangle_id], [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-12)

    def test_after_a_change(self, box):
        box.nearest = ProximityQuery(box)
        assert box.nearest.on_surface([[0, 0, 2]])[1] == pytest.approx(1.5)
        assert box.nearest.vertex([[0.5, 0.5, 2]])[0] == pytest.approx(1.5)
        box.apply_translation([0, 0, 1])
        assert box.nearest.on_surface([[0, 0, 2]])[1] == pytest.approx(0.5)
        assert box.nearest.vertex([[0.5, 0.5, 2]])[0] == pytest.approx(0.5)
        box.update_faces(box.face_normals[:, 2] < 0.5)
        assert box.nearest.on_surface([[0, 0, 2]])[1] == pytest.approx(np.hypot(0.5, 0.5))
        box.nearest.close()
        assert box.nearest.on_surface([[0, 0, 2]])[1] == pytest.approx(np.hypot(0.5, 0.5))


class TestSignedDistance:
    def test_a_sphere(self, session):
        sphere = trimesh.creation.icosphere(4)
        points = np.random.default_rng(92).uniform(-1.5, 1.5, (3000, 3))
        np.testing.assert_allclose(
            engine.signed_distance(sphere, points), 1 - np.linalg.norm(points, axis=1), atol=4e-3
        )

    def test_a_box(self, box):
        points = np.random.default_rng(93).uniform(-1, 1, (3000, 3))
        beyond = np.abs(points) - 0.5
        outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
        expected = np.where(outside > 0, -outside, -beyond.max(axis=1))
        np.testing.assert_allclose(engine.signed_distance(box, points), expected, atol=1e-6)

    def test_on_the_surface_it_is_positive(self, box):
        distance = engine.signed_distance(box, [[0.5, 0.1, 0.2], [0.5, 0.5, 0.5]])
        assert (distance >= 0).all()
        assert (distance < 1e-8).all()

    def test_beside_a_face_in_its_plane(self, box):
        assert (engine.signed_distance(box, np.add(box.bounds[0], [[100, 0, 0], [100, 100, 100]])) < 0).all()

    def test_a_sheet_has_two_sides(self, session):
        sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
        np.testing.assert_allclose(engine.signed_distance(sheet, [[0.2, 0.2, 1], [0.2, 0.2, -2]]), [-1, 2])

    @pytest.mark.parametrize("far", [1e10, 1e100, 1e200])
    def test_far_away(self, box, far):
        np.testing.assert_allclose(engine.signed_distance(box, [[far, 0, 0], [far, far, far]]), [-far, -far * 3**0.5])


class TestThickness:
    def test_a_box_and_a_sphere(self, box):
        for method in ("ray", "max_sphere"):
            np.testing.assert_allclose(engine.thickness(box, [[0.5, 0, 0], [0, -0.5, 0]], method=method), 1.0)
        sphere = trimesh.creation.icosphere(4)
        thick = engine.thickness(sphere, sphere.triangles_center[::50])
        # Facets: a sphere that touches the middle of one touches its neighbours first.
        assert ((thick > 1.7) & (thick < 2)).all()

    def test_a_plate_with_a_slot(self, session):
        """Two plates of thickness 1 and 3, with a gap of 2."""
        lower = trimesh.creation.box(extents=[40, 40, 1])
        upper = trimesh.creation.box(extents=[40, 40, 3])
        upper.apply_translation([0, 0, 0.5 + 2 + 1.5])
        mesh = trimesh.util.concatenate([lower, upper])
        points = np.array([[0, 0, 0.5], [1, 1, 2.5], [1, 1, 5.5], [0, 0, -0.5]])
        for method in ("ray", "max_sphere"):
            np.testing.assert_allclose(engine.thickness(mesh, points, method=method), [1, 3, 3, 1], rtol=1e-5)
            np.testing.assert_allclose(engine.reach(mesh, points, method=method), [2, 2, np.inf, np.inf], rtol=1e-5)

    def test_spheres_that_are_bounded_by_a_vertex(self, session):
        """In a valley of 90 degrees: the ray goes up and away, the sphere touches the other slope."""
        valley = trimesh.Trimesh(
            [[0, -9, 0], [0, 9, 0], [5, -9, 5], [5, 9, 5], [-5, -9, 5], [-5, 9, 5]],
            [[0, 2, 1], [1, 2, 3], [0, 1, 4], [1, 5, 4]],
        )
        at = np.array([[2.0, 0.5, 2.0]])
        centers, radii = engine.max_tangent_sphere(valley, at, normals=[[-(0.5**0.5), 0, 0.5**0.5]], inwards=False)
        # The centre is over the valley's bottom line.
        np.testing.assert_allclose(centers, [[0, 0.5, 4]], atol=1e-3)
        np.testing.assert_allclose(radii, [8**0.5], atol=1e-3)

    def test_no_sphere_holds_a_part_of_the_mesh(self, session):
        mesh = trimesh.creation.torus(1.0, 0.3)
        at = mesh.triangles_center[::9]
        centers, radii = engine.max_tangent_sphere(mesh, at)
        _, distance, _ = trimesh.proximity.closest_point_naive(mesh, centers)
        np.testing.assert_allclose(distance, radii, rtol=0.02)
        np.testing.assert_allclose(np.linalg.norm(centers - at, axis=1), radii, rtol=1e-9)

    def test_the_surface_of_the_start_does_not_count(self, box):
        rays = np.array([[0.2, 0.1, 0.5], [0.2, 0.1, 0.5 + 1e-7], [0.2, 0.1, 0.4]]), np.array([[0, 0, -4.0]] * 3)
        np.testing.assert_allclose(engine.longest_ray(box, *rays), [1, 1, 0.9], atol=1e-6)

    def test_many_layers_closer_than_the_tolerance(self, session):
        one = trimesh.creation.box()
        mesh = trimesh.util.concatenate([one.copy().apply_translation([0, 0, k * 1e-7]) for k in range(9)])
        assert engine.longest_ray(mesh, [[0.1, 0.2, 0.5]], [[0, 0, -1]])[0] == pytest.approx(1.0, abs=1e-5)

    def test_rays_that_are_none(self, box):
        points = [[0, 0, 0], [np.nan, 0, 0], [0, 0, 0]]
        assert engine.longest_ray(box, points, [[0, 0, 0], [0, 0, 1], [0, 0, 1]]).tolist() == [np.inf, np.inf, 0.5]


class TestOptions:
    def test_those_of_the_ray_engine(self, session, box):
        box.ray = RayMeshIntersector(box, device=session.info.number, layout="bvh4")
        engine.closest_point(box, [[0, 0, 2]])
        assert "layout='bvh4'" in repr(ProximityQuery(box))
        assert box.ray._tracer.open_tracer.layout == "bvh4"

    def test_ones_own_come_first(self, session, box):
        box.ray = RayMeshIntersector(box, layout="bvh4")
        assert "layout='bvh2'" in repr(ProximityQuery(box, layout="bvh2"))

    def test_pickled(self, session, box):
        box.nearest = ProximityQuery(box, layout="bvh2")
        assert box.nearest.on_surface([[0, 0, 2]])[1] == pytest.approx(1.5)
        loaded = pickle.loads(pickle.dumps(box))
        assert "layout='bvh2'" in repr(loaded.nearest)
        loaded.apply_translation([0, 0, 1])
        assert loaded.nearest.on_surface([[0, 0, 2]])[1] == pytest.approx(0.5)
        assert box.nearest.on_surface([[0, 0, 2]])[1] == pytest.approx(1.5)
