"""The tracer: any number of rays, in any chunks and any form, at any place and scale; bad input is refused."""

import dataclasses
import re

import numpy as np
import pytest

from clbvh import Mesh, Tracer, build
from clbvh.device.session import DeviceSession
from clbvh.errors import ConfigError, DeviceError, QueryError
from clbvh.geometry.shapes.make_shape import make_shape
from clbvh.structs import HIT, NO_PRIM, PACKED_RAY
from clbvh.trace import tracer as tracer_module
from clbvh.trace.rays import pieces

from ...chain import make_chain
from ...profiles import seeds
from ...rays import aim, hard_rays, random_rays

COUNTS = [0, 1, 2, 63, 64, 65, 1023, 1024, 1025]
FIELDS = ("t", "u", "v", "prim_id")

WRONG_LIMIT_SHAPE = "must be a number or have a shape that broadcasts to that of the rays, (9,), not"


def resolution(mesh, rays, hits):
    """How far float32 may be off in t: sixteen roundings along the ray, and across it on a slanted plane."""
    reach = np.abs(rays[0]).max(axis=1) + np.ptp(mesh.vertices, axis=0).max()
    length = np.linalg.norm(rays[1], axis=1)
    cosine = np.abs((hits.normals * rays[1]).sum(axis=1)) / length
    with np.errstate(divide="ignore"):
        return 16 * 2.0**-24 * reach * (1 + 1 / cosine) / length


@pytest.fixture(scope="module")
def expected(tracer, rays):
    hits = tracer.closest_hit(*rays)
    assert 0.3 < hits.is_hit.mean() < 0.95
    return hits


def assert_same(obtained, expected, rows=slice(None)):
    for field in FIELDS:
        assert getattr(obtained, field).tobytes() == getattr(expected, field)[rows].tobytes(), field


def record_allocations(monkeypatch):
    """A list that gets the size of every buffer from now on."""
    sizes, allocate = [], DeviceSession.allocate
    monkeypatch.setattr(
        DeviceSession, "allocate", lambda self, size, **how: sizes.append(size) or allocate(self, size, **how)
    )
    return sizes


def count_buffers(tracer):
    """The buffers of the tree and of a call that has ended."""
    (memory,) = tracer._caster.calls._idle
    return tracer._caster.session.buffer_count + memory.session.buffer_count


