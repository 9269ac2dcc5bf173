"""Rays of any leading shapes, broadcast against each other without copies of the length of the rays."""

import re
import tracemalloc

import numpy as np
import pytest

from clbvh.builders.build import build
from clbvh.errors import QueryError
from clbvh.geometry.shapes.make_shape import make_shape
from clbvh.trace.rays import pieces
from clbvh.trace.rays.batch import Broadcast, read_points, read_rays
from clbvh.trace.tracer import Tracer

FIELDS = ("t", "u", "v", "prim_id", "is_front")

# Shapes of origins and directions, and of the rays.
SHAPES = {
    "one origin": ((3,), (50, 3), (50,)),
    "one origin of three numbers, three rays": ((3,), (3, 3), (3,)),
    "one origin in a list": ((1, 3), (50, 3), (50,)),
    "one direction": ((50, 3), (3,), (50,)),
    "one origin, picture": ((3,), (9, 8, 3), (9, 8)),
    "one of each": ((3,), (3,), ()),
    "one of each in a list": ((1, 3), (3,), (1,)),
    "sets": ((6, 11, 3), (11, 3), (6, 11)),
    "outer": ((7, 1, 3), (13, 3), (7, 13)),
    "outer, both": ((7, 1, 3), (1, 13, 3), (7, 13)),
    "middle": ((4, 1, 5, 3), (6, 1, 3), (4, 6, 5)),
    "none": ((0, 3), (3,), (0,)),
    "none, twice": ((1, 0, 3), (4, 1, 3), (4, 0)),
}


@pytest.fixture(scope="module")
def tracer(_opened_device):
    with Tracer(build(make_shape("knot", triangles=600)), device=_opened_device.info) as opened:
        yield opened


def make_rays(shapes, seed=0):
    """Rays from around the mesh to points in it."""
    generator = np.random.default_rng(seed)
    origins = generator.normal(size=shapes[0]) * 3
    return origins, generator.normal(size=shapes[1]) * 0.3 - origins.reshape(-1, 3)[:1].sum(axis=0)


def copied(*arrays):
    """The same rays as flat arrays without broadcasting."""
    return [np.ascontiguousarray(array).reshape(-1, 3) for array in np.broadcast_arrays(*arrays)]


@pytest.mark.parametrize("chunk", [7, 2**20])
@pytest.mark.parametrize("case", SHAPES)
class TestShapes:
    def test_queries_answer_as_for_copied_rays(self, tracer, monkeypatch, case, chunk):
        *shapes, shape = SHAPES[case]
        monkeypatch.setattr(pieces, "CHUNK_RAYS", chunk)
        origins, directions = make_rays(shapes)
        flat = copied(origins, directions)
        hits, expected = tracer.closest_hit(origins, directions), tracer.closest_hit(*flat)
        for field in FIELDS:
            obtained = getattr(hits, field)
            assert isinstance(obtained, np.ndarray)
            assert obtained.shape == hits.shape == shape
            assert obtained.tobytes() == getattr(expected, field).tobytes()
        assert hits.locations.shape == hits.normals.shape == hits.offset_origins().shape == (*shape, 3)
        for query in (tracer.any_hit, tracer.count_hits, tracer.closest_prim):
            obtained = query(origins, directions)
            assert isinstance(obtained, np.ndarray)
            assert obtained.shape == shape
            assert obtained.tobytes() == query(*flat).tobytes()
        crossings, expected = tracer.all_hits(origins, directions), tracer.all_hits(*flat)
        for field in (*FIELDS, "offsets"):
            assert getattr(crossings, field).tobytes() == getattr(expected, field).tobytes()
        assert len(crossings.offsets) == len(flat[0]) + 1

    def test_limits_broadcast_to_the_rays(self, tracer, monkeypatch, case, chunk):
        *shapes, shape = SHAPES[case]
        monkeypatch.setattr(pieces, "CHUNK_RAYS", chunk)
        origins, directions = make_rays(shapes)
        generator = np.random.default_rng(1)
        for of_limits in {shape, (1, *shape[1:]) if shape else (), shape[-1:], ()}:
            near, far = generator.random(of_limits), 1 + generator.random(of_limits)
            hits = tracer.closest_hit(origins, directions, t_min=near, t_max=far)
            limits = {
                name: np.broadcast_to(limit, shape).reshape(-1) for name, limit in (("t_min", near), ("t_max", far))
            }
            expected = tracer.closest_hit(*copied(origins, directions), **limits)
            assert hits.t.shape == shape
            assert hits.t.tobytes() == expected.t.tobytes()

    def test_points(self, tracer, monkeypatch, case, chunk):
        monkeypatch.setattr(pieces, "CHUNK_RAYS", chunk)
        points = make_rays(SHAPES[case][:2])[0]
        closest, expected = tracer.closest_point(points), tracer.closest_point(points.reshape(-1, 3))
        for obtained, of_flat in zip(closest, expected, strict=True):
            assert obtained.tobytes() == of_flat.tobytes()
        shape = points.shape[:-1]
        assert closest.distance.shape == closest.prim_id.shape == tracer.contains(points).shape == shape
        assert closest.point.shape == points.shape
        assert tracer.signed_distance(points).shape == shape
        assert isinstance(tracer.contains(points), np.ndarray)
        assert isinstance(tracer.signed_distance(points), np.ndarray)


