"""Scenes that move: when their trees are built anew, what stays, what is refused; `tests/property` has any moves."""

import numpy as np
import pytest

import clbvh
from clbvh import ConfigError, MeshError, QueryError, SceneError
from clbvh.trace.world.trees import NewTree

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


@pytest.fixture
def generator():
    return np.random.default_rng(0)


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


def assert_same(tracer, scene, rays):
    with clbvh.Tracer(scene) as fresh:
        hits = fresh.closest_hit(*rays)
        assert len(np.unique(hits.instance_id)) > 2
        assert bytes_of(tracer.closest_hit(*rays)) == bytes_of(hits)


@pytest.fixture
def built(monkeypatch):
    """The shapes over which devices have built trees since the test began."""
    shapes, build = [], NewTree.build

    def note(session, prims, options, layout):
        shapes.append(prims.shape)
        return build(session, prims, options, layout)

    monkeypatch.setattr(NewTree, "build", note)
    return shapes


def test_spheres_are_refitted_until_their_tree_is_worn(generator, transforms, spheres, rays, built):
    scene = make_scene(KNOT, BALL, spheres, transforms)
    knot, _, dots = scene.geometries
    with clbvh.Tracer(scene) as tracer:
        for moved in (
            spheres.with_spheres(spheres.centres * [1, 1.1, 0.9] + 0.02, spheres.radii * 1.2),
            spheres.with_spheres(spheres.centres * 1e3, 100.0),  # with an origin and a scale of their own
            spheres.with_spheres(spheres.centres, spheres.radii),
        ):
            tracer.set_spheres(dots, moved.centres, moved.radii)
            assert_same(tracer, make_scene(KNOT, BALL, moved, transforms), rays)
        assert built == []
        # Where another geometry is built anew, spheres stay where they were moved to.
        torn = clbvh.Mesh.from_arrays(generator.permutation(KNOT.vertices), KNOT.faces)
        tracer.set_vertices(knot, torn.vertices)
        assert_same(tracer, make_scene(torn, BALL, moved, transforms), rays)
        built.clear()
        mixed = spheres.with_spheres(generator.permutation(spheres.centres))
        tracer.set_spheres(dots, mixed.centres)
        assert [len(shape.radii) for shape in built] == [40]
        assert_same(tracer, make_scene(torn, BALL, mixed, transforms), rays)


def test_buffers_of_older_scenes_are_given_back(transforms, spheres):
    scene = make_scene(KNOT, BALL, spheres, transforms)
    with clbvh.Tracer(scene) as tracer:
        tracer.set_transforms(0, np.eye(4))
        # From the first shape that moves on, there are nodes and blocks to write the next one, points and corners, and
        # what the tree is refitted by.
        count = tracer._caster.session.buffer_count + 8
        for step in range(20):
            tracer.set_transforms(0, np.eye(4))
            tracer.set_vertices(scene.geometries[0], KNOT.vertices * (1 + step / 1000))
            assert tracer._caster.session.buffer_count == count


def test_a_mesh_without_instances_is_seen_by_every_mask_but_zero():
    with clbvh.Tracer(BALL) as tracer:
        assert tracer.any_hit([[0, 0, 5]] * 3, [0, 0, -1], mask=[0, 1, 0xFFFFFFFF]).tolist() == [False, True, True]
        for mask in (-1, 2**32, 1.5, "all", [[1, 2], [3, 4]]):
            with pytest.raises(QueryError, match="mask must be"):
                tracer.any_hit([[0, 0, 5]] * 3, [0, 0, -1], mask=mask)


def test_wrong_changes_are_refused_and_change_nothing(transforms, spheres, rays):
    scene, other = (make_scene(KNOT, BALL, spheres, transforms) for _ in range(2))
    with clbvh.Tracer(scene) as tracer:
        before = bytes_of(tracer.closest_hit(*rays))
        late = scene.place(scene.geometries[0])
        knot, _, dots = scene.geometries
        for error, change, *given in (
            (SceneError, tracer.set_transforms, other.instances[0], np.eye(4)),
            (SceneError, tracer.set_transforms, late, np.eye(4)),
            (SceneError, tracer.set_transforms, 0, np.diag([0.0, 1, 1, 1])),
            (SceneError, tracer.set_transforms, 0, np.full((4, 4), np.nan)),
            (SceneError, tracer.set_transforms, [0, 1], np.eye(4)),
            (SceneError, tracer.set_transforms, 99, np.eye(4)),
            (MeshError, tracer.set_vertices, knot, KNOT.vertices[1:]),
            (SceneError, tracer.set_vertices, other.geometries[0], KNOT.vertices),
            (MeshError, tracer.set_spheres, dots, spheres.centres[1:]),
            (MeshError, tracer.set_spheres, dots, spheres.centres, 0.0),
            (MeshError, tracer.set_spheres, dots, spheres.centres, spheres.radii[1:]),
            (MeshError, tracer.set_spheres, dots, spheres.centres * np.nan),
            (SceneError, tracer.set_spheres, knot, KNOT.vertices),
            (SceneError, tracer.set_spheres, other.geometries[2], spheres.centres),
            (ConfigError, tracer.update, KNOT.vertices),
        ):
            with pytest.raises(error):
                change(*given)
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
    for source in (BALL, clbvh.Scene(BALL)):
        with clbvh.Tracer(source) as tracer:
            tracer.update(2 * BALL.vertices)
            assert tracer.mesh.vertices.tobytes() == (2 * BALL.vertices).tobytes()
            with pytest.raises(SceneError, match="instance"):
                tracer.set_transforms(1, np.eye(4))


def test_an_empty_scene_is_refused():
    with pytest.raises(SceneError, match="the scene is empty"):
        clbvh.Tracer(clbvh.Scene())
