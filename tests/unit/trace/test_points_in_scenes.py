"""The closest point, the inside and the signed distance in scenes, against every placed primitive in float64."""

import copy
import pickle
import warnings

import numpy as np
import pytest

from clbvh import Mesh, Scene, Spheres, Tracer, make_shape
from clbvh.errors import OpenMeshWarning, QueryError, SceneError
from clbvh.structs import LAYOUT_WIDTHS
from clbvh.trace.rays import pieces

from .nearest_point import CHOICE
from .scene_distances import SceneDistances

# Float32 chooses the primitive, after the roundings of the placement and of the distance.
ROUNDINGS = 2 * CHOICE

KINDS = ["rigid", "similar", "mirror", "scale", "shear"]

LAYOUTS = list(LAYOUT_WIDTHS)


def make_linear(kind, generator):
    """The linear part of a transform."""
    rotation, other = (np.linalg.qr(generator.normal(size=(3, 3)))[0] for _ in range(2))
    if np.linalg.det(rotation) < 0:
        rotation[:, 0] *= -1
    sizes = 10.0 ** generator.uniform(-0.7, 0.7, 3)
    if kind == "rigid":
        return rotation
    if kind == "similar":
        return rotation * sizes[0]
    if kind == "mirror":
        return rotation @ np.diag([1, -1, 1]) * sizes[0]
    if kind == "scale":
        return rotation @ np.diag(sizes)
    return rotation @ np.diag(sizes) @ other


def make_transform(linear, offset=(0, 0, 0)):
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = linear, offset
    return transform


def make_spheres(generator, count=12):
    return Spheres(generator.normal(size=(count, 3)), 10.0 ** generator.uniform(-2, -0.5, count))


def make_scene(generator, instances=12, *, spread=6.0):
    """A scene of closed meshes and spheres under all kinds of transforms, some of which overlap."""
    scene = Scene()
    geometries = [
        scene.add(make_shape("knot", triangles=170)),
        scene.add(make_spheres(generator)),
        scene.add(make_shape("icosphere", triangles=80)),
    ]
    for i in range(instances):
        transform = make_transform(make_linear(KINDS[i % len(KINDS)], generator), generator.normal(size=3) * spread)
        scene.place(geometries[generator.integers(3)], transform, mask=1 << int(generator.integers(4)))
    return scene


def points_around(scene, generator, count=200):
    """Points anywhere, and on and near the surfaces of all instances."""
    points = [generator.normal(size=(count, 3)) * 10]
    for instance in scene.instances:
        shape, linear = instance.geometry.shape, instance.transform[:3, :3]
        if isinstance(shape, Spheres):
            directions = generator.normal(size=(12, 3))
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            on = shape.centres[:12] + directions * shape.radii[:12, None] * generator.choice([0, 0.5, 1], (12, 1))
        else:
            on = np.concatenate((shape.vertices[:6], shape.vertices[shape.faces[:6]].mean(axis=1)))
        placed = on @ linear.T + instance.transform[:3, 3]
        points += [placed, placed + generator.normal(size=placed.shape) * 0.01]
    return np.concatenate(points)


@pytest.fixture(scope="module", params=[1330, 1331])
def known(request):
    """A scene, points, and their distances."""
    generator = np.random.default_rng(request.param)
    scene = make_scene(generator)
    points = points_around(scene, generator)
    return scene, points, SceneDistances(scene, points)


def reach_of(points, scene):
    return np.abs(points).max() + max(np.abs(instance.transform).max() for instance in scene.instances)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_closest_points_are_right(session, known, layout):
    scene, points, expected = known
    reach = reach_of(points, scene)
    with Tracer(scene, device=session.info, layout=layout) as tracer:
        closest = tracer.closest_point(points)
    error = closest.distance - expected.closest()
    assert (error >= -1e-12 * reach).all()
    assert (error <= ROUNDINGS * reach).all()
    # The point is as far as it says, and on the instance that is named.
    away = np.linalg.norm(closest.point - points, axis=1)
    np.testing.assert_allclose(away, closest.distance, rtol=0, atol=1e-13 * reach)
    own = expected.distance[closest.instance_id, np.arange(len(points))]
    np.testing.assert_allclose(closest.distance, own, rtol=0, atol=ROUNDINGS * reach)
    on = SceneDistances(scene, closest.point).distance[closest.instance_id, np.arange(len(points))]
    assert (on <= 1e-9 * reach).all()
    np.testing.assert_array_equal(closest.geometry_id, scene.snapshot().geometry_ids[closest.instance_id])


