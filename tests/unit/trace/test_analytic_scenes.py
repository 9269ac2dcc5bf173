"""Scenes whose hits are known by formula: spheres, near and far, and a ring of mirrored instances."""

import numpy as np
import pytest

import clbvh
from clbvh import Mesh, Spheres, Tracer, make_shape
from clbvh.structs import LAYOUT_WIDTHS

from .scene_states import affine, turn

LAYOUTS = list(LAYOUT_WIDTHS)
SQUARE = Mesh.from_arrays([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])


def scene_of(shape, *placed):
    """A scene of one shape; each instance is a transform, or a transform and a mask."""
    scene = clbvh.Scene()
    geometry = scene.add(shape)
    for one in placed:
        transform, mask = one if isinstance(one, tuple) else (one, 2**32 - 1)
        scene.place(geometry, transform, mask=mask)
    return scene


@pytest.fixture(params=LAYOUTS)
def trace(request, session):
    """A function that opens a tracer in one of the layouts."""
    return lambda scene: Tracer(scene, device=session.info, layout=request.param)


class TestSpheres:
    def test_both_crossings_from_outside_and_one_from_inside(self, trace):
        with trace(scene_of(Spheres([[3, 0, 0]], 2.0), np.eye(4))) as tracer:
            hits = tracer.all_hits(
                [[-5, 0, 0], [3, 0, 0], [3, 1, 0], [9, 0, 0]], [[2, 0, 0], [0, 4, 0], [0, 1, 0], [1, 0, 0]]
            )
        assert hits.offsets.tolist() == [0, 2, 3, 4, 4]
        np.testing.assert_allclose(hits.t, [3, 5, 0.5, 1], rtol=1e-12)
        np.testing.assert_allclose(hits.locations, [[1, 0, 0], [5, 0, 0], [3, 2, 0], [3, 2, 0]], atol=1e-12)
        np.testing.assert_allclose(hits.normals, [[-1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]], atol=1e-12)
        assert hits.is_front.tolist() == [True, False, False, False]

    @pytest.mark.parametrize("distance", [10.0, 1e3, 1e5, 1e7])
    def test_a_small_sphere_far_away_by_formula(self, trace, distance):
        """No cancellation: the ray meets a unit sphere at a known height over its middle."""
        height = np.linspace(-0.9, 0.9, 19)
        origins = np.column_stack((np.zeros(19), height, np.zeros(19)))
        scene = scene_of(Spheres([[0, 0, 0]], 1.0), affine(offset=(distance, 0, 0)), affine(offset=(0, 50, 0)))
        with trace(scene) as tracer:
            hits = tracer.all_hits(origins, [1, 0, 0])
        half = np.sqrt(1 - height**2)
        assert hits.counts.tolist() == [2] * 19
        expected = np.column_stack((distance - half, distance + half)).reshape(-1)
        np.testing.assert_allclose(hits.t, expected, rtol=2.0**-50, atol=1e-9)
        local = hits.locations - [distance, 0, 0]
        np.testing.assert_allclose(np.linalg.norm(local, axis=1), 1, atol=2.0**-50 * distance + 1e-12)

    @pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
    def test_an_ellipsoid_by_formula(self, trace, scale):
        """Half axes 3, 1, 2: a ray along x at (y, z) is inside for 3 sqrt(1 - y^2 - z^2 / 4) to each side."""
        generator = np.random.default_rng(5)
        y, z = generator.uniform(-0.6, 0.6, (2, 50))
        transform = affine(np.diag([3, 1, 2]) * scale, np.array([7, 0, 0]) * scale)
        with trace(scene_of(Spheres([[0, 0, 0]], 1.0), transform)) as tracer:
            hits = tracer.all_hits(np.column_stack((np.zeros(50), y, z)) * scale, np.array([1, 0, 0]) * scale)
        half = 3 * np.sqrt(1 - y**2 - z**2 / 4)
        np.testing.assert_allclose(hits.t, np.column_stack((7 - half, 7 + half)).reshape(-1), rtol=1e-12)
        # The normal of an ellipsoid is along x / 9, y, z / 4.
        x = hits.locations / scale - [7, 0, 0]
        normals = x / [9, 1, 4]
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        np.testing.assert_allclose(hits.normals, normals, atol=1e-11)

    def test_a_row_of_spheres_is_crossed_in_order(self, trace):
        count = 100
        centres = np.column_stack((3.0 * np.arange(count), np.zeros((count, 2))))
        order = np.random.default_rng(6).permutation(count)
        with trace(scene_of(Spheres(centres[order], 1.0), affine(turn(2, np.pi / 2)))) as tracer:
            hits = tracer.all_hits([[0, -5, 0]], [[0, 1, 0]])
        assert np.argsort(order)[np.arange(count)].repeat(2).tolist() == hits.prim_id.tolist()
        np.testing.assert_allclose(hits.t, (3.0 * np.arange(count)[:, None] + [4, 6]).reshape(-1), rtol=1e-12)


