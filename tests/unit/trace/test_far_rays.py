"""Small things from far away, large coordinates, and every scale: the answers are those of the formula."""

import numpy as np
import pytest

from clbvh import Mesh, Tracer, build
from clbvh.structs import PACKED_RAY
from clbvh.trace.rays.batch import read_rays
from clbvh.trace.rays.pack import pack_rays
from clbvh.trace.world.tree_box import TreeBox

KILOMETRE, MILLIMETRE = 1e3, 1e-3

CUBE_FACES = [
    [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
    [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
]  # fmt: skip


def make_cube(centre, size):
    corners = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    return Mesh.from_arrays(np.asarray(centre, np.float64) + size * corners, CUBE_FACES)


def directions_around(count, seed):
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1)[:, None]


def expected_t(origins, directions, half):
    """Where rays enter a cube around 0; infinity where they miss."""
    with np.errstate(divide="ignore"):
        near = -np.sign(directions) * half
        enter = ((near - origins) / directions).max(axis=1)
        leave = ((-near - origins) / directions).min(axis=1)
    return np.where(enter <= leave, enter, np.inf)


@pytest.mark.parametrize("centre", [(0, 0, 0), (5e5, 4.65e6, 1.2e3)], ids=["at-zero", "survey"])
@pytest.mark.parametrize("distance", [0.02, 1.0, 10 * KILOMETRE])
def test_a_box_of_a_millimetre(session, centre, distance):
    mesh = make_cube(centre, MILLIMETRE)
    to_box = directions_around(4000, 1)
    # Aimed anywhere into twice the box: about half of the rays hit.
    target = np.random.default_rng(2).uniform(-1, 1, (4000, 3)) * MILLIMETRE * 0.7
    origins = mesh.origin + target - distance * to_box
    local = origins - mesh.origin
    half = MILLIMETRE / 2
    t = expected_t(local, to_box, half)
    # What float64 makes of the coordinates, relative to the box.
    rounding = 4 * np.spacing(np.abs(origins).max() + np.abs(mesh.origin).max())
    grazing = np.isfinite(expected_t(local, to_box, half * (1 + 1e-6) + 8 * rounding)) != np.isfinite(
        expected_t(local, to_box, half * (1 - 1e-6) - 8 * rounding)
    )
    assert grazing.mean() < 0.01
    with Tracer(build(mesh), device=session.info) as tracer:
        hits = tracer.closest_hit(origins, to_box)
        blocked = tracer.any_hit(origins, to_box)
    assert 0.2 < hits.is_hit.mean() < 0.8
    np.testing.assert_array_equal(hits.is_hit[~grazing], np.isfinite(t[~grazing]))
    np.testing.assert_array_equal(blocked, hits.is_hit)
    sure = ~grazing & hits.is_hit
    # A slanted face makes more of a shift across the ray, up to the box's edge.
    cosine = np.abs((hits.normals[sure] * to_box[sure]).sum(axis=1))
    assert (np.abs(hits.t[sure] - t[sure]) <= (rounding + MILLIMETRE * 2**-24) / np.maximum(cosine, 1e-9)).all()
    assert np.abs(hits.locations[sure] - mesh.origin).max() <= MILLIMETRE / 2 * (1 + 1e-6) + rounding


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1.0, 1e3, 1e8])
@pytest.mark.parametrize("length", [1e-12, 1.0, 1e12])
def test_every_scale(session, scale, length):
    mesh = make_cube((0, 0, 0), scale)
    directions = directions_around(2000, 3)
    origins = np.random.default_rng(4).uniform(-0.6, 0.6, (2000, 3)) * scale - 50 * scale * directions
    t = expected_t(origins, directions, scale / 2)
    with Tracer(build(mesh), device=session.info) as tracer:
        hits = tracer.closest_hit(origins, directions * length)
        limited = tracer.any_hit(origins, directions * length, t_max=t / length * (1 - 1e-3))
        reached = tracer.any_hit(
            origins, directions * length, t_max=np.where(np.isfinite(t), t, 1) / length * (1 + 1e-3)
        )
    assert not limited[np.isfinite(t)].any()
    assert (hits.is_hit == np.isfinite(t)).mean() > 0.999
    both = hits.is_hit & np.isfinite(t)
    np.testing.assert_array_equal(reached[both], True)
    np.testing.assert_allclose(hits.t[both] * length, t[both], rtol=1e-9)


