"""The ray engine for trimesh: its contract, and that it follows a mesh that changes."""

import inspect

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh import ConfigError, DeviceError, MeshError, QueryError, SceneError, Tracer
from clbvh.device import program
from clbvh.integrations.trimesh import ProximityQuery, RayMeshIntersector, SceneRay, tracers

from ..concurrency.threads import run_in_threads

# Declared by the embree engine of trimesh 5.
SIGNATURES = {
    "intersects_location": "(self, ray_origins, ray_directions, multiple_hits=True)",
    "intersects_id": "(self, ray_origins, ray_directions, multiple_hits=True, max_hits=100, return_locations=False)",
    "intersects_first": "(self, ray_origins, ray_directions)",
    "intersects_any": "(self, ray_origins, ray_directions)",
    "contains_points": "(self, points)",
}
DOWN = [[0.1, 0.2, 5]], [[0, 0, -1]]
MOVING_RAYS = np.random.default_rng(101).uniform(-1, 1, (2, 400, 3))


def with_engines(mesh):
    mesh.ray, mesh.nearest = RayMeshIntersector(mesh), ProximityQuery(mesh)
    return mesh


@pytest.fixture
def box(session):
    return with_engines(trimesh.creation.box())


@pytest.fixture
def torus(session):
    return with_engines(trimesh.creation.torus(1.0, 0.3))


@pytest.fixture(scope="module")
def rays():
    generator = np.random.default_rng(80)
    origins = generator.uniform(-2, 2, (5000, 3))
    return origins, (generator.uniform(-1, 1, (5000, 3)) - origins) * generator.uniform(0.01, 100, (5000, 1))


def check_same(obtained, expected):
    for array, other in zip(obtained, expected, strict=True):
        np.testing.assert_array_equal(array, other)


class TestContract:
    def test_arguments_and_defaults_are_those_of_trimesh(self):
        def list_parameters(function, annotation=inspect.Parameter.empty):
            parameters = inspect.signature(function).parameters.values()
            return str(inspect.Signature([each.replace(annotation=annotation) for each in parameters]))

        for name, expected in SIGNATURES.items():
            for owner in (RayMeshIntersector, SceneRay):
                assert list_parameters(getattr(owner, name)) == expected, name
        ours, theirs = clbvh.integrations.trimesh, trimesh.proximity
        for name in ("closest_point", "signed_distance", "longest_ray", "max_tangent_sphere", "thickness"):
            assert list_parameters(getattr(ours, name)) == list_parameters(getattr(theirs, name)), name
        for name in ("on_surface", "signed_distance", "vertex"):
            assert list_parameters(getattr(ProximityQuery, name)) == "(self, points)"

    def test_orders_and_dtypes(self, box):
        # Two rays through the box, the middle one beside it: first hits first, each depth in the order of the rays.
        rays = [[0.1, 0.2, 5], [9, 9, 9], [0.3, 0.1, -5]], [[0, 0, -2], [0, 0, -2], [0, 0, 0.5]]
        index_tri, index_ray, locations = box.ray.intersects_id(*rays, return_locations=True)
        assert index_ray.tolist() == [0, 2, 0, 2]
        expected = [[0.1, 0.2, 0.5], [0.3, 0.1, -0.5], [0.1, 0.2, -0.5], [0.3, 0.1, 0.5]]
        np.testing.assert_allclose(locations, expected, atol=1e-15)
        np.testing.assert_allclose(box.face_normals[index_tri][:, 2], [1, -1, -1, 1])
        assert [array.dtype for array in (index_tri, index_ray, locations)] == [np.int64, np.int64, np.float64]
        check_same(box.ray.intersects_location(*rays), (locations, index_ray, index_tri))
        check_same(box.ray.intersects_id(*rays), (index_tri, index_ray))
        first, any_hit = box.ray.intersects_first(*rays), box.ray.intersects_any(*rays)
        assert (first.dtype, first.tolist()) == (np.int32, [index_tri[0], -1, index_tri[1]])
        assert (any_hit.dtype, any_hit.tolist()) == (bool, [True, False, True])

    def test_first_hits_every_hit_and_limits_agree(self, torus, rays):
        first = torus.ray.intersects_first(*rays)
        alone = torus.ray.intersects_id(*rays, multiple_hits=False)
        assert [array.dtype for array in alone] == [np.int64] * 2
        check_same(alone, (first[first >= 0], np.flatnonzero(first >= 0)))
        np.testing.assert_array_equal(torus.ray.intersects_any(*rays), first >= 0)

        locations, index_ray, index_tri = torus.ray.intersects_location(*rays)
        on = torus.ray.intersects_location(*rays, multiple_hits=False)
        check_same((locations[: len(on[0])], *(each[: len(on[0])] for each in (index_ray, index_tri))), on)
        ways = rays[1][index_ray] / np.linalg.norm(rays[1][index_ray], axis=1)[:, None]
        assert np.abs(np.cross(locations - rays[0][index_ray], ways)).max() < 1e-6
        # A ray from outside goes in as often as out.
        counts = np.bincount(index_ray, minlength=len(rays[0]))
        is_inside = torus.ray.contains_points(rays[0])
        np.testing.assert_array_equal(counts % 2, is_inside)
        assert (counts.max(), is_inside.sum() > 50) == (4, True)
        # Each depth in the order of the rays, and depths after one another along each ray.
        depth = np.cumsum(np.concatenate(([0], np.diff(index_ray) <= 0)))
        assert depth.max() == 3
        t = ((locations - rays[0][index_ray]) * ways).sum(axis=1)
        order = np.lexsort((depth, index_ray))
        assert (np.diff(t[order])[np.diff(index_ray[order]) == 0] > 0).all()
        for most in (1, 2, 3):
            check_same(
                torus.ray.intersects_id(*rays, max_hits=most), (index_tri[depth < most], index_ray[depth < most])
            )

    def test_rays_that_are_none_hit_nothing(self, box):
        origins = np.array([[0, 0, 5], [np.nan, 0, 5], [0, 0, 5], [0, np.inf, 0], [0, 0, 5]], float)
        directions = np.array([[0, 0, -1], [0, 0, -1], [0, 0, 0], [0, -1, 0], [0, -np.inf, 0]], float)
        expected = [True, False, False, False, False]
        assert box.ray.intersects_any(origins, directions).tolist() == expected
        assert (box.ray.intersects_first(origins, directions) >= 0).tolist() == expected
        assert box.ray.intersects_id(origins, directions)[1].tolist() == [0, 0]
        assert np.isnan(origins[1, 0])