@pytest.mark.parametrize("layout", LAYOUTS)
def test_contains_and_signed_distance_are_right(session, known, layout):
    scene, points, expected = known
    sure = expected.closest() > 1e-5 * reach_of(points, scene)
    with Tracer(scene, device=session.info, layout=layout) as tracer:
        inside, signed = tracer.contains(points), tracer.signed_distance(points)
    np.testing.assert_array_equal(inside[sure], expected.contains()[sure])
    assert 0.05 < inside.mean() < 0.9
    error = np.abs(signed - expected.signed())[sure]
    assert (error <= ROUNDINGS * reach_of(points, scene)).all()


def test_layouts_give_the_same_bytes(session, known):
    scene, points, _ = known
    answers = []
    for layout in LAYOUTS:
        with Tracer(scene, device=session.info, layout=layout) as tracer:
            closest = tracer.closest_point(points)
            signed = tracer.signed_distance(points)
            answers.append([*closest, closest.instance_id, tracer.contains(points), signed])
    for of_layout in answers[1:]:
        for obtained, expected in zip(of_layout, answers[0], strict=True):
            assert obtained.tobytes() == expected.tobytes()


class TestSeen:
    """Masks, geometries and instances."""

    @pytest.mark.parametrize("mask", [1, 6, 0xF, 0xFFFFFFF0, "each"])
    def test_masks(self, session, known, mask):
        scene, points, _ = known
        if mask == "each":
            mask = np.random.default_rng(1340).integers(0, 16, len(points)).astype(np.uint32)
        masks = np.array([instance.mask for instance in scene.instances], np.uint32)
        self.check(session, known, (masks[:, None] & np.uint32(mask)) != 0, mask=mask)

    def test_a_geometry(self, session, known):
        scene = known[0]
        for geometry in scene.geometries:
            seen = np.array([instance.geometry is geometry for instance in scene.instances])
            self.check(session, known, seen[:, None], geometry=geometry)

    def test_instances(self, session, known):
        scene = known[0]
        ids = np.arange(len(scene.instances))
        for chosen in (scene.instances[3], 5, [scene.instances[1], 4], ids[::2], list(scene.instances), []):
            wanted = [chosen] if not hasattr(chosen, "__len__") else chosen
            wanted = [instance if isinstance(instance, int | np.integer) else instance.id for instance in wanted]
            self.check(session, known, np.isin(ids, wanted)[:, None], instance=chosen)

    def test_a_geometry_and_a_mask(self, session, known):
        scene = known[0]
        geometry = scene.geometries[1]
        seen = np.array([instance.geometry is geometry and bool(instance.mask & 3) for instance in scene.instances])
        self.check(session, known, seen[:, None], geometry=geometry, mask=3)

    def check(self, session, known, seen, **options):
        scene, points, expected = known
        reach = reach_of(points, scene)
        with Tracer(scene, device=session.info) as tracer:
            closest = tracer.closest_point(points, **options)
            inside, signed = tracer.contains(points, **options), tracer.signed_distance(points, **options)
        is_seen = np.broadcast_to(seen.any(axis=0), len(points))
        assert np.isposinf(closest.distance[~is_seen]).all()
        assert np.isneginf(signed[~is_seen]).all()
        assert (closest.instance_id[~is_seen] == -1).all()
        assert (closest.geometry_id[~is_seen] == -1).all()
        assert np.isnan(closest.point[~is_seen]).all()
        assert not inside[~is_seen].any()
        own = np.broadcast_to(seen, expected.distance.shape)[closest.instance_id, np.arange(len(points))]
        assert own[is_seen].all()
        error = closest.distance[is_seen] - expected.closest(seen)[is_seen]
        assert (np.abs(error) <= ROUNDINGS * reach).all()
        sure = is_seen & (expected.closest(seen) > 1e-5 * reach)
        np.testing.assert_array_equal(inside[sure], expected.contains(seen)[sure])
        assert (np.abs(signed[sure] - expected.signed(seen)[sure]) <= ROUNDINGS * reach).all()


