"""The k nearest primitives of points, against every primitive in float64."""

import numpy as np
import pytest
import trimesh

from clbvh import Scene, Spheres, Tracer, make_shape
from clbvh.errors import ConfigError, QueryError
from clbvh.structs import LAYOUT_WIDTHS
from clbvh.trace.points import nearest

from .scene_distances import distance_to_ellipsoid
from .test_points_in_scenes import make_linear, make_scene, make_transform, points_around

LAYOUTS = list(LAYOUT_WIDTHS)
K = 6


class Primitives:
    """The distances of points from every primitive of a scene, in float64."""

    def __init__(self, scene, points):
        columns, ids = [], []
        for instance in scene.instances:
            shape, linear, offset = instance.geometry.shape, instance.transform[:3, :3], instance.transform[:3, 3]
            if isinstance(shape, Spheres):
                placed = zip(shape.centres @ linear.T + offset, shape.radii, strict=True)
                own = [distance_to_ellipsoid(points, centre, linear * radius) for centre, radius in placed]
            else:
                placed = (shape.vertices @ linear.T)[shape.faces]
                # The formula has tolerances, which suit triangles in a box of about this size.
                scale = 10 / np.abs(placed).max()
                own = [distance_to_triangle(corners, (points - offset) * scale) / scale for corners in placed * scale]
            columns += own
            ids += [(instance.id, prim) for prim in range(len(own))]
        self.distance, self.ids = np.stack(columns, axis=1), np.array(ids)

    def check(self, closest, k, reach, seen=None):
        """Check the k nearest primitives of all points, given which columns each of them sees."""
        distance = self.distance if seen is None else np.where(seen, self.distance, np.inf)
        expected = np.sort(distance, axis=1)[:, :k]
        np.testing.assert_allclose(closest.distance, expected, rtol=0, atol=1e-12 * reach)
        assert (closest.distance[:, 1:] >= closest.distance[:, :-1]).all()
        is_found = np.isfinite(expected)
        for array in (closest.prim_id, closest.instance_id, closest.geometry_id):
            np.testing.assert_array_equal(array == -1, ~is_found)
        column = np.searchsorted(
            self.ids @ [10**6, 1], (closest.instance_id.astype(np.int64) * 10**6 + closest.prim_id)[is_found]
        )
        point = np.broadcast_to(np.arange(len(distance))[:, None], expected.shape)[is_found]
        np.testing.assert_allclose(distance[point, column], expected[is_found], rtol=0, atol=1e-12 * reach)
        # No primitive comes twice.
        for row, own in enumerate(np.split(column, np.cumsum(is_found.sum(axis=1))[:-1])):
            assert len(np.unique(own)) == is_found[row].sum()


def distance_to_triangle(corners, points):
    closest = trimesh.triangles.closest_point(np.broadcast_to(corners, (len(points), 3, 3)), points)
    return np.linalg.norm(closest - points, axis=1)


@pytest.fixture(scope="module", params=["mesh", "spheres", "scene"])
def known(request):
    """A scene, points, and their distances."""
    generator = np.random.default_rng([1450, len(request.param)])
    scene = make_scene(generator, 10) if request.param == "scene" else Scene()
    if request.param == "mesh":
        scene.place(scene.add(make_shape("knot", triangles=170)))
    if request.param == "spheres":
        scene.place(scene.add(Spheres(generator.normal(size=(40, 3)), 10.0 ** generator.uniform(-2, -0.5, 40))))
    points = points_around(scene, generator, 60)
    return scene, points, Primitives(scene, points)


def reach_of(points, scene):
    return np.abs(points).max() + max(np.abs(instance.transform).max() for instance in scene.instances)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_they_are_right(session, known, layout):
    scene, points, expected = known
    with Tracer(scene, device=session.info, layout=layout) as tracer:
        closest = tracer.closest_points(points, K)
    assert closest.point.shape == (len(points), K, 3)
    expected.check(closest, K, reach_of(points, scene))
    away = np.linalg.norm(closest.point - points[:, None], axis=2)
    np.testing.assert_allclose(away, closest.distance, rtol=0, atol=1e-13 * reach_of(points, scene))


def test_layouts_batches_and_rounds_give_the_same_bytes(session, known, monkeypatch):
    scene, points, _ = known
    answers = []
    for layout in LAYOUTS:
        with Tracer(scene, device=session.info, layout=layout) as tracer:
            answers.append(tracer.closest_points(points, K))
    monkeypatch.setattr(nearest, "_MOST_SLOTS", 100)
    monkeypatch.setattr(nearest, "_SPARE_SLOTS", 1)
    with Tracer(scene, device=session.info) as tracer:
        answers.append(tracer.closest_points(points, K))
    for of_layout in answers[1:]:
        for obtained, expected in zip(
            (*of_layout, of_layout.instance_id), (*answers[0], answers[0].instance_id), strict=True
        ):
            assert obtained.tobytes() == expected.tobytes()


@pytest.mark.parametrize("k", [1, 2, 50, 100_000])
def test_any_number_of_them(session, known, k):
    scene, points, expected = known
    with Tracer(scene, device=session.info) as tracer:
        closest, one = tracer.closest_points(points[:9], k), tracer.closest_point(points[:9])
    np.testing.assert_allclose(closest.distance[:, 0], one.distance, rtol=0, atol=1e-6 * reach_of(points, scene))
    count = expected.distance.shape[1]
    if k > count:
        assert np.isposinf(closest.distance[:, count:]).all()
        assert np.isnan(closest.point[:, count:]).all()
        assert (closest.prim_id[:, count:] == closest.instance_id[:, count:]).all()
        assert (np.sort(closest.prim_id[:, :count].ravel()) >= 0).all()


