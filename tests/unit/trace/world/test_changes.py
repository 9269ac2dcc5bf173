"""Scenes that move: after each change, hits are those of a new tracer over the scene as it is now, byte for byte."""

import numpy as np
import pytest

import clbvh
from clbvh.builders import build as builders
from clbvh.errors import ConfigError, MeshError, QueryError, SceneError

LAYOUTS = ("bvh2", "bvh4", "bvh8")
KNOT = clbvh.make_shape("knot", triangles=1500)
BALL = clbvh.make_shape("icosphere", triangles=300)
MASKS = (1, 2, 4, 8)


def random_transforms(generator, count):
    matrices = np.tile(np.eye(4), (count, 1, 1))
    matrices[:, :3, :3] = [np.linalg.qr(generator.normal(size=(3, 3)))[0] for _ in range(count)]
    matrices[:, :3, 3] = generator.uniform(-5, 5, (count, 3))
    return matrices


def make_scene(knot, ball, spheres, transforms):
    """Two knots, a ball and some spheres."""
    scene = clbvh.Scene()
    shapes = scene.add(knot), scene.add(ball), scene.add(spheres)
    for shape, transform, mask in zip((shapes[0], *shapes), transforms, MASKS, strict=True):
        scene.place(shape, transform, mask=mask)
    return scene


@pytest.fixture(params=[0, 1], ids=lambda seed: f"seed{seed}")
def generator(request):
    return np.random.default_rng(request.param)


@pytest.fixture
def transforms(generator):
    return random_transforms(generator, 4)


@pytest.fixture
def spheres(generator):
    return clbvh.Spheres(generator.normal(size=(40, 3)), 0.1)


@pytest.fixture
def rays(generator):
    return generator.uniform(-7, 7, (4000, 3)), generator.normal(size=(4000, 3))


def bytes_of(hits):
    fields = hits.t, hits.u, hits.v, hits.prim_id, hits.instance_id, hits.geometry_id, hits.is_front, hits.locations
    return [np.ascontiguousarray(field).tobytes() for field in fields]


def assert_same(tracer, scene, rays, layout):
    with clbvh.Tracer(scene, layout=layout) as fresh:
        hits = fresh.closest_hit(*rays)
        assert len(np.unique(hits.instance_id)) > 2
        assert bytes_of(tracer.closest_hit(*rays)) == bytes_of(hits)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_vertices_centres_and_transforms_move(layout, generator, transforms, spheres, rays):
    scene = make_scene(KNOT, BALL, spheres, transforms)
    knot, _, dots = scene.geometries
    with clbvh.Tracer(scene, layout=layout) as tracer:
        # A little: the tree is refitted.
        bent = KNOT.vertices + 0.05 * np.sin(7 * KNOT.vertices[:, ::-1])
        tracer.set_vertices(knot, bent)
        assert_same(tracer, make_scene(KNOT.with_vertices(bent), BALL, spheres, transforms), rays, layout)
        # Beyond recognition: it is built anew.
        torn = clbvh.Mesh.from_arrays(generator.permutation(KNOT.vertices), KNOT.faces)
        tracer.set_vertices(knot, torn.vertices)
        assert_same(tracer, make_scene(torn, BALL, spheres, transforms), rays, layout)
        moved = clbvh.Spheres(spheres.centres[::-1] * 1.5, spheres.radii)
        tracer.set_vertices(dots, moved.centres)
        assert_same(tracer, make_scene(torn, BALL, moved, transforms), rays, layout)

        others = random_transforms(generator, 2)
        tracer.set_transforms([scene.instances[2], 0], others)
        transforms[[2, 0]] = others
        assert_same(tracer, make_scene(torn, BALL, moved, transforms), rays, layout)


@pytest.fixture
def built(monkeypatch):
    """The shapes over which trees have been built since the test began."""
    shapes, build = [], builders.build_shape
    monkeypatch.setattr(builders, "build_shape", lambda shape: shapes.append(shape) or build(shape))
    return shapes