def test_limits_of_a_ray_from_far_away(session):
    mesh = make_cube((0, 0, 0), MILLIMETRE)
    far = 10 * KILOMETRE
    origins, directions = np.array([[0.0001, 0.0002, -far]]), np.array([[0, 0, 1.0]])
    front, back = far - MILLIMETRE / 2, far + MILLIMETRE / 2
    with Tracer(build(mesh), device=session.info) as tracer:
        for t_min, t_max, expected in (
            (0, np.inf, front),
            (far, np.inf, back),
            (0, far, front),
            (far - MILLIMETRE / 4, far + MILLIMETRE / 4, np.inf),
            (0, front - MILLIMETRE / 100, np.inf),
            (back + MILLIMETRE / 100, np.inf, np.inf),
        ):
            hits = tracer.closest_hit(origins, directions, t_min=t_min, t_max=t_max)
            assert hits.t[0] == pytest.approx(expected, abs=MILLIMETRE * 2**-20)
            assert tracer.any_hit(origins, directions, t_min=t_min, t_max=t_max)[0] == np.isfinite(expected)


def test_a_grid_stays_a_grid(session):
    # From far away, exactly through vertices, edges and the diagonals of faces: one hit each, exactly there.
    mesh = make_cube((0, 0, 0), 2.0)
    targets = np.array([[x, y, -1.0] for x in (-0.5, 0, 0.5) for y in (-0.5, 0, 0.5)])
    with Tracer(build(mesh), device=session.info) as tracer:
        for step in ([0, 0, 1], [1, 2, 4], [-3, 1, 8]):
            directions = np.tile(np.float64(step), (len(targets), 1))
            near = tracer.closest_hit(targets - 2 * directions, directions)
            for distance in (2.0, 2.0**10, 2.0**30, 1_000_003.0):
                hits = tracer.closest_hit(targets - distance * directions, directions)
                np.testing.assert_array_equal(hits.t, distance)
                np.testing.assert_array_equal(hits.locations, targets)
                # Of the triangles at an edge or a corner the same one.
                np.testing.assert_array_equal(hits.prim_id, near.prim_id)


@pytest.mark.parametrize("step", [[3, -1, 8], [-1, 7, 5], [1, 1, -1]], ids=str)
def test_a_far_origin_advances_by_whole_steps(step):
    """Not even a bit of what lies between the steps is lost, so that a ray through a point still meets it."""
    bvh = build(make_cube((0, 0, 0), 2.0))
    targets = np.random.default_rng(5).integers(-(2**18), 2**18, (100, 3)) * 2.0**-18
    direction = np.float64(step)
    origins = targets - 1_000_003 * direction
    packed = np.zeros(len(origins), PACKED_RAY)
    rays, _ = read_rays(origins, np.tile(direction, (len(origins), 1)), 0.0, np.inf)
    pack_rays(rays, rays.part(0, len(origins)), TreeBox.around(bvh), packed)
    advanced = packed["t_max"] > 0
    assert advanced.mean() > 0.9
    left = (targets[advanced] - packed["origin"][advanced] / bvh.mesh.scale) / direction
    assert (np.abs(left) < 100).all()
    np.testing.assert_array_equal(left, left[:, :1].repeat(3, axis=1))
    # A step is an eighth to a quarter of the box's size, a power of two.
    np.testing.assert_array_equal(left[:, 0] % 0.03125, 0)


def test_a_corner_that_a_far_ray_only_touches_is_hit(session):
    """Exactly in the corner of the box that far rays are cut off with, whatever float64 makes of the distances."""
    mesh = make_cube((0, 0, 0), 2.0)
    corners = mesh.vertices.astype(np.float64)
    with Tracer(build(mesh), device=session.info) as tracer:
        for step in ([3, -1, 8], [-3, 7, 5], [10, 3, -7], [13, -11, 12]):
            directions = np.sign(corners) * step
            for distance in (3, 100_003, 1_234_567):
                hits = tracer.closest_hit(corners - distance * directions, directions)
                np.testing.assert_array_equal(hits.t, distance)


def test_a_vertex_of_no_triangle_hides_nothing(session):
    """The triangles lie on one side of the centre, to which the box of the tree is symmetric."""
    for side in (-1, 1):
        cube = make_cube((0, 0, 0), 1.0)
        mesh = Mesh.from_arrays(np.concatenate((cube.vertices, [[40.0 * side] * 3])), cube.faces)
        directions = directions_around(500, 9)
        origins = np.random.default_rng(10).uniform(-0.4, 0.4, (500, 3)) - 1e4 * directions
        with Tracer(build(mesh), device=session.info) as tracer:
            assert tracer.closest_hit(origins, directions).is_hit.all()
            assert tracer.contains([[0, 0, 0], [0.4, 0.4, 0.4], [-0.4, -0.4, -0.4]]).all()