def test_only_what_is_seen_counts(session):
    generator = np.random.default_rng(1460)
    scene = make_scene(generator)
    points = points_around(scene, generator, 40)
    expected, reach = Primitives(scene, points), reach_of(points, scene)
    of_instance = expected.ids[:, 0]
    masks = generator.integers(0, 16, len(points)).astype(np.uint32)
    own = np.array([instance.mask for instance in scene.instances])[of_instance]
    geometry = scene.geometries[1]
    of_geometry = np.array([instance.geometry is geometry for instance in scene.instances])[of_instance]
    with Tracer(scene, device=session.info) as tracer:
        expected.check(tracer.closest_points(points, K, mask=masks), K, reach, (masks[:, None] & own) != 0)
        expected.check(tracer.closest_points(points, K, instance=[2, 5]), K, reach, np.isin(of_instance, [2, 5]))
        expected.check(tracer.closest_points(points, K, geometry=geometry), K, reach, of_geometry)
        expected.check(tracer.closest_points(points, K, instance=[]), K, reach, np.zeros(len(own), bool))


def test_a_lone_mesh_is_hidden_by_masks(session):
    with Tracer(make_shape("icosphere", triangles=80), device=session.info) as tracer:
        closest = tracer.closest_points([[0, 0, 3], [0, 0, 3]], 2, mask=[0, 4])
    np.testing.assert_array_equal(closest.prim_id[0], [-1, -1])
    assert (closest.prim_id[1] >= 0).all()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_ties_are_in_the_order_of_instances_and_primitives(session, layout):
    mesh = make_shape("icosphere", triangles=80)
    transform = make_transform(make_linear("shear", np.random.default_rng(1470)), [1, 2, 3])
    scene = Scene()
    shape = scene.add(mesh)
    for _ in range(3):
        scene.place(shape, transform)
    points = mesh.vertices @ transform[:3, :3].T + [1, 2, 3]
    with Tracer(scene, device=session.info, layout=layout) as tracer:
        closest = tracer.closest_points(points, 4)
    for vertex, (prim_id, instance_id) in enumerate(zip(closest.prim_id, closest.instance_id, strict=True)):
        faces = np.flatnonzero((mesh.faces == vertex).any(axis=1))
        assert prim_id.tolist() == faces[:4].tolist()
        assert instance_id.tolist() == [0] * 4


@pytest.mark.parametrize("triangles", [80, 5120])
def test_from_the_middle_all_are_about_equally_near(session, triangles):
    mesh = make_shape("icosphere", triangles=triangles)
    with Tracer(mesh, device=session.info) as tracer:
        closest = tracer.closest_points([0, 0, 0], 10)
    distance = np.array([distance_to_triangle(corners, np.zeros((1, 3)))[0] for corners in mesh.vertices[mesh.faces]])
    np.testing.assert_allclose(closest.distance, np.sort(distance)[:10], rtol=0, atol=1e-14)
    # As many are ties, to the rounding of their distances: the first of them are named.
    least = np.flatnonzero(distance <= distance.min() + 1e-14)
    np.testing.assert_array_equal(closest.prim_id[: len(least)], least[:10])


def test_points_far_away_and_near_in_a_scene_of_all_sizes(session):
    generator = np.random.default_rng(1480)
    scene = Scene()
    ball, knot = (
        scene.add(Spheres(generator.normal(size=(30, 3)), np.full(30, 0.1))),
        scene.add(make_shape("knot", triangles=170)),
    )
    for i, size in enumerate((1e-6, 1, 1e-3)):
        scene.place(knot, make_transform(size * make_linear("scale", generator), [3 * i, 0, 0]))
        scene.place(ball, make_transform(size * make_linear("shear", generator), [3 * i, 5, 0]))
    points = np.concatenate((generator.normal(size=(40, 3)) * 300, generator.normal(size=(40, 3)) * 3e-6))
    with Tracer(scene, device=session.info) as tracer:
        closest = tracer.closest_points(points, K)
    expected = np.sort(Primitives(scene, points).distance, axis=1)[:, :K]
    np.testing.assert_allclose(closest.distance, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("shape", [(), (0,), (2, 3)])
def test_leading_shapes(session, shape):
    with Tracer(make_shape("icosphere", triangles=80), device=session.info) as tracer:
        closest = tracer.closest_points(np.zeros((*shape, 3)), 2)
    assert closest.distance.shape == closest.geometry_id.shape == closest.instance_id.shape == (*shape, 2)
    assert closest.point.shape == (*shape, 2, 3)


@pytest.mark.parametrize("k", [0, -1, 1.5, True, "2"])
def test_other_numbers_are_refused(session, k):
    with (
        Tracer(make_shape("icosphere", triangles=20), device=session.info) as tracer,
        pytest.raises(ConfigError, match=r"^k must be an integer of at least 1, not "),
    ):
        tracer.closest_points([0, 0, 0], k)


def test_errors_name_the_point(session):
    with (
        Tracer(make_shape("icosphere", triangles=20), device=session.info) as tracer,
        pytest.raises(QueryError, match=r"^points\[1\] is not finite: "),
    ):
        tracer.closest_points([[0, 0, 0], [0, np.nan, 0]], 3)


def test_progress_counts_points(session, monkeypatch):
    monkeypatch.setattr(nearest, "_MOST_SLOTS", 100)
    done = []
    with Tracer(make_shape("icosphere", triangles=80), device=session.info) as tracer:
        tracer.closest_points(np.zeros((30, 3)) + 2, 2, progress=lambda now, total: done.append((now, total)))
    assert done == [(10, 30), (20, 30), (30, 30)]