@pytest.mark.parametrize("layout", LAYOUTS)
def test_spheres_are_refitted_until_their_tree_is_worn(layout, generator, transforms, spheres, rays, built):
    scene = make_scene(KNOT, BALL, spheres, transforms)
    knot, _, dots = scene.geometries
    with clbvh.Tracer(scene, layout=layout) as tracer:
        built.clear()
        for moved in (
            spheres.with_spheres(spheres.centres * [1, 1.1, 0.9] + 0.02, spheres.radii * 1.2),
            spheres.with_spheres(spheres.centres * 1e3, 100.0),  # with an origin and a scale of their own
            spheres.with_spheres(spheres.centres, spheres.radii),
        ):
            tracer.set_spheres(dots, moved.centres, moved.radii)
            assert_same(tracer, make_scene(KNOT, BALL, moved, transforms), rays, layout)
        moved = spheres.with_spheres(spheres.centres * [1, 0.8, 1.2])
        tracer.set_spheres(dots, moved.centres)
        assert_same(tracer, make_scene(KNOT, BALL, moved, transforms), rays, layout)
        # Each new tracer above has built the three of its own; the one whose spheres move, none.
        assert len(built) == 4 * 3
        # Where another geometry is built anew, spheres stay where they were moved to.
        torn = clbvh.Mesh.from_arrays(generator.permutation(KNOT.vertices), KNOT.faces)
        tracer.set_vertices(knot, torn.vertices)
        assert_same(tracer, make_scene(torn, BALL, moved, transforms), rays, layout)
        tracer.set_vertices(dots, spheres.centres)
        assert_same(tracer, make_scene(torn, BALL, spheres, transforms), rays, layout)
        built.clear()
        mixed = spheres.with_spheres(generator.permutation(spheres.centres))
        tracer.set_spheres(dots, mixed.centres)
        assert [len(shape.radii) for shape in built] == [40]
        assert_same(tracer, make_scene(torn, BALL, mixed, transforms), rays, layout)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_lone_spheres_move(layout, generator, rays, built):
    spheres = clbvh.Spheres(generator.normal(size=(300, 3)), 0.2)
    scene = clbvh.Scene()
    dots = scene.add(spheres)
    scene.place(dots)
    with clbvh.Tracer(scene, layout=layout) as tracer:
        built.clear()
        for moved in (
            spheres.with_spheres(spheres.centres + np.array([5.0, 0, 0]), generator.uniform(0.1, 0.3, 300)),
            spheres.with_spheres(spheres.centres * 0.01, 1e-3),
        ):
            tracer.set_spheres(dots, moved.centres, moved.radii)
            other = clbvh.Scene()
            other.place(other.add(moved))
            aimed = rays[0], generator.permutation(np.resize(moved.centres, rays[0].shape)) - rays[0]
            with clbvh.Tracer(other, layout=layout) as fresh:
                assert fresh.any_hit(*aimed).mean() > 0.99
                assert bytes_of(tracer.closest_hit(*aimed)) == bytes_of(fresh.closest_hit(*aimed))
        assert len(built) == 2


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_only_mesh_moves_with_and_without_an_instance(layout, generator, rays):
    scene = clbvh.Scene()
    geometry = scene.add(KNOT)
    instance = scene.place(geometry)
    with clbvh.Tracer(scene, layout=layout) as tracer:
        plain = tracer.closest_hit(*rays)
        assert set(np.unique(plain.instance_id)) == {-1, 0}
        tracer.set_vertices(geometry, KNOT.vertices * 1.01)
        with clbvh.Tracer(KNOT.with_vertices(KNOT.vertices * 1.01), layout=layout) as other:
            assert bytes_of(tracer.closest_hit(*rays)) == bytes_of(other.closest_hit(*rays))
        transform = random_transforms(generator, 1)[0]
        tracer.set_transforms(instance, transform)
        moved = clbvh.Scene()
        moved.place(moved.add(KNOT.with_vertices(KNOT.vertices * 1.01)), transform)
        with clbvh.Tracer(moved, layout=layout) as other:
            assert bytes_of(tracer.closest_hit(*rays)) == bytes_of(other.closest_hit(*rays))