class TestBatches:
    @pytest.mark.parametrize("count", COUNTS)
    def test_any_number_of_rays(self, tracer, rays, expected, count):
        hits = tracer.closest_hit(rays[0][:count], rays[1][:count])
        assert len(hits) == count
        assert_same(hits, expected, slice(count))
        blocked = tracer.any_hit(rays[0][:count], rays[1][:count])
        assert blocked.dtype == bool
        np.testing.assert_array_equal(blocked, expected.is_hit[:count])

    @pytest.mark.parametrize("count", [0, 1, 99, 100, 101, 250])
    def test_chunks_are_not_seen(self, tracer, rays, expected, monkeypatch, count):
        monkeypatch.setattr(pieces, "CHUNK_RAYS", 100)
        t_max = np.where(np.arange(count) % 3, np.inf, 0.5)
        hits = tracer.closest_hit(rays[0][:count], rays[1][:count])
        blocked = tracer.any_hit(rays[0][:count], rays[1][:count], t_max=t_max)
        assert_same(hits, expected, slice(count))
        np.testing.assert_array_equal(blocked, (expected.t[:count] <= t_max) & expected.is_hit[:count])

    def test_one_ray_more_than_a_chunk(self, session, monkeypatch):
        monkeypatch.setattr(pieces, "CHUNK_RAYS", 2 * pieces.LEAST_RAYS)  # so that chunks are sorted
        mesh = make_shape("icosphere", triangles=20)
        count = pieces.CHUNK_RAYS + 1
        origins, directions = random_rays(mesh, count, np.random.default_rng(33))
        cut = count // 3
        with Tracer(build(mesh), device=session.info) as opened:
            whole = opened.closest_hit(origins, directions)
            assert 0.2 < whole.is_hit.mean() < 0.95
            for part in (slice(cut), slice(cut, None)):
                assert_same(opened.closest_hit(origins[part], directions[part]), whole, part)
            np.testing.assert_array_equal(opened.any_hit(origins, directions), whole.is_hit)

    def test_every_ray_gets_the_same_answer_alone(self, tracer, rays, expected):
        for row in range(0, 3072, 97):
            assert_same(tracer.closest_hit(rays[0][row : row + 1], rays[1][row : row + 1]), expected, [row])

    @pytest.mark.parametrize("seed", seeds(2))
    def test_every_ray_gets_the_same_answer_in_any_order(self, tracer, rays, expected, seed):
        order = np.random.default_rng([32, seed]).permutation(len(rays[0]))
        assert_same(tracer.closest_hit(rays[0][order], rays[1][order]), expected, order)

    def test_neighbours_of_extreme_length_change_nothing(self, tracer, rays, expected):
        origins, directions = np.concatenate((rays[0], [[0, 0, 9]])), np.concatenate((rays[1], [[0, 0, 1e-30]]))
        hits = tracer.closest_hit(origins, directions)
        for field in FIELDS:
            assert getattr(hits, field)[:-1].tobytes() == getattr(expected, field).tobytes(), field

    @pytest.mark.parametrize(("count", "rays_held"), [(7, 7), (100, 100), (101, 100), (1000, 100)])
    def test_memory_is_that_of_one_chunk_at_most(self, session, mesh, rays, monkeypatch, count, rays_held):
        monkeypatch.setattr(pieces, "CHUNK_RAYS", 100)
        with Tracer(build(mesh), device=session.info) as opened:
            sizes = record_allocations(monkeypatch)
            opened.closest_hit([], [])
            assert sizes == []
            opened.closest_hit(rays[0][:count], rays[1][:count])
            assert sizes == [rays_held * PACKED_RAY.itemsize, rays_held * HIT.itemsize]
            # The second batch takes the memory of the first, and so does what needs less.
            opened.closest_hit(rays[0][:count], rays[1][:count])
            opened.any_hit(rays[0][:count], rays[1][:count])
            assert len(sizes) == 2
            assert count_buffers(opened) == 4

    def test_memory_grows_with_the_batch(self, session, mesh, rays, expected):
        with Tracer(build(mesh), device=session.info) as opened:
            for count in (1, 1000, 10, 3072):
                assert_same(opened.closest_hit(rays[0][:count], rays[1][:count]), expected, slice(count))
            with pytest.raises(ValueError, match="length zero"):
                opened.closest_hit([[0, 0, 0]], [[0, 0, 0]])
            assert count_buffers(opened) == 4

    @pytest.mark.parametrize("shape", [(3072,), (64, 48), (4, 32, 24), (1, 3072), (3072, 1)], ids=str)
    def test_results_have_the_leading_shape_of_the_rays(self, tracer, rays, expected, monkeypatch, shape):
        monkeypatch.setattr(pieces, "LEAST_RAYS", 1000)
        origins, directions = (array.reshape(*shape, 3) for array in rays)
        hits = tracer.closest_hit(origins, directions, t_min=np.zeros(shape))
        for field in FIELDS:
            assert getattr(hits, field).shape == shape
            assert getattr(hits, field).tobytes() == getattr(expected, field).tobytes(), field
        assert hits.locations.shape == hits.normals.shape == (*shape, 3)
        assert tracer.any_hit(origins, directions).shape == shape
        assert tracer.closest_prim(origins, directions).tobytes() == expected.prim_id.tobytes()
        counts = tracer.count_hits(origins, directions)
        assert counts.shape == shape
        crossings = tracer.all_hits(origins, directions)
        np.testing.assert_array_equal(crossings.counts, counts.reshape(-1))
        closest = tracer.closest_point(origins)
        assert closest.distance.shape == closest.prim_id.shape == tracer.contains(origins).shape == shape
        assert closest.point.shape == (*tracer.signed_distance(origins).shape, 3)

    @pytest.mark.parametrize("least_rays", [1 << 16, 100], ids=["unsorted", "sorted"])
    def test_buffers_respect_the_largest_allocation(self, session, mesh, rays, expected, monkeypatch, least_rays):
        """As on a device that allocates no more than 16 KiB at a time, apart from the tree."""
        monkeypatch.setattr(pieces, "LEAST_RAYS", least_rays)
        small = dataclasses.replace(session.info, max_allocation_bytes=16384)
        with Tracer(build(mesh), device=session.info) as opened:
            opened._caster.session.info = small
            sizes = record_allocations(monkeypatch)
            assert_same(opened.closest_hit(*rays), expected)
            everything = opened.all_hits(*rays)
            np.testing.assert_array_equal(opened.count_hits(*rays), everything.counts)
            assert opened.closest_point(rays[0]).distance.shape == (3072,)
        assert max(sizes) <= 16384

    def test_progress_is_told(self, tracer, rays, monkeypatch):
        monkeypatch.setattr(pieces, "CHUNK_RAYS", 1000)
        for cast in (tracer.closest_hit, tracer.closest_prim, tracer.any_hit):
            told = []
            cast(*rays, progress=lambda done, total, told=told: told.append((done, total)))
            assert told == [(1000, 3072), (2000, 3072), (3000, 3072), (3072, 3072)]