class TestRing:
    """Squares around the z axis, every second one mirrored, each facing the axis at a distance of 10."""

    COUNT = 12

    def transforms(self):
        upright = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0.0]])  # in the plane x = 0
        for index in range(self.COUNT):
            rotation = turn(2, 2 * np.pi * index / self.COUNT)
            mirror = np.diag([1, (-1) ** index, 1])
            yield affine(rotation @ mirror @ upright, rotation @ [10, 0, 0])

    def test_each_ray_from_the_middle_hits_its_own_instance(self, trace):
        angles = 2 * np.pi * np.arange(self.COUNT) / self.COUNT
        directions = np.column_stack((np.cos(angles), np.sin(angles), np.full(self.COUNT, 0.0125)))
        with trace(scene_of(SQUARE, *self.transforms())) as tracer:
            hits = tracer.closest_hit([0, 0, 0], directions)
            counts = tracer.count_hits([0, 0, 0], directions)
            # Between two of them there is nothing.
            between = np.column_stack((np.cos(angles + np.pi / 12), np.sin(angles + np.pi / 12), np.zeros(12)))
            assert not tracer.any_hit([0, 0, 0], between).any()
        assert hits.instance_id.tolist() == list(range(self.COUNT))
        assert counts.tolist() == [1] * self.COUNT
        np.testing.assert_allclose(hits.t, 10, rtol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(hits.locations[:, :2], axis=1), 10, rtol=1e-12)
        # The outer side of a mirrored object stays outside.
        outwards = directions * [1, 1, 0]
        np.testing.assert_allclose(np.abs(np.einsum("ni,ni->n", hits.normals, outwards)), 1, rtol=1e-12)

    def test_a_ray_through_the_ring_hits_two(self, trace):
        with trace(scene_of(SQUARE, *self.transforms())) as tracer:
            hits = tracer.all_hits([[-20, 0.25, 0.5]], [[1, 0, 0]])
        assert hits.instance_id.tolist() == [6, 0]
        np.testing.assert_allclose(hits.t, [10, 30], rtol=1e-12)

    def test_masks_hide_every_second_one(self, trace):
        placed = [(transform, 1 + index % 2) for index, transform in enumerate(self.transforms())]
        angles = 2 * np.pi * np.arange(self.COUNT) / self.COUNT
        directions = np.column_stack((np.cos(angles), np.sin(angles), np.full(self.COUNT, 0.0125)))
        with trace(scene_of(SQUARE, *placed)) as tracer:
            for mask, expected in ((1, [1, 0]), (2, [0, 1]), (3, [1, 1]), (4, [0, 0])):
                assert tracer.count_hits([0, 0, 0], directions, mask=mask).tolist() == expected * 6, mask
            masks = np.arange(self.COUNT) % 3
            found = tracer.closest_hit([0, 0, 0], directions, mask=masks).is_hit
        assert found.tolist() == [bool(masks[index] & (1 + index % 2)) for index in range(self.COUNT)]


def test_nested_balls_are_crossed_from_the_outermost_in(trace):
    ball = make_shape("icosphere", triangles=320)
    radii = [3.0, 1.0, 2.0]
    direction = np.array([0.3, 0.7, -0.648])
    with trace(scene_of(ball, *(affine([radius] * 3) for radius in radii))) as tracer:
        hits = tracer.all_hits([-9 * direction], [direction])
    assert hits.instance_id.tolist() == [0, 2, 1, 1, 2, 0]
    assert (np.diff(hits.t) > 0).all()


def test_of_coincident_instances_the_first_visible_one_is_hit(trace):
    with trace(scene_of(SQUARE, (np.eye(4), 1), (np.eye(4), 2), (np.eye(4), 3))) as tracer:
        rays = [0.25, 0.5, 5], [0, 0, -1]
        found = [int(tracer.closest_hit(*rays, mask=mask).instance_id) for mask in (1, 2, 3, 4)]
        assert found == [0, 1, 0, -1]
        assert tracer.all_hits([rays[0]], [rays[1]]).instance_id.tolist() == [0, 1, 2]