def test_what_is_refused(box):
    ray, query, at = box.ray, box.nearest, [[0, 0, 0.5]]
    empty, scene = trimesh.Trimesh(), trimesh.Scene()
    thickness = clbvh.integrations.trimesh.thickness
    rows = [
        (lambda: ray.intersects_id(at, [[0, 0, 1]] * 2), QueryError, "Ray origin and direction don't"),
        (lambda: ray.intersects_first([0, 0, 5], [0, 0, -1]), ValueError, "shape"),
        (lambda: ray.contains_points([0, 0, 0]), QueryError, r"points must be \(n,3\)"),
        (lambda: RayMeshIntersector(empty).intersects_any(*DOWN), MeshError, "faces|vertices"),
        (lambda: RayMeshIntersector(empty).contains_points(at), MeshError, "without faces contains no"),
        (lambda: RayMeshIntersector(box, device="no such board").intersects_any(*DOWN), DeviceError, "no such board"),
        (lambda: ProximityQuery(box, device=0.0), ConfigError, "device must be"),
        (lambda: thickness(box, at, normals=[0, 0, 1]), QueryError, r"normals must be \(n,3\)"),
        (lambda: thickness(box, at, method="sphere"), ConfigError, "'max_sphere' or 'ray', not 'sphere'"),
        (lambda: query.vertex([[0, 0, 0], [0, np.inf, 0]]), QueryError, r"points\[1\] is not finite"),
        (lambda: ProximityQuery(empty).vertex(at), QueryError, "without vertices"),
        (lambda: SceneRay(box), SceneError, "expected a trimesh.Scene, not Trimesh: for one"),
        (lambda: SceneRay(scene).intersects_any(*DOWN), SceneError, "no node with a triangle mesh"),
    ]
    for call, error, words in rows:
        with pytest.raises(error, match=words):
            call()


def test_a_ray_from_on_the_surface_meets_both_sides_at_any_scale(session):
    for scale in (1e-6, 1.0, 1e8):
        scaled = RayMeshIntersector(trimesh.creation.box().subdivide().apply_scale(scale))
        assert len(scaled.intersects_id([[0, 0, scale / 2]], [[0, 0, -1]])[0]) == 2, scale


class TestContains:
    def test_through_a_hole_points_get_outside(self, session):
        mesh = trimesh.creation.icosphere()
        mesh.update_faces(np.arange(len(mesh.faces)) % 50 != 0)
        points = np.random.default_rng(82).uniform(-1, 1, (4000, 3))
        radius = np.linalg.norm(points, axis=1)
        contains = RayMeshIntersector(mesh).contains_points(points)
        assert 0.9 < contains[radius < 0.9].mean() < 1
        assert not contains[radius > 1].any()


@pytest.fixture
def work(monkeypatch):
    """What was built, opened and compiled."""
    done = []

    def note(module, name):
        function = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *a, **k: done.append(name) or function(*a, **k))

    note(tracers, "build")
    note(tracers, "Tracer")
    note(program, "_compile")
    return done


def wobble(mesh, frame):
    """Move all vertices by about a tenth of the mesh's size."""
    vertices = np.array(mesh.vertices)
    mesh.vertices = vertices + 0.1 * np.sin(3 * vertices[:, ::-1] + frame)


def ask(mesh):
    """Answers of every kind of query."""
    return (
        mesh.ray.intersects_first(*MOVING_RAYS),
        *mesh.ray.intersects_location(*MOVING_RAYS),
        mesh.ray.contains_points(MOVING_RAYS[0]),
        *mesh.nearest.on_surface(MOVING_RAYS[0]),
        *mesh.nearest.vertex(MOVING_RAYS[0]),
    )