class TestInput:
    @pytest.mark.parametrize("dtype", [np.float32, np.float64, np.dtype(">f8"), np.dtype(">f4"), np.longdouble])
    def test_floats_of_any_kind(self, tracer, rays, expected, dtype):
        assert_same(tracer.closest_hit(rays[0].astype(dtype), rays[1].astype(dtype)), expected)

    @pytest.mark.parametrize("dtype", [np.int8, np.int64, np.uint16, np.float16])
    def test_small_numbers_of_any_kind(self, tracer, dtype):
        origins, directions = np.array([[2, 0, 0], [2, 1, 0]]), np.array([[0, 1, 0], [0, 0, 1]])
        hits = tracer.closest_hit(origins.astype(dtype), directions.astype(dtype))
        assert_same(hits, tracer.closest_hit(origins.astype(float), directions.astype(float)))

    def test_lists_and_strides(self, tracer, rays, expected):
        assert_same(tracer.closest_hit(rays[0][:50].tolist(), rays[1][:50].tolist()), expected, slice(50))
        wide = np.concatenate(rays, axis=1)
        assert_same(tracer.closest_hit(wide[::2, :3], wide[::2, 3:]), expected, slice(None, None, 2))
        assert_same(tracer.closest_hit(np.asfortranarray(rays[0]), np.asfortranarray(rays[1])), expected)
        assert len(tracer.closest_hit([], [])) == 0
        assert tracer.any_hit(np.empty((0, 3)), []).shape == (0,)

    def test_input_is_not_modified(self, tracer, rays):
        given = [array.copy() for array in (*rays, np.zeros(3072), np.full(3072, 9.0))]
        given[1][5] *= 1e30
        copies = [array.copy() for array in given]
        for array in given:
            array.flags.writeable = False
        tracer.closest_hit(given[0], given[1], t_min=given[2], t_max=given[3])
        for array, copy in zip(given, copies, strict=True):
            np.testing.assert_array_equal(array, copy)

    @pytest.mark.parametrize(
        ("origins", "directions", "message"),
        [
            (np.zeros((4, 2)), np.ones((4, 2)), "origins must have shape (3,), (n, 3) or (..., 3), not (4, 2)"),
            (np.zeros(2), np.ones((1, 3)), "origins must have shape (3,), (n, 3) or (..., 3), not (2,)"),
            (np.zeros(3), 1.0, "directions must have shape (3,), (n, 3) or (..., 3), not ()"),
            (np.zeros((0, 2)), np.ones((0, 3)), "origins must have shape (3,), (n, 3) or (..., 3), not (0, 2)"),
            (
                np.zeros((4, 3)),
                np.ones((5, 3)),
                "origins and directions must have shapes that broadcast against each other, not (4, 3) and (5, 3)",
            ),
            (
                np.zeros((2, 4, 3)),
                np.ones((2, 3)),
                "origins and directions must have shapes that broadcast against each other, not (2, 4, 3) and (2, 3)",
            ),
        ],
        ids=["two-columns", "two-numbers", "number", "empty", "lengths", "axes"],
    )
    def test_wrong_shapes(self, tracer, origins, directions, message):
        for cast in (tracer.closest_hit, tracer.any_hit):
            with pytest.raises(QueryError, match=f"^{re.escape(message)}$"):
                cast(origins, directions)

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    @pytest.mark.parametrize("axis", range(3))
    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_the_first_row_that_is_not_finite_is_named(self, tracer, bad, axis, dtype):
        for name in ("origins", "directions"):
            given = {"origins": np.ones((9, 3), dtype), "directions": np.ones((9, 3), dtype)}
            given[name][[7, 4, 8], axis] = bad
            with pytest.raises(QueryError, match=rf"^{name}\[4\] is not finite: "):
                tracer.closest_hit(**given)

    @pytest.mark.parametrize("zero", [0.0, -0.0])
    def test_the_first_direction_of_length_zero_is_named(self, tracer, zero):
        directions = np.ones((9, 3))
        directions[[3, 6]] = zero
        with pytest.raises(QueryError, match=r"^directions\[3\] has length zero$"):
            tracer.closest_hit(np.zeros((9, 3)), directions)

    @pytest.mark.parametrize("far", [1e39, -1e39, 1e45, -1e45, 1e60, -1e60, 1e300, -1e300])
    def test_an_origin_beyond_float32_hits(self, tracer, far):
        hits = tracer.closest_hit([[0.725, 0.01, far], [5 * far, far, 0]], [[0, 0, -np.sign(far)], [0, 0, 1]])
        assert hits.is_hit.tolist() == [True, False]
        assert hits.t[0] == pytest.approx(abs(far), rel=1e-15)

    def test_an_origin_too_far_for_float64_is_named(self, session):
        faces = [[0, 1, 2], [0, 2, 1]]
        tiny = Mesh.from_arrays(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]) * 1e-100, faces)
        with Tracer(build(tiny), device=session.info) as opened:
            for query in (opened.closest_hit, opened.all_hits, opened.any_hit, opened.count_hits):
                with pytest.raises(QueryError, match=r"^origins\[1\] is too far from the mesh"):
                    query([[0, 0, 1e200], [0, 0, 1e300]], [[0, 0, -1]] * 2)
            for query in (opened.closest_point, opened.contains, opened.signed_distance):
                with pytest.raises(QueryError, match=r"^points\[1\] is too far from the mesh"):
                    query([[0, 0, 1e200], [0, 0, 1e300]])

    @pytest.mark.parametrize("far", [1e5, -1e7, 1e10])
    def test_an_origin_beyond_float32_resolution_hits_what_a_near_one_hits(self, tracer, far):
        sign = np.sign(far)
        near = tracer.closest_hit([[0.725, 0.01, 5 * sign], [0.725, 9 * sign, 0.01]], [[0, 0, -sign], [0, -sign, 0]])
        assert near.count == 2
        origins, directions = [[0.725, 0.01, far], [0.725, far, 0.01]], [[0, 0, -sign], [0, -sign, 0]]
        hits = tracer.closest_hit(origins, directions)
        np.testing.assert_array_equal(hits.is_hit, near.is_hit)
        np.testing.assert_array_equal(hits.prim_id, near.prim_id)
        np.testing.assert_allclose(hits.t - abs(far), near.t - [5, 9], atol=abs(far) * 2.0**-50)
        assert tracer.closest_hit(origins, np.negative(directions)).count == 0

    @pytest.mark.parametrize(
        ("limits", "message"),
        [
            (
                {"t_min": np.zeros(8)},
                "t_min must be a number or have a shape that broadcasts to that of the rays, (9,), not (8,)",
            ),
            (
                {"t_max": np.ones((9, 1))},
                "t_max must be a number or have a shape that broadcasts to that of the rays, (9,), not (9, 1)",
            ),
            ({"t_min": np.nan}, "t_min must be a number from 0, not nan"),
            ({"t_max": np.nan}, "t_max must be a number, not nan"),
            ({"t_max": [1, 2, np.nan, 1, np.nan, 1, 1, 1, 1]}, "t_max[2] must be a number, not nan"),
            ({"t_min": -1e-300}, "t_min must be a number from 0, not -1e-300"),
            ({"t_min": [0, 1, 0, -2, 1, -3, 0, 0, 0]}, "t_min[3] must be a number from 0, not -2.0"),
        ],
    )
    def test_bad_limits(self, tracer, limits, message):
        for cast in (tracer.closest_hit, tracer.any_hit):
            with pytest.raises(QueryError, match=f"^{re.escape(message)}$"):
                cast(np.zeros((9, 3)), np.ones((9, 3)), **limits)

    def test_a_bad_ray_of_several_axes_is_named_by_its_indices(self, tracer):
        origins, directions = np.zeros((2, 5, 3)), np.ones((2, 5, 3))
        directions[1, 3] = 0.0
        with pytest.raises(QueryError, match=r"^directions\[1, 3\] has length zero$"):
            tracer.any_hit(origins, directions)
        with pytest.raises(QueryError, match=r"^t_min\[1, 2\] must be a number from 0, not -1.0$"):
            tracer.closest_hit(origins, np.ones((2, 5, 3)), t_min=np.where(np.arange(10) == 7, -1.0, 0.0).reshape(2, 5))

    @pytest.mark.parametrize(
        "bad",
        [
            [["a", "b", "c"]],
            [["1", "2", "3"]],
            [[1, 2], [1, 2, 3]],
            [[1j, 0, 0]],
            [[True, False, True]],
            np.zeros((1, 3), "m8[s]"),
            [[object(), 1, 2]],
        ],
    )
    def test_what_are_no_numbers_is_refused(self, tracer, bad):
        for origins, directions in ((bad, [[0, 0, 1]]), ([[0, 0, 1]], bad)):
            with pytest.raises(QueryError, match="must be numbers"):
                tracer.closest_hit(origins, directions)
        with pytest.raises(QueryError, match="must be numbers"):
            tracer.closest_point(bad)

    @pytest.mark.parametrize("bad", [0, 1.5, True, "a", 2**31])
    def test_a_limit_of_hits_that_is_none_is_refused(self, tracer, bad):
        for query in (tracer.all_hits, tracer.count_hits):
            with pytest.raises(ConfigError, match="max_hits must be None or a number from 1"):
                query([[0, 0, 1]], [[0, 0, 1]], max_hits=bad)


