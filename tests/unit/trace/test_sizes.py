"""Meshes of any size, anywhere; rays of any length, from anywhere, with any limits: the same hits as ordinary ones."""

import numpy as np
import pytest
import trimesh

from clbvh import Mesh, QueryError, Tracer, build, make_shape
from clbvh.structs import PACKED_RAY
from clbvh.trace.rays.batch import read_rays
from clbvh.trace.rays.pack import pack_rays
from clbvh.trace.world.tree_box import TreeBox
from clbvh.tree_layouts import TREE_LAYOUTS

from ...rays import hard_rays

# Powers of two: every power of 4 from 1e-36 to 1e36, and the ends of what a mesh may have.
UNITS = [*range(-120, 121, 2), -490, 490]

# Powers of two for directions, from 1e-30 to 1e30, and close to the ends of float64. Size and length take turns.
LENGTHS = [*range(-100, 101, 25), -800, 800]

# Units and lengths that make a t, but none of the rest, too small or too large for float64.
EXTREMES = [(490, -1000), (-490, 1000)]
OF_T = ("t", "every t", "limited", "any")

COUNT = 300
KILOMETRE, MILLIMETRE = 1e3, 1e-3
SURVEY = np.array([5.0e5, 4.65e6, 1.2e3])  # metres east, north and up


def make_cube(size):
    box = trimesh.creation.box((size, size, size))
    return Mesh.from_arrays(box.vertices, box.faces)


def ask(mesh, rays, layout, unit, length, device):
    """Answers of all queries, with lengths given back in units and t in lengths of the direction at size 1."""
    vertices, (origins, directions) = np.ldexp(mesh.vertices, unit), rays
    origins, directions = np.ldexp(origins, unit), np.ldexp(directions, length)
    t_limits = {"t_min": np.ldexp(0.25, unit - length), "t_max": np.ldexp(2048.0, unit - length)}
    points = origins[:COUNT]
    with Tracer(Mesh.from_arrays(vertices, mesh.faces), device=device, layout=layout) as tracer:
        hits = tracer.closest_hit(origins, directions)
        every = tracer.all_hits(origins, directions, with_locations=True)
        nearest = tracer.closest_point(points)
        return {
            "t": np.ldexp(hits.t, length - unit),
            "every t": np.ldexp(every.t, length - unit),
            "limited": tracer.closest_hit(origins, directions, **t_limits).prim_id,
            "any": tracer.any_hit(origins, directions, **t_limits),
            "prim_id": hits.prim_id,
            "weights": np.stack((hits.u, hits.v)),
            "locations": np.ldexp(hits.locations, -unit),
            "counts": tracer.count_hits(origins, directions),
            "every location": np.ldexp(every.locations, -unit),
            "distance": np.ldexp(nearest.distance, -unit),
            "nearest": np.ldexp(nearest.point, -unit),
            "inside": tracer.contains(points),
        }


@pytest.mark.filterwarnings("ignore:overflow encountered in ldexp")
@pytest.mark.parametrize("layout", TREE_LAYOUTS)
def test_every_size_gives_the_same_bits(session, layout):
    mesh, generator = make_shape("blobs", triangles=640), np.random.default_rng(7)
    near, (origins, directions) = hard_rays(mesh, COUNT, generator), hard_rays(mesh, COUNT, generator)
    # Some start a thousand sizes away, where they are advanced on their way to the device.
    rays = np.concatenate((near[0], origins - 1024.0 * directions)), np.concatenate((near[1], directions))
    expected = ask(mesh, rays, layout, 0, 0, session.info)
    assert 0.3 < (expected["prim_id"] >= 0).mean() < 0.95
    assert 0 < (expected["limited"] != expected["prim_id"]).sum() < COUNT
    assert expected["inside"].any()
    cases = [(unit, LENGTHS[turn % len(LENGTHS)]) for turn, unit in enumerate(UNITS)] + EXTREMES
    for unit, length in cases[TREE_LAYOUTS.index(layout) % 3 :: 3]:
        for name, values in ask(mesh, rays, layout, unit, length, session.info).items():
            if (unit, length) not in EXTREMES or name not in OF_T:
                assert values.tobytes() == expected[name].tobytes(), (name, unit, length)