@pytest.mark.parametrize("dtypes", [("f4", "f4"), ("f4", "f8"), ("f8", "f4"), ("i8", "f8"), (">f8", "f8")], ids=str)
def test_dtypes_mix(tracer, dtypes):
    origins, directions = make_rays(((3,), (40, 3)))
    origins, directions = np.round(origins).astype(dtypes[0]), directions.astype(dtypes[1])
    hits = tracer.closest_hit(origins, directions)
    expected = tracer.closest_hit(*copied(origins.astype(float), directions.astype(float)))
    assert hits.t.tobytes() == expected.t.tobytes()


def test_strided_grids(tracer):
    both = np.random.default_rng(5).normal(size=(3, 20, 30, 6))
    for rays in (both[1, ::2, ::-1], both[1].transpose(1, 0, 2), np.flip(both[0]), np.asfortranarray(both[0])):
        hits = tracer.closest_hit(rays[..., :3], rays[..., 3:])
        expected = tracer.closest_hit(*copied(rays[..., :3], rays[..., 3:]))
        assert hits.t.tobytes() == expected.t.tobytes()
    grid = np.moveaxis(np.random.default_rng(6).normal(size=(3, 5, 6, 7)), 0, -1)
    assert tracer.contains(grid).tobytes() == tracer.contains(np.ascontiguousarray(grid).reshape(-1, 3)).tobytes()


@pytest.mark.parametrize("shapes", [((3,), (300, 300, 3)), ((300, 300, 3), (3,)), ((400, 1, 3), (250, 3))], ids=str)
@pytest.mark.parametrize("order", ["shuffled", "picture"])
def test_many_rays_in_and_out_of_order(tracer, shapes, order):
    """Batches that are large enough to be sorted, or to be searched for the rows of a picture."""
    origins, directions = make_rays(shapes, 7)
    if order == "picture":
        origins, directions = (
            np.sort(rays.reshape(-1, 3), axis=0).reshape(rays.shape) for rays in (origins, directions)
        )
    for dtype in (np.float32, np.float64):
        rays = origins.astype(dtype), directions.astype(dtype)
        expected = tracer.closest_prim(*copied(*rays))
        assert tracer.closest_prim(*rays).tobytes() == expected.tobytes()
        assert tracer.any_hit(*rays).tobytes() == (expected >= 0).tobytes()