def test_ties_go_to_the_smallest_instance_and_face(session):
    generator = np.random.default_rng(1350)
    mesh = make_shape("icosphere", triangles=80)
    points = np.concatenate((mesh.vertices * 1.5, generator.normal(size=(200, 3))))
    transform = make_transform(make_linear("shear", generator), [1, 2, 3])
    points = points @ transform[:3, :3].T + transform[:3, 3]
    scene = Scene()
    shape = scene.add(mesh)
    scene.place(shape, make_transform(np.eye(3), [1e3, 0, 0]))
    for _ in range(9):
        scene.place(shape, transform)
    for layout in LAYOUTS:
        with Tracer(scene, device=session.info, layout=layout) as tracer:
            closest = tracer.closest_point(points)
        assert (closest.instance_id == 1).all()
        # Of a vertex all faces are equally near.
        expected = [np.flatnonzero((mesh.faces == vertex).any(axis=1)).min() for vertex in range(12)]
        on_vertex = np.linalg.norm(closest.point[:12] - (mesh.vertices[:12] @ transform[:3, :3].T + [1, 2, 3]), axis=1)
        np.testing.assert_array_equal(closest.prim_id[:12][on_vertex < 1e-12], np.array(expected)[on_vertex < 1e-12])


@pytest.mark.parametrize("far", [0.0, 1e7, 1e12])
@pytest.mark.parametrize("size", [1e-3, 1.0])
def test_instances_far_from_the_origin(session, far, size):
    """Float64 holds coordinates there to 2e-16 of the offset."""
    generator = np.random.default_rng(1360)
    offset = far * np.array([1.0, -0.5, 0.25])
    near = Scene()
    distant = Scene()
    for scene, move in ((near, 0), (distant, offset)):
        generator = np.random.default_rng(1361)
        shapes = [scene.add(make_shape("knot", triangles=170)), scene.add(make_spheres(generator))]
        for i in range(4):
            linear = make_linear(KINDS[i], generator) * size
            scene.place(shapes[i % 2], make_transform(linear, generator.normal(size=3) * size + move))
    points = points_around(near, np.random.default_rng(1362), 50)
    points = points[np.abs(points).max(axis=1) < 20 * size]
    expected = SceneDistances(near, points)
    with Tracer(distant, device=session.info) as tracer:
        closest = tracer.closest_point(points + offset)
        inside = tracer.contains(points + offset)
    bound = ROUNDINGS * 30 * size + 1e-15 * far
    assert (np.abs(closest.distance - expected.closest()) <= bound).all()
    sure = expected.closest() > 1e-5 * size + 2e-15 * far
    np.testing.assert_array_equal(inside[sure], expected.contains()[sure])


def test_small_instances_in_a_large_scene(session):
    """Two instances, each a millionth of the scene, are as exact as by themselves."""
    generator = np.random.default_rng(1370)
    mesh, spheres = make_shape("knot", triangles=170), make_spheres(generator)
    for shape in (mesh, spheres):
        scene = Scene()
        geometry = scene.add(shape)
        linear = make_linear("shear", generator) * 1e-6
        scene.place(geometry, make_transform(linear, [1, 1, 1]))
        scene.place(geometry, make_transform(linear, [-1, -1, -1]))
        points = generator.normal(size=(500, 3)) * 2 @ linear.T + 1
        expected = SceneDistances(scene, points).closest()
        with Tracer(scene, device=session.info) as tracer:
            distance = tracer.closest_point(points).distance
        assert (np.abs(distance - expected) <= ROUNDINGS * 2e-5 + 1e-15).all()


def test_an_instance_of_a_trillionth_of_the_scene(session):
    """Products of four of its coordinates would underflow float32."""
    generator = np.random.default_rng(1371)
    scene = Scene()
    geometry = scene.add(make_shape("knot", triangles=170))
    for size, x in ((1, -5), (1e-12, 0), (1, 5)):
        scene.place(geometry, make_transform(size * np.eye(3), [x, 0, 0]))
    points = generator.normal(size=(500, 3)) * 2e-12
    expected = SceneDistances(scene, points).closest()
    with Tracer(scene, device=session.info) as tracer:
        distance = tracer.closest_point(points).distance
    assert (np.abs(distance - expected) <= ROUNDINGS * 2e-11).all()


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_tiny_and_huge_scenes(session, scale):
    generator = np.random.default_rng(1380)
    scene, scaled = make_scene(generator, 6), Scene()
    for geometry in scene.geometries:
        scaled.add(geometry.shape)
    for instance in scene.instances:
        transform = instance.transform
        transform[:3] *= scale
        scaled.place(scaled.geometries[instance.geometry.id], transform)
    points = points_around(scene, generator, 200)
    with Tracer(scene, device=session.info) as one, Tracer(scaled, device=session.info) as other:
        expected, obtained = one.closest_point(points), other.closest_point(points * scale)
        agree = obtained.instance_id == expected.instance_id
        assert agree.mean() > 0.99
        np.testing.assert_allclose(
            obtained.distance / scale, expected.distance, rtol=0, atol=ROUNDINGS * reach_of(points, scene)
        )