def test_the_t_of_a_hit_is_never_that_of_a_miss(session):
    """A t beyond float64 is its largest number."""
    mesh = Mesh.from_arrays(np.ldexp([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], 490), [[0, 1, 2]])
    with Tracer(mesh, device=session.info) as tracer:
        hits = tracer.closest_hit(np.ldexp([[0.25, 0.25, 1]], 490), [[0, 0, -(2.0**-900)]])
    assert hits.prim_id.tolist() == [0]
    assert hits.t.tolist() == [np.finfo(np.float64).max]


@pytest.mark.parametrize("size", [0.1, 1e-17, 1e19])
def test_hits_are_on_the_files_own_planes(session, size):
    """A box's corner is no float32, and its face is hit where float64 has it."""
    low, high = -size / 3, size * 0.7
    cube = make_cube(2.0)
    across = np.random.default_rng(1).uniform(-0.3, 0.6, (50, 2)) * size
    with Tracer(Mesh.from_arrays(np.where(cube.vertices > 0, high, low), cube.faces), device=session.info) as tracer:
        for axis in range(3):
            rays = np.insert(across, axis, 5 * size, axis=1), -np.eye(3)[axis]
            hits = tracer.all_hits(*rays, with_locations=True)
            np.testing.assert_array_equal(hits.locations[:, axis], [high, low] * 50)
            np.testing.assert_allclose(hits.t, 5 * size - np.tile([high, low], 50), rtol=1e-15)
            points = np.insert(across, axis, 0.69 * size, axis=1)
            depth, is_near = tracer.signed_distance(points), np.abs(across).max(axis=1) < 0.3 * size
            np.testing.assert_allclose(depth[is_near], high - 0.69 * size, rtol=1e-12)


def test_survey_coordinates_lose_nothing(session, mesh, rays):
    for size in (1e-3, 100.0):
        # Multiples of a power of two far above float64's rounding there, so that the shift itself is exact.
        step = 2.0**-23
        vertices, origins = (np.round(array * size / step) * step for array in (mesh.vertices, rays[0]))
        with (
            Tracer(Mesh.from_arrays(vertices, mesh.faces), device=session.info) as near,
            Tracer(Mesh.from_arrays(vertices + SURVEY, mesh.faces), device=session.info) as far,
        ):
            hits, expected = far.closest_hit(origins + SURVEY, rays[1]), near.closest_hit(origins, rays[1])
            for field in ("t", "u", "v", "prim_id"):
                assert getattr(hits, field).tobytes() == getattr(expected, field).tobytes(), field
        found = hits.is_hit
        along = hits.t[found, None] * rays[1][found]
        away = np.linalg.norm(hits.locations[found] - origins[found] - SURVEY - along, axis=1)
        assert np.quantile(away, 0.99) < 1e-5


def test_limits_of_a_ray_from_far_away(session):
    far = 10 * KILOMETRE
    rays = [[0.0001, 0.0002, -far]], [[0, 0, 1.0]]
    front, back = far - MILLIMETRE / 2, far + MILLIMETRE / 2
    with Tracer(make_cube(MILLIMETRE), device=session.info) as tracer:
        for t_min, t_max, expected in (
            (0, np.inf, front),
            (far, np.inf, back),
            (0, far, front),
            (far - MILLIMETRE / 4, far + MILLIMETRE / 4, np.inf),
            (0, front - MILLIMETRE / 100, np.inf),
            (back + MILLIMETRE / 100, np.inf, np.inf),
        ):
            hits = tracer.closest_hit(*rays, t_min=t_min, t_max=t_max)
            assert hits.t[0] == pytest.approx(expected, abs=MILLIMETRE * 2**-20)
            assert tracer.any_hit(*rays, t_min=t_min, t_max=t_max)[0] == np.isfinite(expected)


