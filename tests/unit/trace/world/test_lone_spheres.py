"""Spheres alone in a scene, in their place: rays take the way of a mesh, and find what they find in any scene."""

import numpy as np
import pytest

import clbvh
from tests.spheres import make_spheres, sphere_rays

LAYOUTS = ("bvh2", "bvh4", "bvh8")
SIDE = 272  # a picture with enough rays for entry points


@pytest.fixture(params=[0, 1], ids=lambda seed: f"seed{seed}")
def generator(request):
    return np.random.default_rng(request.param)


@pytest.fixture
def spheres(generator):
    return make_spheres(300, generator)


def scene_of(*shapes, mask=0xFFFFFFFF, transform=None):
    scene = clbvh.Scene()
    for shape in shapes:
        scene.place(scene.add(shape), transform, mask=mask)
    return scene


def is_alone(tracer):
    """Whether rays are cast without instances."""
    return tracer._caster.world.is_lone


def rays_down(spheres):
    """One to each centre, along the z axis."""
    return spheres.centres + np.array([0.0, 0.0, 5.0]), np.array([0.0, 0.0, -1.0])


def picture():
    towards = np.stack(np.meshgrid(*[np.linspace(-0.6, 0.6, SIDE)] * 2, [-1.0]), axis=-1).reshape(SIDE, SIDE, 3)
    return np.array([0.1, 0.2, 2.5]), towards


def bytes_of(hits):
    fields = hits.t, hits.u, hits.v, hits.prim_id, hits.instance_id, hits.geometry_id, hits.is_front, hits.locations
    return [np.ascontiguousarray(field).tobytes() for field in fields]


def assert_same_answers(alone, among, rays, **limits):
    """Of all queries, byte for byte: float32 represents the rays, so no rounding comes in between."""
    assert is_alone(alone)
    assert not is_alone(among)
    closest = alone.closest_hit(*rays, **limits)
    assert bytes_of(closest) == bytes_of(among.closest_hit(*rays, **limits))
    np.testing.assert_array_equal(closest.prim_id, alone.closest_prim(*rays, **limits))
    np.testing.assert_array_equal(closest.is_hit, alone.any_hit(*rays, **limits))
    np.testing.assert_array_equal(alone.count_hits(*rays, **limits), among.count_hits(*rays, **limits))
    every, expected = alone.all_hits(*rays, **limits), among.all_hits(*rays, **limits)
    np.testing.assert_array_equal(every.counts, expected.counts)
    for field in ("t", "prim_id", "instance_id", "is_front"):
        np.testing.assert_array_equal(getattr(every, field), getattr(expected, field))
    return closest


@pytest.mark.parametrize("layout", LAYOUTS)
def test_rays_find_what_they_find_through_instances(layout, generator, spheres):
    # A mask that leaves out a bit takes the rays through the tree over the instances.
    with (
        clbvh.Tracer(scene_of(spheres), layout=layout) as alone,
        clbvh.Tracer(scene_of(spheres, mask=0x7FFFFFFF), layout=layout) as among,
    ):
        origins, directions = sphere_rays(spheres, 3000, generator)
        near = np.abs(origins).max(axis=1) < 8
        hits = assert_same_answers(alone, among, (origins[near], directions[near]))
        assert 500 < hits.count < near.sum()
        assert set(hits.instance_id[hits.is_hit]) == {0}
        assert set(hits.instance_id[~hits.is_hit]) == {-1}
        assert_same_answers(alone, among, (origins[near], directions[near]), t_min=0.25, t_max=1.5)
        points = generator.uniform(-1, 1, (200, 3))
        assert bytes_of_points(alone.closest_point(points)) == bytes_of_points(among.closest_point(points))


def bytes_of_points(found):
    return [field.tobytes() for field in (found.distance, found.point, found.prim_id, found.instance_id)]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_pictures_begin_at_entry_points(layout, generator, spheres):
    with (
        clbvh.Tracer(scene_of(spheres), layout=layout) as alone,
        clbvh.Tracer(scene_of(spheres, mask=0x7FFFFFFF), layout=layout) as among,
    ):
        rays = picture()
        one, other = alone.closest_hit(*rays), among.closest_hit(*rays)
        # At the rims, float32 may decide either way.
        assert 5000 < one.count < SIDE * SIDE
        assert np.count_nonzero(one.prim_id != other.prim_id) <= 3
        in_any_order = generator.permutation(SIDE * SIDE)
        shuffled = alone.closest_hit(rays[0], rays[1].reshape(-1, 3)[in_any_order])
        np.testing.assert_array_equal(shuffled.prim_id, one.prim_id.reshape(-1)[in_any_order])


