"""Size does not matter: in any unit, and with directions of any length, the same hits, bit for bit."""

import numpy as np
import pytest

from clbvh import Mesh, Tracer, build
from clbvh.geometry.shapes.make_shape import make_shape
from clbvh.structs import LAYOUT_WIDTHS

from ...rays import hard_rays

# Powers of two: every power of 4 from 1e-36 to 1e36, and the ends of what a mesh may have.
UNITS = [*range(-120, 121, 2), -490, 490]

# Powers of two for directions, from 1e-30 to 1e30, and close to the ends of float64. Size and length take turns.
LENGTHS = [*range(-100, 101, 25), -800, 800]

# Units and lengths that make a t, but none of the rest, too small or too large for float64.
EXTREMES = [(490, -1000), (-490, 1000)]
OF_T = ("t", "every t", "limited", "any")

COUNT = 300


@pytest.fixture(scope="module")
def mesh():
    return make_shape("blobs", triangles=640)


@pytest.fixture(scope="module")
def rays(mesh):
    generator = np.random.default_rng(7)
    near, (origins, directions) = hard_rays(mesh, COUNT, generator), hard_rays(mesh, COUNT, generator)
    # Some start a thousand sizes away, where they are advanced on their way to the device.
    return np.concatenate((near[0], origins - 1024.0 * directions)), np.concatenate((near[1], directions))


def ask(mesh, rays, layout, unit, length, device):
    """Answers of all queries, with lengths given back in units and t in lengths of the direction at size 1."""
    vertices, (origins, directions) = np.ldexp(mesh.vertices, unit), rays
    origins, directions = np.ldexp(origins, unit), np.ldexp(directions, length)
    t_limits = {"t_min": np.ldexp(0.25, unit - length), "t_max": np.ldexp(2048.0, unit - length)}
    points = origins[:COUNT]
    with Tracer(build(Mesh.from_arrays(vertices, mesh.faces)), device=device, layout=layout) as tracer:
        hits = tracer.closest_hit(origins, directions)
        limited = tracer.closest_hit(origins, directions, **t_limits)
        every = tracer.all_hits(origins, directions, with_locations=True)
        nearest = tracer.closest_point(points)
        return {
            "prim_id": hits.prim_id,
            "t": np.ldexp(hits.t, length - unit),
            "u": hits.u,
            "v": hits.v,
            "locations": np.ldexp(hits.locations, -unit),
            "normals": hits.normals,
            "limited": limited.prim_id,
            "any": tracer.any_hit(origins, directions, **t_limits),
            "counts": tracer.count_hits(origins, directions),
            "every prim_id": every.prim_id,
            "every t": np.ldexp(every.t, length - unit),
            "every location": np.ldexp(every.locations, -unit),
            "distance": np.ldexp(nearest.distance, -unit),
            "nearest": np.ldexp(nearest.point, -unit),
            "nearest prim_id": nearest.prim_id,
            "inside": tracer.contains(points),
        }


@pytest.mark.filterwarnings("ignore:overflow encountered in ldexp")
@pytest.mark.parametrize("layout", LAYOUT_WIDTHS)
def test_every_size_gives_the_same_bits(session, mesh, rays, layout):
    expected = ask(mesh, rays, layout, 0, 0, session.info)
    assert 0.3 < (expected["prim_id"] >= 0).mean() < 0.95
    assert 0 < (expected["limited"] != expected["prim_id"]).sum() < COUNT
    assert expected["inside"].any()
    cases = [(unit, LENGTHS[turn % len(LENGTHS)]) for turn, unit in enumerate(UNITS)] + EXTREMES
    for unit, length in cases[{"bvh2": 0, "bvh4": 1, "bvh8": 2}[layout] :: 3]:
        for name, values in ask(mesh, rays, layout, unit, length, session.info).items():
            if (unit, length) not in EXTREMES or name not in OF_T:
                assert values.tobytes() == expected[name].tobytes(), (name, unit, length)


def test_the_t_of_a_hit_is_never_that_of_a_miss(session):
    """A t beyond float64 is its largest number."""
    mesh = Mesh.from_arrays(np.ldexp([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], 490), [[0, 1, 2]])
    origin = np.ldexp([[0.25, 0.25, 1]], 490)
    with Tracer(build(mesh), device=session.info) as tracer:
        hits = tracer.closest_hit(origin, [[0, 0, -(2.0**-900)]])
    assert hits.prim_id.tolist() == [0]
    assert hits.t.tolist() == [np.finfo(np.float64).max]


@pytest.mark.parametrize("size", [1e-3, 0.1, 1e-17, 1e19])
def test_hits_are_on_the_files_own_planes(session, size):
    """A box's corner is no float32, and its face is hit where float64 has it."""
    low, high = -size / 3, size * 0.7
    corners = np.array([[x, y, z] for x in (low, high) for y in (low, high) for z in (low, high)])
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    mesh = Mesh.from_arrays(corners, [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))])
    across = np.random.default_rng(1).uniform(-0.3, 0.6, (50, 2)) * size
    with Tracer(build(mesh), device=session.info) as tracer:
        for axis in range(3):
            origins = np.insert(across, axis, 5 * size, axis=1)
            directions = np.tile(-np.eye(3)[axis], (len(origins), 1))
            hits = tracer.closest_hit(origins, directions)
            assert (hits.locations[:, axis] == high).all()
            np.testing.assert_allclose(hits.t, 5 * size - high, rtol=1e-15)
            assert (
                tracer.all_hits(origins, directions, with_locations=True).locations[1::2, axis].tolist() == [low] * 50
            )
            points = np.insert(across, axis, 0.69 * size, axis=1)
            nearest = tracer.closest_point(points)
            assert (nearest.point[:, axis] == high).mean() > 0.5
            on_face = nearest.point[:, axis] == high
            np.testing.assert_allclose(nearest.distance[on_face], high - 0.69 * size, rtol=1e-12)
            assert tracer.signed_distance(points).min() > 0