def ask_new(mesh):
    """The same of a new mesh with new engines."""
    return ask(with_engines(trimesh.Trimesh(np.array(mesh.vertices), np.array(mesh.faces), process=False)))


class TestChanges:
    def test_a_mesh_that_moves_is_updated_in_place(self, torus, work):
        ask(torus)
        assert work.count("Tracer") == work.count("build") == 1
        for frame in range(5):
            wobble(torus, frame)
            work.clear()
            answers = ask(torus)
            assert not {"build", "Tracer"} & {*work}
            check_same(answers, ask_new(torus))

    def test_after_a_close_an_engine_opens_again(self, torus):
        for frame in range(2):
            before = ask(torus)
            torus.ray.close()
            check_same(ask(torus), before)
            torus.ray._tracer.open_tracer.close()
            wobble(torus, frame)
            check_same(ask(torus), ask_new(torus))
            wobble(torus, frame)
            moved = ask(torus)
            torus.ray._tracer.give_way()
            check_same(ask(torus), moved)

    def test_other_faces_and_other_numbers_of_them_are_seen(self, box):
        first = box.ray.intersects_first(*DOWN)[0]
        order = np.roll(np.arange(12), 1)
        box.faces = box.faces[order]
        assert order[box.ray.intersects_first(*DOWN)[0]] == first
        assert len(box.ray.intersects_id(*DOWN)[0]) == 2
        box.update_faces(box.face_normals[:, 2] < 0.5)
        assert len(box.ray.intersects_id(*DOWN)[0]) == 1

    def test_a_mesh_that_goes_back(self, torus):
        """The content that was known last does not stand for the one that the tracer has."""
        before, vertices = ask(torus), np.array(torus.vertices)
        for frame in range(3):
            wobble(torus, frame)
            torus.ray.intersects_first(*MOVING_RAYS)
            torus.vertices = vertices
            check_same(ask(torus), before)

    def test_vertices_that_no_tree_can_have_are_refused_until_they_are_mended(self, torus):
        before, vertices = ask(torus), np.array(torus.vertices)
        torus.vertices = np.where(np.arange(len(vertices))[:, None] == 7, np.nan, vertices)
        for _ in range(2):
            with pytest.raises(MeshError, match="vertex 7"):
                torus.ray.intersects_first(*DOWN)
        torus.vertices = vertices
        check_same(ask(torus), before)

    @pytest.mark.parametrize("is_done", [True, False])
    def test_ctrl_c_in_an_update(self, torus, monkeypatch, is_done):
        before, vertices, update = ask(torus), np.array(torus.vertices), Tracer.update

        def interrupt(self, moved):
            if is_done:
                update(self, moved)
            raise KeyboardInterrupt

        monkeypatch.setattr(Tracer, "update", interrupt)
        wobble(torus, 0)
        with pytest.raises(KeyboardInterrupt):
            torus.ray.intersects_first(*DOWN)
        monkeypatch.undo()
        torus.vertices = vertices
        check_same(ask(torus), before)

    def test_threads_ask_about_a_mesh_that_has_moved(self, torus):
        for frame in range(3):
            wobble(torus, frame)
            expected = ask_new(torus)
            for answer in run_in_threads(*[lambda: ask(torus)] * 4):
                check_same(answer, expected)


def test_meshes_of_other_forms(box, tmp_path):
    arrays = np.array(box.vertices), np.array(box.faces)
    box.export(tmp_path / "box.ply")
    for thing in (clbvh.Mesh.from_arrays(*arrays), arrays, str(tmp_path / "box.ply")):
        locations, index_ray, index_tri = RayMeshIntersector(thing).intersects_location(*DOWN)
        assert index_ray.tolist() == [0, 0]
        np.testing.assert_allclose(locations, [[0.1, 0.2, 0.5], [0.1, 0.2, -0.5]], atol=1e-7)
        assert len(set(index_tri)) == 2
        assert ProximityQuery(thing).signed_distance([[0, 0, 0.4], [0, 0, 2]]) == pytest.approx([0.1, -1.5])


def test_an_engine_by_winding_numbers_needs_no_closed_mesh(session):
    ball = trimesh.creation.icosphere(3)
    points = np.random.default_rng(0).uniform(-1.2, 1.2, (3000, 3))
    inside = np.linalg.norm(points, axis=1) < 0.98
    sure = inside | (np.linalg.norm(points, axis=1) > 1.02)
    ball.update_faces(np.random.default_rng(1).random(len(ball.faces)) > 0.04)
    engine = RayMeshIntersector(ball, device=session.info, rule="winding")
    assert (engine.contains_points(points)[sure] == inside[sure]).mean() > 0.998
    scene = SceneRay(
        trimesh.Scene([ball, ball.copy().apply_translation([3, 0, 0])]), device=session.info, rule="winding"
    )
    assert scene.contains_points([[0, 0, 0], [3, 0, 0], [1.5, 0, 0]]).tolist() == [True, True, False]
    with pytest.raises(clbvh.ConfigError, match="rule"):
        RayMeshIntersector(ball, rule="odd")