def test_masks_without_a_bit_see_nothing(spheres):
    rays = rays_down(spheres)
    with clbvh.Tracer(scene_of(spheres)) as tracer:
        assert is_alone(tracer)
        mask = np.arange(300) % 3
        hits = tracer.closest_hit(*rays, mask=mask)
        np.testing.assert_array_equal(hits.is_hit, mask > 0)
        np.testing.assert_array_equal(tracer.any_hit(*rays, mask=mask), mask > 0)


def test_only_lone_spheres_in_their_place_are_cast_at_alone(spheres):
    mesh = clbvh.make_shape("icosphere", triangles=80)
    scenes = {
        "alone": (scene_of(spheres), True),
        "masked": (scene_of(spheres, mask=1), False),
        "moved": (scene_of(spheres, transform=clbvh.Transform(translate=(0, 0, 1)).matrix), False),
        "twice": (scene_of(spheres, spheres), False),
        "with a mesh": (scene_of(spheres, mesh), False),
    }
    # Spheres behind others that nothing places are not the first in the buffers.
    behind = clbvh.Scene()
    behind.add(clbvh.Spheres([[0, 0, 0]], 9))
    behind.place(behind.add(spheres))
    scenes["behind others"] = behind, False
    rays = rays_down(spheres)
    expected = None
    for name, (scene, alone) in scenes.items():
        with clbvh.Tracer(scene) as tracer:
            assert is_alone(tracer) == alone, name
            prims = tracer.closest_prim(*rays)
            expected = prims if expected is None else expected
            if name != "with a mesh":
                np.testing.assert_array_equal(prims, expected, name)


def test_spheres_that_move_away_and_back(spheres):
    rays = rays_down(spheres)
    with clbvh.Tracer(scene_of(spheres)) as tracer:
        before = tracer.closest_hit(*rays)
        tracer.set_transforms(0, clbvh.Transform(translate=(0, 0, 1)).matrix)
        assert not is_alone(tracer)
        np.testing.assert_allclose(tracer.closest_hit(*rays).t, before.t - 1, rtol=1e-12)
        tracer.set_transforms(0, np.eye(4))
        assert is_alone(tracer)
        assert bytes_of(tracer.closest_hit(*rays)) == bytes_of(before)


@pytest.mark.parametrize("size", [1e-30, 1.0, 1e30])
def test_spheres_of_any_size_far_from_zero(size, generator):
    # Tiny beside the way to them: the rays are advanced in float64.
    centres = (generator.integers(-8, 9, (50, 3)) / 8 + [2.0**20, 0, 0]) * size
    spheres = clbvh.Spheres(centres, 2.0**-10 * size)
    with clbvh.Tracer(scene_of(spheres)) as tracer:
        assert is_alone(tracer)
        hits = tracer.closest_hit(centres + np.array([0, 0, 2.0**16]) * size, [0, 0, -1])
        assert hits.is_hit.all()
        # Of several spheres in a line, the first.
        first = [centres[(centres[:, :2] == centre[:2]).all(axis=1), 2].max() for centre in centres]
        np.testing.assert_allclose(hits.t, centres[:, 2] + 2.0**16 * size - first - 2.0**-10 * size, rtol=2.0**-50)


@pytest.mark.parametrize("shape", ["mesh", "spheres"])
def test_a_shape_that_nothing_places_is_not_seen(shape, generator, spheres):
    knot = clbvh.make_shape("knot", triangles=500)
    placed, other = (knot, spheres) if shape == "mesh" else (spheres, knot)
    scene = scene_of(placed)
    scene.add(other)
    rays = sphere_rays(spheres, 1000, generator)
    with clbvh.Tracer(scene) as tracer, clbvh.Tracer(scene_of(placed)) as expected:
        for few in (slice(0, 20), slice(None)):
            of_few = [values[few] for values in rays]
            assert bytes_of(tracer.closest_hit(*of_few)) == bytes_of(expected.closest_hit(*of_few))