@pytest.mark.parametrize("far", [1e3, 1e6, 1e15, 1e200])
def test_points_from_far_away(session, far):
    generator = np.random.default_rng(1390)
    scene = make_scene(generator, 8)
    directions = generator.normal(size=(100, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    with Tracer(scene, device=session.info) as tracer:
        closest = tracer.closest_point(far * directions)
        assert not tracer.contains(far * directions).any()
        signed = tracer.signed_distance(far * directions)
    np.testing.assert_array_equal(signed, -closest.distance)
    furthest = []
    for instance in scene.instances:
        shape, transform = instance.geometry.shape, instance.transform
        points = shape.centres if isinstance(shape, Spheres) else shape.vertices
        along = (points @ transform[:3, :3].T + transform[:3, 3]) @ directions.T
        if isinstance(shape, Spheres):
            along += shape.radii[:, None] * np.linalg.norm(directions @ transform[:3, :3], axis=1)
        furthest.append(along.max(axis=0))
    furthest = np.max(furthest, axis=0)
    slack = 60 / min(far, 1e3) * 10
    assert ((closest.point * directions).sum(axis=1) >= furthest - slack).all()
    np.testing.assert_allclose(closest.distance, far - furthest, rtol=0, atol=slack + far * 1e-15)


class TestBatches:
    @pytest.mark.parametrize("count", [0, 1, 65, 300])
    def test_any_number_of_points(self, session, known, count):
        scene, points, _ = known
        with Tracer(scene, device=session.info) as tracer:
            for query in (tracer.closest_point, lambda part: [tracer.contains(part), tracer.signed_distance(part)]):
                for part, whole in zip(query(points[:count]), query(points), strict=True):
                    assert part.tobytes() == whole[:count].tobytes()
            assert tracer.closest_point(points[:count]).instance_id.shape == (count,)

    def test_chunks_shapes_and_progress(self, session, known, monkeypatch):
        scene, points, _ = known
        points = points[:480]
        masks = np.random.default_rng(1400).integers(0, 16, len(points))
        with Tracer(scene, device=session.info) as tracer:
            whole = [*tracer.closest_point(points, mask=masks), tracer.contains(points, mask=masks)]
            monkeypatch.setattr(pieces, "CHUNK_RAYS", 250)
            told = []
            grid = points.reshape(16, 30, 3)
            closest = tracer.closest_point(
                grid, mask=masks.reshape(16, 30), progress=lambda done, total: told.append((done, total))
            )
            assert closest.instance_id.shape == (16, 30)
            parts = [*closest, tracer.contains(grid, mask=masks.reshape(16, 30))]
            for part, expected in zip(parts, whole, strict=True):
                assert part.tobytes() == expected.tobytes()
            assert told == [(250, 480), (480, 480)]
            # One mask for each row.
            rows = tracer.closest_point(grid, mask=np.arange(16)[:, None])
            one = tracer.closest_point(grid[7], mask=7)
            assert rows.distance[7].tobytes() == one.distance.tobytes()

    @pytest.mark.parametrize("query", ["closest_point", "contains", "signed_distance"])
    def test_errors(self, session, known, query):
        scene = known[0]
        with Tracer(scene, device=session.info) as tracer:
            ask = getattr(tracer, query)
            with pytest.raises(QueryError, match=r"^points\[1\] is not finite: "):
                ask([[0, 0, 0], [0, np.nan, 0]])
            with pytest.raises(QueryError, match="mask must be integers"):
                ask([[0, 0, 0]], mask=0.5)
            with pytest.raises(QueryError, match="shape that broadcasts to that of the points"):
                ask([[0, 0, 0]], mask=[1, 2])
            with pytest.raises(SceneError, match="belongs to another scene"):
                ask([[0, 0, 0]], geometry=Scene().add(make_shape("icosphere", triangles=20)))
            with pytest.raises(SceneError, match="there is no instance 99"):
                ask([[0, 0, 0]], instance=99)
        with pytest.raises(QueryError, match="closed"):
            ask([[0, 0, 0]])


class TestOneMesh:
    """A mesh that is placed once where it is takes the path of meshes."""

    def test_it_answers_as_the_mesh(self, session):
        mesh = make_shape("icosphere", triangles=320)
        scene = Scene()
        placed = scene.place(scene.add(mesh))
        points = np.random.default_rng(1410).normal(size=(500, 3))
        with Tracer(mesh, device=session.info) as plain, Tracer(scene, device=session.info) as tracer:
            for options in ({}, {"instance": placed}, {"geometry": placed.geometry}, {"mask": 4}):
                for obtained, expected in zip(
                    tracer.closest_point(points, **options), plain.closest_point(points), strict=True
                ):
                    assert obtained.tobytes() == expected.tobytes()
                np.testing.assert_array_equal(tracer.contains(points, **options), plain.contains(points))
            closest = plain.closest_point(points)
            assert closest.instance_id.tolist() == closest.geometry_id.tolist() == [0] * 500

    @pytest.mark.parametrize("hide", [{"mask": 0}, {"instance": []}, {"mask": "odd"}])
    def test_it_can_be_hidden(self, session, hide):
        scene = Scene()
        scene.place(scene.add(make_shape("icosphere", triangles=320)))
        points = np.random.default_rng(1411).normal(size=(6, 3)) / 10
        hidden = np.ones(6, np.bool_)
        if hide == {"mask": "odd"}:
            hide, hidden = {"mask": np.arange(6) % 2}, np.arange(6) % 2 == 0
        with Tracer(scene, device=session.info) as tracer:
            closest = tracer.closest_point(points, **hide)
            np.testing.assert_array_equal(np.isinf(closest.distance), hidden)
            np.testing.assert_array_equal(closest.instance_id, np.where(hidden, -1, 0))
            np.testing.assert_array_equal(tracer.contains(points, **hide), ~hidden)
            np.testing.assert_array_equal(np.isneginf(tracer.signed_distance(points, **hide)), hidden)


def test_points_follow_moving_instances(session):
    scene = Scene()
    ball = scene.add(Spheres([[0, 0, 0]], 1))
    first, second = scene.place(ball), scene.place(ball, make_transform(np.eye(3), [5, 0, 0]))
    with Tracer(scene, device=session.info) as tracer:
        assert tracer.closest_point([2, 0, 0]).instance_id == 0
        tracer.set_transforms([first, second], [make_transform(np.eye(3), [0, 9, 0]), np.diag([1, 2, 3, 1.0])])
        assert tracer.closest_point([2, 0, 0]).instance_id == 1
        np.testing.assert_allclose(tracer.signed_distance([[0, 0, 3.5], [0, 4, 0], [0, 0, 0]]), [-0.5, -2, 1])
        assert tracer.contains([[0, 0, 2.5]], instance=first).tolist() == [False]


def test_degenerate_triangles_have_no_closest_point(session):
    flat = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
    scene = Scene()
    geometry = scene.add(flat)
    for x in range(3):
        scene.place(geometry, make_transform(np.eye(3), [x, 1, 0]))
    with Tracer(scene, device=session.info) as tracer:
        closest = tracer.closest_point([[0, 0, 0]])
        assert (closest.distance[0], closest.prim_id[0], closest.instance_id[0]) == (np.inf, -1, -1)


def test_open_meshes_are_named_once(session):
    scene = Scene()
    triangle = scene.add(Mesh.from_arrays(np.eye(3), [[0, 1, 2]], name="leaf"))
    ball = scene.add(Spheres([[0, 0, 0]], 1))
    for shape in (triangle, ball):
        scene.place(shape, make_transform(2 * np.eye(3)))
    with Tracer(scene, device=session.info) as tracer:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            tracer.contains([0, 0, 0], geometry=ball)
            tracer.closest_point([0, 0, 0])
        with pytest.warns(OpenMeshWarning, match="^leaf is not closed.* signed_distance"):
            tracer.signed_distance([0, 0, 0])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            tracer.contains([0, 0, 0])


def test_results_are_tuples_of_three_with_ids(session, known):
    scene, points, _ = known
    with Tracer(scene, device=session.info) as tracer:
        closest = tracer.closest_point(points[:10])
    distance, point, prim_id = closest
    assert distance is closest.distance
    assert (point.shape, prim_id.dtype, closest.instance_id.dtype) == ((10, 3), np.int32, np.int32)
    for again in (copy.copy(closest), pickle.loads(pickle.dumps(closest))):
        assert type(again) is type(closest)
        np.testing.assert_array_equal(again.instance_id, closest.instance_id)
        np.testing.assert_array_equal(again.geometry_id, closest.geometry_id)
        np.testing.assert_array_equal(again.distance, distance)