class TestLimits:
    def test_one_number_is_for_all_rays(self, tracer, rays, expected):
        found = expected.is_hit
        middle = float(np.median(expected.t[found]))
        hits = tracer.closest_hit(*rays, t_max=middle)
        near = found & (expected.t <= np.float32(middle))
        assert 0.2 < near.mean() < 0.8
        np.testing.assert_array_equal(hits.is_hit, near)
        np.testing.assert_array_equal(hits.t[near], expected.t[near])
        np.testing.assert_array_equal(tracer.any_hit(*rays, t_max=middle), near)

    def test_each_ray_has_its_own(self, tracer, mesh, rays, expected):
        found = expected.is_hit
        # Just before the hit it is allowed; what comes just after it is asked for every second ray.
        even = np.arange(len(expected)) % 2 == 0
        slack = resolution(mesh, rays, expected)
        t_min = np.maximum(expected.t + np.where(even, -slack, slack), 0)
        t_min[~found] = 0
        hits = tracer.closest_hit(*rays, t_min=t_min)
        for field in FIELDS:
            np.testing.assert_array_equal(getattr(hits, field)[even], getattr(expected, field)[even])
        odd = ~even & found
        assert (hits.t[odd] > expected.t[odd]).all()
        assert hits.is_hit[odd].mean() > 0.5
        np.testing.assert_array_equal(tracer.any_hit(*rays, t_min=t_min), hits.is_hit)

    def test_before_the_hit_there_is_nothing(self, tracer, mesh, rays, expected):
        t_max = expected.t - resolution(mesh, rays, expected)
        t_max[~expected.is_hit] = np.inf
        assert not tracer.any_hit(*rays, t_max=t_max).any()

    def test_t_is_never_outside_of_the_limits(self, tracer, rays, expected):
        found = expected.is_hit
        for t_min, t_max in ((np.where(found, expected.t, 0), np.inf), (0, expected.t)):
            hits = tracer.closest_hit(*rays, t_min=t_min, t_max=t_max)
            inside = (hits.t >= t_min) & (hits.t <= t_max)
            assert inside[hits.is_hit].all()

    def test_an_empty_interval_is_a_miss(self, tracer, rays):
        for t_min, t_max in ((2, 1), (0, -1), (np.inf, np.inf), (0, -np.inf), (1e300, np.inf)):
            hits = tracer.closest_hit(*rays, t_min=t_min, t_max=t_max)
            assert hits.count == 0
            assert (hits.t == np.inf).all()

    def test_limits_beyond_float32_are_no_limits(self, tracer, rays, expected):
        assert_same(tracer.closest_hit(*rays, t_max=1e300), expected)