def test_results_of_before_keep_their_locations(transforms, spheres, rays):
    scene = make_scene(KNOT, BALL, spheres, transforms)
    with clbvh.Tracer(scene) as tracer:
        hits = tracer.closest_hit(*rays)
        before = hits.locations
        tracer.set_transforms(range(4), np.tile(np.eye(4), (4, 1, 1)))
        np.testing.assert_array_equal(hits.locations, before)


def test_buffers_of_older_scenes_are_given_back(transforms, spheres):
    scene = make_scene(KNOT, BALL, spheres, transforms)
    with clbvh.Tracer(scene) as tracer:
        tracer.set_transforms(0, np.eye(4))
        # From the first shape that moves on, there are nodes and blocks to write the next one.
        count = tracer._caster.session.buffer_count + 2
        for step in range(20):
            tracer.set_transforms(0, np.eye(4))
            tracer.set_vertices(scene.geometries[0], KNOT.vertices * (1 + step / 1000))
            assert tracer._caster.session.buffer_count == count


@pytest.mark.parametrize("layout", LAYOUTS)
def test_rays_see_the_instances_that_share_a_bit_with_their_mask(layout, generator, transforms, spheres, rays):
    scene = make_scene(KNOT, BALL, spheres, transforms)
    with clbvh.Tracer(scene, layout=layout) as tracer:
        every = {bit: tracer.closest_hit(*rays, mask=bit) for bit in MASKS}
        for instance, hits in enumerate(every.values()):
            assert set(np.unique(hits.instance_id)) == {-1, instance}
        masks = generator.integers(0, 16, len(rays[0]))
        nearest = np.min([np.where(masks & bit, hits.t, np.inf) for bit, hits in every.items()], axis=0)
        np.testing.assert_array_equal(tracer.closest_hit(*rays, mask=masks).t, nearest)
        np.testing.assert_array_equal(tracer.any_hit(*rays, mask=masks), np.isfinite(nearest))
        counts = [np.where(masks & bit, tracer.count_hits(*rays, mask=bit), 0) for bit in MASKS]
        np.testing.assert_array_equal(tracer.count_hits(*rays, mask=masks), np.sum(counts, axis=0))
        np.testing.assert_array_equal(tracer.all_hits(*rays, mask=masks).counts, np.sum(counts, axis=0))


def test_a_mesh_without_instances_is_seen_by_every_mask_but_zero():
    with clbvh.Tracer(BALL) as tracer:
        assert tracer.any_hit([[0, 0, 5]] * 3, [0, 0, -1], mask=[0, 1, 0xFFFFFFFF]).tolist() == [False, True, True]


@pytest.mark.parametrize("mask", [-1, 2**32, 1.5, "all", [[1, 2], [3, 4]]])
def test_a_wrong_mask_is_refused(mask):
    with clbvh.Tracer(BALL) as tracer, pytest.raises(QueryError, match="mask must be"):
        tracer.any_hit([[0, 0, 5]] * 3, [0, 0, -1], mask=mask)


def test_wrong_changes_are_refused_and_change_nothing(transforms, spheres, rays):
    scene, other = (make_scene(KNOT, BALL, spheres, transforms) for _ in range(2))
    with clbvh.Tracer(scene) as tracer:
        before = bytes_of(tracer.closest_hit(*rays))
        late = scene.place(scene.geometries[0])
        for instances, matrices in (
            (other.instances[0], np.eye(4)),
            (late, np.eye(4)),
            (0, np.diag([0.0, 1, 1, 1])),
            (0, np.full((4, 4), np.nan)),
            ([0, 1], np.eye(4)),
            (99, np.eye(4)),
        ):
            with pytest.raises(SceneError):
                tracer.set_transforms(instances, matrices)
        with pytest.raises(MeshError):
            tracer.set_vertices(scene.geometries[0], KNOT.vertices[1:])
        with pytest.raises(SceneError):
            tracer.set_vertices(other.geometries[0], KNOT.vertices)
        dots = scene.geometries[2]
        for centres, radii in (
            (spheres.centres[1:], None),
            (spheres.centres, 0.0),
            (spheres.centres, np.nan),
            (spheres.centres, spheres.radii[1:]),
            (spheres.centres * np.nan, None),
        ):
            with pytest.raises(MeshError):
                tracer.set_spheres(dots, centres, radii)
        with pytest.raises(SceneError, match="set_vertices"):
            tracer.set_spheres(scene.geometries[0], KNOT.vertices)
        with pytest.raises(SceneError):
            tracer.set_spheres(other.geometries[2], spheres.centres)
        with pytest.raises(ConfigError, match="set_vertices"):
            tracer.update(KNOT.vertices)
        assert bytes_of(tracer.closest_hit(*rays)) == before
    with pytest.raises(QueryError, match="closed"):
        tracer.set_transforms(0, np.eye(4))


