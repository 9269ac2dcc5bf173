"""Spheres alone in a scene, in their place: rays take the way of a mesh, and find what they find in any scene."""

import numpy as np
import pytest

import clbvh
from clbvh.tree_layouts import TREE_LAYOUTS
from tests.spheres import make_spheres, sphere_rays

SIDE = 272  # a picture with enough rays for entry points


@pytest.fixture
def generator():
    return np.random.default_rng(0)


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


def picture():
    towards = np.stack(np.meshgrid(*[np.linspace(-0.6, 0.6, SIDE)] * 2, [-1.0]), axis=-1).reshape(SIDE, SIDE, 3)
    return np.array([0.1, 0.2, 2.5]), towards


def bytes_of_points(found):
    return [field.tobytes() for field in (found.distance, found.point, found.prim_id, found.instance_id)]


def bytes_of(hits):
    fields = hits.t, hits.u, hits.v, hits.prim_id, hits.instance_id, hits.geometry_id, hits.is_front, hits.locations
    return [np.ascontiguousarray(field).tobytes() for field in fields]


@pytest.mark.parametrize("layout", TREE_LAYOUTS)
def test_rays_find_what_they_find_through_instances(layout, generator, spheres):
    # A mask that leaves out a bit takes the rays through the tree over the instances.
    with (
        clbvh.Tracer(scene_of(spheres), layout=layout) as alone,
        clbvh.Tracer(scene_of(spheres, mask=0x7FFFFFFF), layout=layout) as among,
    ):
        assert (is_alone(alone), is_alone(among)) == (True, False)
        origins, directions = sphere_rays(spheres, 3000, generator)
        near = np.abs(origins).max(axis=1) < 8
        rays = origins[near], directions[near]
        for limits in ({}, {"t_min": 0.25, "t_max": 1.5}):
            closest = alone.closest_hit(*rays, **limits)
            assert 50 < closest.count < near.sum()
            assert bytes_of(closest) == bytes_of(among.closest_hit(*rays, **limits))
            every, expected = alone.all_hits(*rays, **limits), among.all_hits(*rays, **limits)
            assert (bytes_of(every), every.counts.tolist()) == (bytes_of(expected), expected.counts.tolist())
            np.testing.assert_array_equal(closest.is_hit, alone.any_hit(*rays, **limits))
        points = generator.uniform(-1, 1, (200, 3))
        assert bytes_of_points(alone.closest_point(points)) == bytes_of_points(among.closest_point(points))
        mask = np.arange(near.sum()) % 3
        np.testing.assert_array_equal(alone.any_hit(*rays, mask=mask), alone.any_hit(*rays) & (mask > 0))

        rays = picture()
        one, other = alone.closest_hit(*rays), among.closest_hit(*rays)
        # At the rims, float32 may decide either way.
        assert 5000 < one.count < SIDE * SIDE
        assert np.count_nonzero(one.prim_id != other.prim_id) <= 3


def test_only_lone_spheres_in_their_place_are_cast_at_alone(spheres):
    moved = scene_of(spheres, transform=clbvh.Transform(translate=(0, 0, 1)).matrix)
    # Spheres behind others that nothing places are not the first in the buffers.
    behind = clbvh.Scene()
    behind.add(clbvh.Spheres([[0, 0, 0]], 9))
    behind.place(behind.add(spheres))
    rays, found = (spheres.centres + np.array([0, 0, 5.0]), [0, 0, -1]), []
    for scene in (scene_of(spheres), scene_of(spheres, mask=1), moved, scene_of(spheres, spheres), behind):
        with clbvh.Tracer(scene) as tracer:
            found.append((is_alone(tracer), tracer.closest_prim(*rays).tolist()))
    assert [alone for alone, _ in found] == [True, False, False, False, False]
    assert all(prims == found[0][1] for _, prims in found)