class TestLengths:
    """t counts in lengths of the direction, whatever the length."""

    @pytest.mark.parametrize("exponent", [-130, -100, -41, -40, -1, 40, 41, 100, 120])
    def test_powers_of_two_change_t_only(self, tracer, rays, expected, exponent):
        hits = tracer.closest_hit(rays[0], rays[1] * 2.0**exponent)
        with np.errstate(over="ignore"):
            np.testing.assert_array_equal(hits.t, np.ldexp(expected.t, -exponent))
        for field in ("u", "v", "prim_id"):
            np.testing.assert_array_equal(getattr(hits, field), getattr(expected, field))

    @pytest.mark.parametrize("length", [1e-30, 1e-3, 1e3, 1e30])
    def test_any_length(self, tracer, rays, expected, length):
        hits = tracer.closest_hit(rays[0], rays[1] * length)
        # Another rounding of the direction: hits on an edge may go to the neighbour, or beside the silhouette.
        same = hits.prim_id == expected.prim_id
        assert same.mean() > 0.7
        np.testing.assert_allclose(hits.t[same] * np.float64(length), expected.t[same], rtol=1e-4)

    @pytest.mark.parametrize("length", [5e-324, 1e-310, 1e-45, 1e308])
    def test_the_ends_of_float64(self, tracer, length):
        hits = tracer.closest_hit([[0.725, 0, 5], [9, 0, 5]], [[0, 0, -length], [0, 0, -length]])
        assert hits.is_hit.tolist() == [True, False]
        assert tracer.any_hit([[0.725, 0, 5]], [[0, 0, -length]]).tolist() == [True]

    @pytest.mark.parametrize("length", [1e-30, 1e30])
    def test_limits_count_in_the_same_lengths(self, tracer, mesh, rays, expected, length):
        directions = rays[1] * length
        hits = tracer.closest_hit(rays[0], directions)
        found = hits.is_hit
        slack = resolution(mesh, (rays[0], directions), hits)
        t_max = np.where(found, hits.t - slack, np.inf)
        assert not tracer.any_hit(rays[0], directions, t_max=t_max).any()
        t_max = np.where(found, hits.t + slack, 0)
        np.testing.assert_array_equal(tracer.any_hit(rays[0], directions, t_max=t_max), found)

    def test_infinite_limits_stay_infinite(self, tracer):
        hits = tracer.closest_hit([[0.725, 0, 5]], [[0, 0, -1e-30]], t_min=0, t_max=np.inf)
        assert hits.t[0] == pytest.approx(1e30 * tracer.closest_hit([[0.725, 0, 5]], [[0, 0, -1]]).t[0])