def test_a_mesh_is_a_scene_of_one_instance():
    above, down = [[0, 0, 9]], [[0, 0, -1]]
    with clbvh.Tracer(BALL) as tracer:
        before = tracer.closest_hit(above, down)
        tracer.set_transforms(0, clbvh.Transform(translate=(0, 0, 2)).matrix)
        np.testing.assert_allclose(tracer.closest_hit(above, down).t, before.t - 2, rtol=1e-12)
        assert tracer.closest_point(above, instance=0).instance_id.tolist() == [0]
        with pytest.raises(ConfigError, match="set_vertices"):
            tracer.update(BALL.vertices)
        tracer.set_transforms(0, np.eye(4))
        assert bytes_of(tracer.closest_hit(above, down)) == bytes_of(before)
        tracer.update(2 * BALL.vertices)
        assert tracer.mesh.vertices.tobytes() == (2 * BALL.vertices).tobytes()
    with pytest.raises(SceneError, match="instance"), clbvh.Tracer(BALL) as tracer:
        tracer.set_transforms(1, np.eye(4))


def test_a_scene_of_one_mesh_in_its_place_moves_as_a_mesh():
    with clbvh.Tracer(clbvh.Scene(BALL)) as tracer:
        tracer.update(2 * BALL.vertices)
        assert tracer.mesh.vertices.tobytes() == (2 * BALL.vertices).tobytes()
        assert tracer.memory_bytes == 2 * tracer._caster.world.memory_bytes


def test_an_empty_scene_is_refused():
    with pytest.raises(SceneError, match="no instance"):
        clbvh.Tracer(clbvh.Scene())


def test_an_instance_far_away_is_hit_as_one_that_is_near(generator):
    near, far = clbvh.Scene(), clbvh.Scene()
    turn = random_transforms(generator, 1)[0]
    turn[:3, 3] = 0
    away = turn.copy()
    away[:3, 3] = 1e7, -2e7, 3e6
    far.place(far.add(KNOT))
    for scene, transform in ((near, turn), (far, away)):
        scene.place(scene.geometries[0] if scene.geometries else scene.add(KNOT), transform)
    origins, directions = generator.normal(size=(3000, 3)) * 5, generator.normal(size=(3000, 3))
    directions -= origins
    with clbvh.Tracer(near) as tracer:
        expected = tracer.closest_hit(origins, directions)
    with clbvh.Tracer(far) as tracer:
        hits = tracer.closest_hit(origins + away[:3, 3], directions)
        # From the other end of the scene, float32 alone would resolve a unit.
        seen = expected.is_hit
        start = np.array([0.0, 0.0, 9.0])
        target = expected.locations[seen] + away[:3, 3]
        across = tracer.closest_hit(start, target - start)
    assert (hits.prim_id == expected.prim_id).mean() > 0.999
    assert set(np.unique(hits.instance_id)) == {-1, 1}
    same = seen & (hits.prim_id == expected.prim_id)
    # Float64 rounds coordinates of 2e7 by 4e-9, and a grazing ray makes more of it.
    np.testing.assert_allclose(hits.locations[same] - away[:3, 3], expected.locations[same], atol=1e-6)
    assert (across.instance_id == 1).mean() > 0.999
    hit = across.is_hit
    along = start + across.t[hit][:, None] * (target - start)[hit]
    np.testing.assert_allclose(across.locations[hit], along, atol=1e-7)