class TestMemory:
    """The host allocates no array of the length of the rays but the results, and parts in the size of a chunk."""

    RAYS = 3_000_000

    @pytest.mark.parametrize("case", ["one origin", "broadcast by the caller", "one direction", "outer", "limits"])
    def test_broadcast_arrays_are_not_copied(self, tracer, monkeypatch, case):
        monkeypatch.setattr(pieces, "CHUNK_RAYS", 2**16)
        count, one = self.RAYS, np.array([0.0, 0.0, 9.0])
        many = np.tile([0.0, 0.0, 1.0], (count, 1))
        rays, limits = {
            "one origin": ((one, many), {}),
            "broadcast by the caller": ((np.broadcast_to(one, many.shape), many), {}),
            "one direction": ((many, one), {}),
            "outer": ((many[: count // 100, None], many[:100]), {}),
            "limits": ((one, many.reshape(3, -1, 3)), {"t_max": np.ones((3, 1))}),
        }[case]
        tracer.any_hit(one, many[: 2**17], **({"t_max": 1.0} if limits else {}))
        tracemalloc.start()
        try:
            blocked = tracer.any_hit(*rays, **limits)
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        assert blocked.size == count
        # One byte per ray is the result; 8 bytes per ray are a third of what a copy of the vectors would be.
        assert peak < blocked.nbytes + 8 * count

    def test_ordinary_rays_are_not_copied(self):
        rays = np.zeros((1000, 3)), np.ones((1000, 3))
        batch, _ = read_rays(*rays, 0.0, np.inf)
        part = batch.part(10, 500)
        assert np.shares_memory(part.origins, rays[0])
        assert np.shares_memory(part.directions, rays[1])


class TestParts:
    @pytest.mark.parametrize("own", [(4, 5, 6), (4, 1, 6), (1, 5, 1), (5, 6), (6,), (1,), (), (4, 5, 1)], ids=str)
    @pytest.mark.parametrize("item", [(), (3,)], ids=["numbers", "vectors"])
    def test_every_range_and_any_choice(self, own, item):
        shape = (4, 5, 6)
        values = np.arange(np.prod(own + item, dtype=int), dtype=float).reshape(own + item)
        broadcast = Broadcast.to_shape(values, len(item), shape)
        whole = np.broadcast_to(values, shape + item).reshape(-1, *item)
        for begin in range(0, 120, 7):
            for end in range(begin, 121):
                part = broadcast.part(begin, end, np.dtype(float))
                assert part.flags.c_contiguous
                assert not part.flags.writeable
                np.testing.assert_array_equal(np.broadcast_to(part, (end - begin, *item)), whole[begin:end])
        chosen = np.random.default_rng(8).integers(120, size=50)
        np.testing.assert_array_equal(
            np.broadcast_to(broadcast.take(chosen).part(3, 40, np.dtype(float)), (37, *item)), whole[chosen[3:40]]
        )

    def test_compiled_functions_see_one_kind_of_array(self):
        """Each further kind of array would be compiled for: a pause of seconds in a user's first call with it."""
        vectors = np.random.default_rng(9).normal(size=(60, 3))
        frozen, unaligned = vectors.copy(), np.frombuffer(b"." + vectors.tobytes(), np.uint8)[1:].view(float)
        frozen.flags.writeable = False
        kinds = set()
        for origins in (vectors, frozen, vectors[::2].repeat(2, axis=0), vectors[:, ::-1], unaligned.reshape(60, 3),
                        vectors[0], np.broadcast_to(vectors[0], (60, 3)), np.asfortranarray(vectors)):  # fmt: skip
            batch, _ = read_rays(origins, vectors.reshape(60, 3), 0.0, np.ones(60))
            for array in (*batch.part(2, 50), read_points(origins).part(2, 50, np.dtype(float))[:1]):
                flags = array.flags
                kinds.add((array.ndim, array.dtype.str, flags.c_contiguous, flags.aligned, flags.writeable))
        assert kinds == {(2, "<f8", True, True, False), (1, "<f8", True, True, False)}


class TestMessages:
    @pytest.mark.parametrize(
        ("shapes", "bad", "message"),
        [
            (((3,), (5, 3)), {"origins": ()}, "origins is not finite: [nan nan nan]"),
            (((3,), (5, 3)), {"directions": (2,)}, "directions[2] is not finite: [nan nan nan]"),
            (((5, 1, 3), (4, 3)), {"origins": (3, 0), "directions": (3,)}, "directions[3] is not finite: "),
            (((5, 1, 3), (4, 3)), {"origins": (3, 0)}, "origins[3, 0] is not finite: "),
            (((1, 3), (2, 5, 3)), {"origins": (0,)}, "origins[0] is not finite: "),
            (((2, 5, 3), (1, 3)), {"directions": (0,)}, "directions[0] is not finite: "),
        ],
    )
    def test_bad_rays_are_named_as_the_user_indexes_them(self, tracer, shapes, bad, message):
        rays = {"origins": np.ones(shapes[0]), "directions": np.ones(shapes[1])}
        for name, index in bad.items():
            rays[name][index] = np.nan
        with pytest.raises(QueryError, match="^" + re.escape(message)):
            tracer.any_hit(**rays)

    def test_bad_limits_are_named_as_the_user_indexes_them(self, tracer):
        with pytest.raises(QueryError, match=r"^t_max\[1, 0\] must be a number, not nan$"):
            tracer.any_hit(np.zeros(3), np.ones((2, 4, 3)), t_max=[[1], [np.nan]])

    def test_limits_add_no_rays(self, tracer):
        for limits in (np.ones(4), np.ones((4, 5)), np.ones((1, 5))):
            with pytest.raises(QueryError, match=r"^t_max must be a number or have a shape that broadcasts to that of"):
                tracer.any_hit(np.zeros((5, 3)), np.ones(3), t_max=limits)

    def test_bad_points(self, tracer):
        with pytest.raises(QueryError, match=r"^points is not finite: \[ 0\. nan  0\.\]$"):
            tracer.contains([0, np.nan, 0])
        points = np.zeros((2, 3, 4, 3))
        points[1, 2, 3] = np.inf
        with pytest.raises(QueryError, match=r"^points\[1, 2, 3\] is not finite: "):
            tracer.closest_point(points)


class TestOneRay:
    def test_its_hits_are_numbers_without_a_length(self, tracer):
        hits = tracer.closest_hit([0.725, 0.01, 5], [0, 0, -1])
        assert bool(hits.is_hit)
        assert hits.count == 1
        assert float(hits.t) > 0
        assert hits.locations.shape == (3,)
        with pytest.raises(TypeError, match=r"ask for hits\.is_hit$"):
            len(hits)
        with pytest.raises(TypeError, match=r"ask for hits\.is_hit$"):
            bool(hits)
        with pytest.raises(TypeError, match=r"ask for hits\.is_hit$"):
            list(hits)
        crossings = tracer.all_hits([0.725, 0.01, 5], [0, 0, -1])
        assert crossings.offsets.tolist() == [0, len(crossings)]


class TestSelection:
    def test_hits_are_selected_as_arrays_are(self, tracer):
        origins, directions = make_rays(((3,), (9, 8, 3)), 11)
        hits = tracer.closest_hit(origins, directions)
        assert 0 < hits.count < hits.prim_id.size
        for index in (hits.is_hit, 3, (2, 5), slice(1, 4), np.array([1, 1, 0]), (slice(None), 2), ...):
            chosen = hits[index]
            for field in FIELDS:
                assert isinstance(getattr(chosen, field), np.ndarray)
                np.testing.assert_array_equal(getattr(chosen, field), getattr(hits, field)[index])
            np.testing.assert_array_equal(chosen.locations, hits.locations[index])
        assert hits[hits.is_hit].is_hit.all()
        assert [row.shape for row in hits] == [(8,)] * 9
        with pytest.raises(IndexError):
            hits[9]