class TestFarFromTheOrigin:
    OFFSET = np.array([5.0e5, 4.65e6, 1.2e3])  # a survey's coordinates: metres east, north and up

    @pytest.mark.parametrize("size", [1e-3, 1.0, 100.0])
    def test_survey_coordinates_lose_nothing(self, session, mesh, rays, expected, size):
        # Multiples of a power of two far above float64's rounding there, so that the shift itself is exact.
        step = 2.0**-23
        vertices = np.round(mesh.vertices * size / step) * step
        near = Mesh.from_arrays(vertices, mesh.faces)
        far = Mesh.from_arrays(vertices + self.OFFSET, mesh.faces)
        origins, directions = np.round(rays[0] * size / step) * step, rays[1]
        with Tracer(build(near), device=session.info) as one, Tracer(build(far), device=session.info) as other:
            assert_same(other.closest_hit(origins + self.OFFSET, directions), one.closest_hit(origins, directions))

    def test_hits_are_in_the_right_place(self, session, mesh, rays):
        far = Mesh.from_arrays(mesh.vertices + self.OFFSET, mesh.faces)
        origins = rays[0] + self.OFFSET
        with Tracer(build(far), device=session.info) as opened:
            hits = opened.closest_hit(origins, rays[1])
        found = hits.is_hit
        corners = far.vertices[far.faces[hits.prim_id[found]]]
        u, v = hits.u[found, None].astype(np.float64), hits.v[found, None].astype(np.float64)
        on_triangle = (1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
        on_ray = origins[found] + hits.t[found, None].astype(np.float64) * rays[1][found]
        distance = np.linalg.norm(on_triangle - on_ray, axis=1)
        assert np.quantile(distance, 0.99) < 1e-5
        assert found.mean() > 0.3


class TestMeshes:
    @pytest.mark.parametrize("faces", [[[0, 1, 2]], [[0, 1, 2], [0, 1, 2]], [[0, 0, 0], [0, 1, 2]]])
    def test_few_triangles(self, session, faces):
        mesh = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], faces)
        with Tracer(build(mesh), device=session.info) as opened:
            hits = opened.closest_hit([[0.25, 0.25, 1], [0.9, 0.9, 1]], [[0, 0, -1], [0, 0, -1]])
        assert hits.t.tolist() == [1, np.inf]
        assert hits.prim_id.tolist() == [1 if faces[0] == [0, 0, 0] else 0, NO_PRIM]

    def test_nothing_but_degenerate_triangles(self, session):
        mesh = Mesh.from_arrays([[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2], [0, 0, 1], [1, 1, 1]])
        with Tracer(build(mesh), device=session.info) as opened:
            origins, directions = aim([[1, 1, 5], [-1, -1, -1], [5, 1, 1]], [[1, 1, 1], [1, 1, 1], [1, 1, 1]])
            assert opened.closest_hit(origins, directions).count == 0


