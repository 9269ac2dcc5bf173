"""Scenes whose answers are known by formula."""

import numpy as np
import pytest

from clbvh import Mesh, Tracer, build
from clbvh.geometry.shapes.make_shape import make_shape

from ...profiles import seeds
from ...rays import aim, as_float32, random_rays

T_TOLERANCE = 1e-6


def make_box(lower, upper):
    """An axis-aligned box of twelve triangles, two for each side: -x, +x, -y, +y, -z, +z."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return Mesh.from_arrays(lower + corners * (np.asarray(upper) - lower), faces, name="box")


@pytest.mark.parametrize("seed", seeds(3))
@pytest.mark.parametrize("offset", [0.0, 1000.0], ids=["near", "far"])
def test_a_box_is_hit_where_the_slabs_say(session, seed, offset):
    generator = np.random.default_rng([60, seed])
    lower, upper = np.array([-1.0, -0.5, -2.0]) + offset, np.array([0.75, 1.5, 1.0]) + offset
    mesh = make_box(lower, upper)
    origins, directions = random_rays(mesh, 20_000, generator)
    with Tracer(build(mesh), device=session.info) as tracer:
        hits = tracer.closest_hit(origins, directions)

    half, origins = (upper - lower) / 2, origins - mesh.origin
    to_lower, to_upper = (-half - origins) / directions, (half - origins) / directions
    near, far = np.minimum(to_lower, to_upper), np.maximum(to_lower, to_upper)
    entry, leave = near.max(axis=1), far.min(axis=1)
    clear = np.abs(leave - entry) > 1e-4
    expected = np.where(entry <= leave, np.where(entry >= 0, entry, leave), np.inf)
    expected[expected < 0] = np.inf
    clear &= np.abs(entry) > 1e-4
    assert clear.mean() > 0.99

    is_hit = np.isfinite(expected)
    np.testing.assert_array_equal(hits.is_hit[clear], is_hit[clear])
    both = clear & is_hit
    assert 0.4 < both.mean() < 1
    np.testing.assert_allclose(hits.t[both], expected[both], rtol=T_TOLERANCE, atol=T_TOLERANCE)
    # The side that is hit is the one whose slab decides.
    from_outside = entry >= 0
    axis = np.where(from_outside, near.argmax(axis=1), far.argmin(axis=1))
    forward = np.take_along_axis(directions, axis[:, None], axis=1)[:, 0] > 0
    side = 2 * axis + (forward != from_outside)
    # Where two slabs decide at once there is an edge, and two sides are right.
    gap = np.where(
        from_outside,
        np.diff(np.sort(near, axis=1), axis=1)[:, -1],
        np.diff(np.sort(far, axis=1), axis=1)[:, 0],
    )
    clear_side = both & (gap > 1e-4)
    np.testing.assert_array_equal(hits.prim_id[clear_side] // 2, side[clear_side])


def test_a_floor_is_hit_at_height_over_slope(session):
    floor = Mesh.from_arrays([[-100, 0, -100], [100, 0, -100], [100, 0, 100], [-100, 0, 100]], [[0, 1, 2], [0, 2, 3]])
    generator = np.random.default_rng(61)
    origins = as_float32(generator.uniform([-10, 0.5, -10], [10, 20, 10], (10_000, 3)))
    origins, directions = aim(origins, generator.uniform([-90, 0, -90], [90, 0, 90], (10_000, 3)))
    with Tracer(build(floor), device=session.info) as tracer:
        hits = tracer.closest_hit(origins, directions)
    assert hits.is_hit.all()
    # A shift of a corner across the ray, by a rounding or two of the floor's size, moves the crossing of a flat ray
    # by that times the slope.
    shift = 2 * 2.0**-24 * 200 / np.abs(directions[:, 1])
    error = np.abs(hits.t + origins[:, 1] / directions[:, 1])
    assert (error <= T_TOLERANCE + shift).all()
    assert (error <= T_TOLERANCE).mean() > 0.999


def test_a_sphere_is_hit_between_its_inner_and_its_outer_radius(session):
    mesh = make_shape("icosphere", triangles=20_480)
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inner = np.abs((normals * corners[:, 0]).sum(axis=1) / np.linalg.norm(normals, axis=1)).min()
    assert 0.998 < inner < 1

    generator = np.random.default_rng(62)
    origins = generator.normal(size=(50_000, 3))
    origins = as_float32(3 * origins / np.linalg.norm(origins, axis=1, keepdims=True))
    origins, directions = aim(origins, generator.uniform(-1.2, 1.2, origins.shape))
    directions = as_float32(directions / np.linalg.norm(directions, axis=1, keepdims=True))
    with Tracer(build(mesh), device=session.info) as tracer:
        hits = tracer.closest_hit(origins, directions)

    along = -(origins * directions).sum(axis=1) / (directions**2).sum(axis=1)
    off_axis = np.linalg.norm(origins + along[:, None] * directions, axis=1)
    assert hits.is_hit[off_axis < inner].all()
    assert not hits.is_hit[off_axis > 1].any()
    assert 0.2 < hits.is_hit.mean() < 0.8
    found = off_axis < inner
    t = hits.t[found].astype(np.float64)
    first = along[found] - np.sqrt(1 - off_axis[found] ** 2)
    last = along[found] - np.sqrt(inner**2 - off_axis[found] ** 2)
    assert (t >= first - T_TOLERANCE * 3).all()
    assert (t <= last + T_TOLERANCE * 3).all()


def test_the_silhouette_of_a_sphere_has_the_area_of_a_disc(session):
    mesh = make_shape("icosphere", triangles=20_480)
    size = 1000
    steps = (np.arange(size) + 0.5) * (2.2 / size) - 1.1
    x, y = np.meshgrid(steps, steps)
    origins = np.stack((x.ravel(), y.ravel(), np.full(size * size, 5.0)), axis=1)
    with Tracer(build(mesh), device=session.info) as tracer:
        covered = tracer.any_hit(origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape)).sum()
    # The outline of the mesh lies between the unit circle and a polygon in it, less than 0.2 % smaller.
    area = covered * (2.2 / size) ** 2
    assert 0.998 * np.pi < area < 1.0002 * np.pi
