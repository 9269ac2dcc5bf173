"""Scenes that move: when their trees are built anew, what stays, what is refused; `tests/property` has any moves."""

import pickle
import warnings

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
            *((SceneError, tracer.set_masks, 0, mask) for mask in (-1, 2**32, 1.5, True, None, [1, 2], [[1]])),
            (SceneError, tracer.set_masks, late, 1),
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


@pytest.mark.parametrize("masks", [(0, 2, 4, 8), (1, 0, 0, 8)])
def test_an_instance_of_mask_0_is_removed_until_it_gets_another(transforms, spheres, rays, masks):
    scene, rest = make_scene(KNOT, BALL, spheres, transforms), clbvh.Scene()
    kept, removed = np.flatnonzero(masks), np.flatnonzero(np.equal(masks, 0))
    for number in kept:
        rest.place(rest.add(scene.instances[number].geometry.shape), transforms[number])
    with clbvh.Tracer(scene) as tracer, clbvh.Tracer(rest) as other:
        before = bytes_of(tracer.closest_hit(*rays))
        tracer.set_masks(scene.instances, masks)
        tracer.set_masks([], [])
        hits = tracer.closest_hit(*rays)
        assert np.unique(hits.instance_id).tolist() == [-1, *kept]
        assert hits.t.tobytes() == other.closest_hit(*rays).t.tobytes()
        # It costs nothing: its box is not in the tree.
        one, another = (each._caster.world for each in (tracer, other))
        assert one.top.nodes.tobytes() == another.top.nodes.tobytes()
        assert one.box_numbers.tobytes() == another.box_numbers.tobytes()
        assert np.isinf(tracer.closest_point(rays[0][:50], instance=removed).distance).all()
        assert bytes_of(pickle.loads(pickle.dumps(tracer)).closest_hit(*rays)) == bytes_of(hits)
        tracer.set_masks(scene.instances, 0)
        assert not tracer.any_hit(*rays).any()
        tracer.set_masks(scene.instances, MASKS)
        assert bytes_of(tracer.closest_hit(*rays)) == before


def test_what_is_removed_has_no_say():
    """Neither that it is open, nor that it is too small beside the scene."""
    scene = clbvh.Scene(BALL)
    scene.place(scene.geometries[0], mask=0)
    hole = scene.place(scene.add(([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])))
    with clbvh.Tracer(scene) as tracer:
        tracer.set_masks(hole, 0)
        with warnings.catch_warnings(action="error"):
            assert tracer.contains([0, 0, 0.5])
        tracer.set_transforms(hole, clbvh.Transform(scale=1e-25))
        with pytest.raises(SceneError, match="the instance 2 is smaller"):
            tracer.set_masks(hole, 1)
        assert tracer.contains([0, 0, 0.5])


def test_a_mesh_can_be_removed_and_comes_back():
    above, down = [[0, 0, 9]], [[0, 0, -1]]
    with clbvh.Tracer(BALL) as tracer:
        before = tracer.closest_hit(above, down)
        tracer.set_masks(0, 0)
        assert not tracer.any_hit(above, down)
        tracer.set_masks(0, 2)
        assert tracer.any_hit(above * 3, down, mask=[1, 2, 3]).tolist() == [False, True, True]
        tracer.set_masks(0, 0xFFFFFFFF)
        assert bytes_of(tracer.closest_hit(above, down)) == bytes_of(before)
        tracer.update(2 * BALL.vertices)