class TestLife:
    def test_it_says_what_it_is(self, session, tracer):
        assert repr(tracer) == f"Tracer('knot', device='{session.info.name}', layout='{tracer.layout}')"
        assert tracer.layout == session.info.layout
        assert tracer.memory_bytes > 1800 * 40

    def test_times_add_up(self, session, mesh, rays):
        with Tracer(build(mesh), device=session.info) as opened:
            before = opened.timings_ms
            assert set(before) == {"upload"}
            opened.closest_hit(*rays)
            between = opened.timings_ms
            opened.any_hit(*rays)
            after = opened.timings_ms
        assert set(after) == {"upload", "kernel", "download"}
        assert before["upload"] < between["upload"] < after["upload"]
        assert 0 < between["kernel"] < after["kernel"]

    def test_a_closed_tracer_says_so(self, session, mesh):
        opened = Tracer(build(mesh), device=session.info)
        opened.close()
        opened.close()
        for cast in (opened.closest_hit, opened.any_hit):
            with pytest.raises(QueryError, match="the tracer is closed"):
                cast([[0, 0, 0]], [[0, 0, 1]])

    def test_unknown_layouts_and_devices(self, mesh):
        with pytest.raises(ConfigError, match="layout must be one of"):
            Tracer(build(mesh), layout="bvh3")
        with pytest.raises(DeviceError, match="no such board"):
            Tracer(build(mesh), device="no such board")

    def test_a_tree_that_is_refused_leaves_nothing_on_the_device(self, session, monkeypatch):
        opened = []

        class Recorded(DeviceSession):
            def __init__(self, device):
                super().__init__(device)
                opened.append(self)

        monkeypatch.setattr(tracer_module, "DeviceSession", Recorded)
        with pytest.raises(ConfigError, match="levels deep"):
            Tracer(make_chain(1026, "left")[1], device=session.info, layout="bvh2")
        assert [session.is_closed for session in opened] == [True]

    def test_two_tracers_do_not_disturb_each_other(self, session, tracer, rays, expected):
        other_mesh = make_shape("icosphere", triangles=80)
        with Tracer(build(other_mesh), device=session.info) as other:
            other.closest_hit(*rays)
            assert_same(tracer.closest_hit(*rays), expected)
        assert_same(tracer.closest_hit(*rays), expected)


def test_any_hit_agrees_with_closest_hit(tracer, mesh):
    origins, directions = hard_rays(mesh, 60_000, np.random.default_rng(33))
    np.testing.assert_array_equal(tracer.any_hit(origins, directions), tracer.closest_hit(origins, directions).is_hit)


def test_hits_are_of_the_ray_as_given(tracer, mesh, rays):
    # Not of the one that is rounded to float32 for the device.
    generator = np.random.default_rng(34)
    origins = rays[0] + generator.uniform(-1e-3, 1e-3, (len(rays[0]), 3))
    directions = rays[1] + generator.uniform(-1e-3, 1e-3, (len(rays[1]), 3))
    hits = tracer.closest_hit(origins, directions)
    found = np.flatnonzero(hits.is_hit)
    on_ray = origins[found] + hits.t[found, None] * directions[found]
    distance = np.linalg.norm(on_ray - hits.locations[found], axis=1)
    assert np.quantile(distance, 0.99) < 1e-13
    assert np.isnan(hits.locations[~hits.is_hit]).all()
    corners = mesh.vertices[mesh.faces[hits.prim_id[found]]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    np.testing.assert_allclose(hits.normals[found], normals, atol=1e-13)