def test_a_grid_stays_a_grid_from_far_away(session):
    """Exactly through vertices, edges and diagonals: the t of the grid, and of several triangles the same one."""
    mesh = make_cube(2.0)
    targets = np.array([[x, y, -1.0] for x in (-0.5, 0, 0.5) for y in (-0.5, 0, 0.5)])
    with Tracer(mesh, device=session.info) as tracer:
        for step in ([0, 0, 1], [1, 2, 4], [-3, 1, 8]):
            directions = np.tile(np.float64(step), (len(targets), 1))
            near = tracer.closest_hit(targets - 2 * directions, directions)
            for distance in (2.0, 2.0**10, 2.0**30, 1_000_003.0):
                hits = tracer.closest_hit(targets - distance * directions, directions)
                np.testing.assert_array_equal(hits.t, distance)
                np.testing.assert_array_equal(hits.locations, targets)
                np.testing.assert_array_equal(hits.prim_id, near.prim_id)
        # Corners of the box that far rays are cut off with, whatever float64 makes of the distances.
        for step in ([3, -1, 8], [-3, 7, 5], [10, 3, -7], [13, -11, 12]):
            directions = np.sign(mesh.vertices) * step
            for distance in (3, 100_003, 1_234_567):
                hits = tracer.closest_hit(mesh.vertices - distance * directions, directions)
                np.testing.assert_array_equal(hits.t, distance)


def test_a_far_origin_advances_by_whole_steps():
    """By a distance of few digits, so that a ray through a point still meets it."""
    bvh = build(make_cube(2.0))
    for step in ([1.0, 2.0, 4.0], [-3.0, 1.0, 8.0]):
        targets = np.random.default_rng(5).integers(-(2**18), 2**18, (100, 3)) * 2.0**-18
        packed = np.zeros(len(targets), PACKED_RAY)
        rays = read_rays(targets - 1_000_003 * np.float64(step), np.float64(step), 0.0, np.inf)
        pack_rays(rays, TreeBox.around(bvh), packed)
        advanced = packed["t_max"] > 0
        assert advanced.mean() > 0.9
        left = (targets[advanced] - packed["origin"][advanced] / bvh.mesh.scale) / step
        assert (np.abs(left) < 100).all()
        np.testing.assert_array_equal(left, left[:, :1].repeat(3, axis=1))
        # A step is an eighth to a quarter of the box's size, a power of two.
        np.testing.assert_array_equal(left[:, 0] % 0.03125, 0)


def test_a_vertex_of_no_triangle_hides_nothing(session):
    """The triangles lie on one side of the centre, to which the box of the tree is symmetric."""
    generator, cube = np.random.default_rng(10), make_cube(1.0)
    directions = generator.normal(size=(500, 3))
    origins = generator.uniform(-0.4, 0.4, (500, 3)) - 1e4 * directions
    for side in (-1, 1):
        with Tracer(([*cube.vertices, [40.0 * side] * 3], cube.faces), device=session.info) as tracer:
            assert tracer.any_hit(origins, directions).all()
            assert tracer.contains([[0, 0, 0], [0.4, 0.4, 0.4], [-0.4, -0.4, -0.4]]).all()


def test_origins_beyond_float32_hit_and_those_beyond_float64_are_named(tracer, session):
    near = tracer.closest_hit([0.725, 0.01, 5], [0, 0, -1])
    for far in (1e5, 1e39, 1e300):
        hits = tracer.closest_hit([[0.725, 0.01, far], [5 * far, far, 0]], [[0, 0, -1], [0, 0, 1]])
        assert hits.prim_id.tolist() == [near.prim_id, -1]
        assert hits.t[0] == pytest.approx(far + near.t - 5, rel=2.0**-50)
    for length in (5e-324, 1e-310, 1e-45, 1e308):
        assert tracer.any_hit([[0.725, 0, 5], [9, 0, 5]], [[0, 0, -length]]).tolist() == [True, False]
    tiny, rays = make_cube(1e-100), ([[0, 0, 1e200], [0, 0, 1e300]], [[0, 0, -1]] * 2)
    with Tracer(tiny, device=session.info) as opened:
        for query in (opened.closest_hit, opened.all_hits, opened.any_hit, opened.count_hits):
            with pytest.raises(QueryError, match=r"^origins\[1\] is too far from the mesh"):
                query(*rays)
        for query in (opened.closest_point, opened.contains, opened.signed_distance):
            with pytest.raises(QueryError, match=r"^points\[1\] is too far from the mesh"):
                query(rays[0])
