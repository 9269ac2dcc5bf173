"""Rays and points as users give them: any shapes, numbers and order in memory; what cannot be a ray is named."""

import re
import tracemalloc

import numpy as np
import pytest

from clbvh import ConfigError, QueryError, Renderer, SceneError
from clbvh.support import memory
from clbvh.trace.rays import pieces
from clbvh.trace.rays.batch import Broadcast, read_points, read_rays

FIELDS = ("t", "u", "v", "prim_id", "is_front")
RAY_QUERIES = ("closest_hit", "closest_prim", "any_hit", "count_hits", "all_hits")
POINT_QUERIES = ("closest_point", "contains", "signed_distance")
DOWN = [0.725, 0.01, 5], [0, 0, -1]

# Shapes of origins and directions, and of the rays.
SHAPES = (
    ((3,), (50, 3), (50,)), ((3,), (3, 3), (3,)), ((1, 3), (50, 3), (50,)), ((50, 3), (3,), (50,)),
    ((3,), (9, 8, 3), (9, 8)), ((3,), (3,), ()), ((1, 3), (3,), (1,)), ((6, 11, 3), (11, 3), (6, 11)),
    ((7, 1, 3), (13, 3), (7, 13)), ((7, 1, 3), (1, 13, 3), (7, 13)), ((4, 1, 5, 3), (6, 1, 3), (4, 6, 5)),
    ((0, 3), (3,), (0,)), ((1, 0, 3), (4, 1, 3), (4, 0)),
)  # fmt: skip


def make_rays(shapes, seed=0):
    """Rays from around the mesh to points in it."""
    generator = np.random.default_rng(seed)
    origins = generator.normal(size=shapes[0]) * 3
    return origins, generator.normal(size=shapes[1]) * 0.3 - origins.reshape(-1, 3)[:1].sum(axis=0)


def copied(*arrays):
    """The same rays as flat arrays without broadcasting."""
    return [np.ascontiguousarray(array).reshape(-1, 3) for array in np.broadcast_arrays(*arrays)]


def ask(tracer, query, start):
    return getattr(tracer, query)(start, [0, 0, -1]) if query in RAY_QUERIES else getattr(tracer, query)(start)


@pytest.mark.parametrize("chunk", [7, 2**20])
@pytest.mark.parametrize("shapes", SHAPES, ids=str)
def test_broadcast_rays_are_answered_as_copied_ones(tracer, monkeypatch, shapes, chunk):
    *shapes, shape = shapes
    monkeypatch.setattr(pieces, "CHUNK_RAYS", chunk)
    rays = make_rays(shapes)
    flat, generator = copied(*rays), np.random.default_rng(1)
    hits, expected = tracer.closest_hit(*rays), tracer.closest_hit(*flat)
    for field in FIELDS:
        obtained = getattr(hits, field)
        assert isinstance(obtained, np.ndarray)
        assert obtained.shape == hits.shape == shape
        assert obtained.tobytes() == getattr(expected, field).tobytes(), field
    assert hits.locations.shape == hits.normals.shape == hits.offset_origins().shape == (*shape, 3)
    for query in ("any_hit", "count_hits", "closest_prim"):
        obtained = getattr(tracer, query)(*rays)
        assert isinstance(obtained, np.ndarray)
        assert obtained.shape == shape
        assert obtained.tobytes() == getattr(tracer, query)(*flat).tobytes(), query
    crossings, expected = tracer.all_hits(*rays), tracer.all_hits(*flat)
    for field in (*FIELDS, "offsets"):
        assert getattr(crossings, field).tobytes() == getattr(expected, field).tobytes(), field
    for of_limits in {shape, (1, *shape[1:]) if shape else (), shape[-1:], ()}:
        limits = {"t_min": generator.random(of_limits), "t_max": 1 + generator.random(of_limits)}
        flat_limits = {name: np.broadcast_to(limit, shape).reshape(-1) for name, limit in limits.items()}
        hits = tracer.closest_hit(*rays, **limits)
        assert hits.t.shape == shape
        assert hits.t.tobytes() == tracer.closest_hit(*flat, **flat_limits).t.tobytes(), of_limits
    closest, expected = tracer.closest_point(rays[0]), tracer.closest_point(rays[0].reshape(-1, 3))
    for obtained, of_flat in zip(closest, expected, strict=True):
        assert obtained.tobytes() == of_flat.tobytes()
    for answer in (closest.distance, closest.prim_id, tracer.contains(rays[0]), tracer.signed_distance(rays[0])):
        assert isinstance(answer, np.ndarray)
        assert answer.shape == rays[0].shape[:-1]


def test_any_order_in_memory_and_kind_of_number(tracer, rays):
    origins, directions = (np.round(array[:500] * 8) for array in rays)
    directions[(directions == 0).all(axis=1)] = 1
    expected = tracer.closest_hit(origins, directions)
    wide = np.concatenate((origins, directions), axis=1)[::-1]
    unaligned = np.frombuffer(b"." + directions.tobytes(), np.uint8)[1:].view(float).reshape(-1, 3)
    given = [
        (origins.tolist(), directions.tolist()),
        (wide[::-1, :3], wide[::-1, 3:]),
        (np.asfortranarray(origins), unaligned),
        *((origins.astype(one), directions.astype(other)) for one, other in (
            ("f4", "f4"), ("f4", "f8"), (">f8", ">f4"), (np.longdouble, "f2"), ("i1", "i8"))),
    ]  # fmt: skip
    for case in given:
        hits = tracer.closest_hit(*case)
        for field in FIELDS:
            assert getattr(hits, field).tobytes() == getattr(expected, field).tobytes(), case
    assert len(tracer.closest_hit([], [])) == 0
    assert tracer.any_hit(np.empty((0, 3)), []).shape == (0,)
    grid = np.moveaxis(np.random.default_rng(6).normal(size=(3, 5, 6, 7)), 0, -1)
    assert tracer.contains(grid).tobytes() == tracer.contains(np.ascontiguousarray(grid).reshape(-1, 3)).tobytes()


@pytest.mark.parametrize("shapes", [((3,), (300, 300, 3)), ((300, 300, 3), (3,)), ((400, 1, 3), (250, 3))], ids=str)
@pytest.mark.parametrize("order", ["shuffled", "picture"])
def test_many_rays_in_and_out_of_order(tracer, shapes, order):
    """Batches that are large enough to be sorted, or to be searched for the rows of a picture."""
    rays = make_rays(shapes, 7)
    if order == "picture":
        rays = [np.sort(array.reshape(-1, 3), axis=0).reshape(array.shape) for array in rays]
    for dtype in (np.float32, np.float64):
        rays = [array.astype(dtype) for array in rays]
        expected = tracer.closest_prim(*copied(*rays))
        assert tracer.closest_prim(*rays).tobytes() == expected.tobytes()
        assert tracer.any_hit(*rays).tobytes() == (expected >= 0).tobytes()


def test_input_is_not_modified(tracer, rays):
    given = [array.copy() for array in (*rays, np.zeros(3072), np.full(3072, 9.0))]
    given[1][5] *= 1e30
    copies = [array.copy() for array in given]
    for array in given:
        array.flags.writeable = False
    tracer.closest_hit(given[0], given[1], t_min=given[2], t_max=given[3])
    for array, copy in zip(given, copies, strict=True):
        np.testing.assert_array_equal(array, copy)


@pytest.mark.parametrize("case", ["ordinary", "one origin", "broadcast", "one direction", "outer", "limits"])
def test_the_host_copies_no_array_of_the_length_of_the_rays(tracer, monkeypatch, case):
    monkeypatch.setattr(pieces, "CHUNK_RAYS", 2**15)
    count, one = 1_500_000, np.array([0.0, 0.0, 9.0])
    many = np.tile([0.0, 0.0, 1.0], (count, 1))
    rays, limits = {
        "ordinary": ((many, many), {}),
        "one origin": ((one, many), {}),
        "broadcast": ((np.broadcast_to(one, many.shape), many), {}),
        "one direction": ((many, one), {}),
        "outer": ((many[: count // 100, None], many[:100]), {}),
        "limits": ((one, many.reshape(3, -1, 3)), {"t_max": np.ones((3, 1))}),
    }[case]
    tracer.any_hit(one, many[: 2**16], **({"t_max": 1.0} if limits else {}))
    tracemalloc.start()
    try:
        blocked = tracer.any_hit(*rays, **limits)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert blocked.size == count
    # One byte per ray is the result; 8 bytes per ray are a third of what a copy of the vectors would be.
    assert peak < blocked.nbytes + 8 * count


@pytest.mark.parametrize("own", [(4, 5, 6), (4, 1, 6), (1, 5, 1), (5, 6), (6,), (1,), (), (4, 5, 1)], ids=str)
@pytest.mark.parametrize("item", [(), (3,)], ids=["numbers", "vectors"])
def test_every_range_and_any_choice_of_broadcast_values(own, item):
    shape = (4, 5, 6)
    values = np.arange(np.prod(own + item, dtype=int), dtype=float).reshape(own + item)
    broadcast = Broadcast.to_shape(values, len(item), shape)
    whole = np.broadcast_to(values, shape + item).reshape(-1, *item)
    for begin in range(0, 120, 7):
        for end in range(begin, 121):
            part = broadcast.part(begin, end, np.dtype(float))
            np.testing.assert_array_equal(np.broadcast_to(part, (end - begin, *item)), whole[begin:end])
    chosen = np.random.default_rng(8).integers(120, size=50)
    part = broadcast.take(chosen).part(3, 40, np.dtype(float))
    np.testing.assert_array_equal(np.broadcast_to(part, (37, *item)), whole[chosen[3:40]])


def test_compiled_functions_see_one_kind_of_array():
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


def spoilt(shape, *places, value=np.nan):
    """Ones, but for another value at some places."""
    array = np.ones(shape)
    for place in places:
        array[place] = value
    return array


def test_what_cannot_be_a_ray_is_named_as_the_user_indexes_it(tracer):
    one, nine = np.ones(3), np.ones((9, 3))
    masked = np.ma.masked_array(nine, mask=np.eye(9, 3))
    shape_of_points = "must have shape (3,), (n, 3) or (..., 3), not "
    against = "origins and directions must have shapes that broadcast against each other, not "
    of_limits = "must be a number or have a shape that broadcasts to that of the rays, (9,), not "
    rows = [
        (np.zeros((4, 2)), np.ones((4, 2)), {}, f"origins {shape_of_points}(4, 2)"),
        (np.zeros((0, 2)), np.ones((0, 3)), {}, f"origins {shape_of_points}(0, 2)"),
        (one, 1.0, {}, f"directions {shape_of_points}()"),
        (np.zeros((4, 3)), np.ones((5, 3)), {}, f"{against}(4, 3) and (5, 3)"),
        (np.zeros((2, 4, 3)), np.ones((2, 3)), {}, f"{against}(2, 4, 3) and (2, 3)"),
        (np.ones((1,) * 33 + (3,)), np.ones((5, 3)), {}, against),
        (np.broadcast_to(1.0, (0, 2**30, 1, 3)), np.broadcast_to(1.0, (2**34, 3)), {}, against),
        *(
            (spoilt((9, 3), (7, axis), (4, axis), value=value).astype(dtype), one, {}, "origins[4] is not finite: ")
            for axis, value, dtype in ((0, np.nan, "f8"), (1, np.inf, "f4"), (2, -np.inf, "f8"), (2, np.nan, "f4"))
        ),
        (spoilt(3, 0, 1, 2), np.ones((5, 3)), {}, "origins is not finite: [nan nan nan]"),
        (one, spoilt((5, 3), 2), {}, "directions[2] is not finite: [nan nan nan]"),
        (spoilt((5, 1, 3), (3, 0)), spoilt((4, 3), 3), {}, "directions[3] is not finite: "),
        (spoilt((5, 1, 3), (3, 0)), np.ones((4, 3)), {}, "origins[3, 0] is not finite: "),
        (spoilt((1, 3), 0), np.ones((2, 5, 3)), {}, "origins[0] is not finite: "),
        (nine, spoilt((9, 3), 3, 6, value=-0.0), {}, "directions[3] has length zero"),
        (one, spoilt((2, 5, 3), (1, 3), value=0), {}, "directions[1, 3] has length zero"),
        (nine, nine, {"t_min": np.zeros(8)}, f"t_min {of_limits}(8,)"),
        (nine, one, {"t_max": np.ones((9, 1))}, f"t_max {of_limits}(9, 1)"),
        (nine, one, {"t_min": np.nan}, "t_min must be a number from 0, not nan"),
        (nine, one, {"t_min": -1e-300}, "t_min must be a number from 0, not -1e-300"),
        (nine, one, {"t_min": [0, 1, 0, -2, 1, -3, 0, 0, 0]}, "t_min[3] must be a number from 0, not -2.0"),
        (nine, one, {"t_max": np.nan}, "t_max must be a number, not nan"),
        (one, np.ones((2, 4, 3)), {"t_max": [[1], [np.nan]]}, "t_max[1, 0] must be a number, not nan"),
        *(
            (bad, one, {}, "origins must be numbers")
            for bad in (["a", "b", "c"], ["1", "2", "3"], [[1, 2], [1, 2, 3]], [1j, 0, 0], [True, False, True],
                        np.zeros((1, 3), "m8[s]"), [object(), 1, 2], [10**400, 0, 0])
        ),
        (one, masked, {}, "directions must be numbers"),
        (one, one, {"t_max": 10**400}, "t_max must be numbers"),
        (one, one, {"t_min": np.ma.masked}, "t_min must be numbers"),
    ]  # fmt: skip
    for origins, directions, limits, message in rows:
        for cast in (tracer.closest_hit, tracer.any_hit, tracer.all_hits, tracer.count_hits):
            with pytest.raises(QueryError, match="^" + re.escape(message)):
                cast(origins, directions, **limits)
    for points, message in (
        ([0, np.nan, 0], "points is not finite: [ 0. nan  0.]"),
        (spoilt((2, 3, 4, 3), (1, 2, 3)), "points[1, 2, 3] is not finite: "),
        ([["a", "b", "c"]], "points must be numbers"),
        (masked, "points must be numbers"),
    ):
        with pytest.raises(QueryError, match="^" + re.escape(message)):
            tracer.closest_point(points)
    for bad in (0, -1, 1.5, True, "a", 2**31):
        for query in (tracer.all_hits, tracer.count_hits):
            with pytest.raises(ConfigError, match="max_hits must be None or a number from 1"):
                query(*DOWN, max_hits=bad)
    many_axes = np.ones((1,) * 63 + (3,))
    assert tracer.closest_hit(many_axes, many_axes).shape == (1,) * 63
    assert tracer.any_hit(np.ma.masked_array(nine), one).shape == (9,)


def test_start_points_need_directions_that_lead_somewhere(tracer):
    hits = tracer.closest_hit([[9, 9, 5], DOWN[0], DOWN[0]], DOWN[1])
    for wrong in ([0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0], [0, -np.inf, 0]):
        with pytest.raises(QueryError, match=r"towards must be finite directions of length above 0.*of the hit \(1,\)"):
            hits.offset_origins(towards=wrong)
        with pytest.raises(QueryError, match=r"of the hit \(0, 2\)"):
            hits.offset_origins(towards=[[[1, 0, 0], [1, 0, 0], wrong]])
        # Whatever is computed from the normal of a miss is NaN.
        directions = np.array([wrong, [1, 0, 0], [5e-324, 0, 0]], np.float64)
        assert np.isfinite(hits.offset_origins(towards=directions)).all(axis=1).tolist() == [False, True, True]
    with pytest.raises(QueryError, match="towards must have a shape that broadcasts"):
        hits.offset_origins(towards=np.ones((1,) * 33 + (3,)))


@pytest.mark.parametrize("query", RAY_QUERIES + POINT_QUERIES)
def test_more_results_than_fit_are_refused_before_the_work(tracer, query, monkeypatch):
    many = np.broadcast_to(np.array([0.0, 0.0, 5.0]), (2**40, 3))
    with pytest.raises(QueryError, match=r"results of 1,099,511,627,776 \w+ need about .* are free: ask for fewer"):
        ask(tracer, query, many)
    with pytest.raises(QueryError, match="results of 1,099,511,627,776 rays"):
        tracer.closest_hit(*DOWN).offset_origins(towards=many)
    monkeypatch.setattr(memory, "_LEAST_CHECKED", 0)
    monkeypatch.setattr(memory, "free_memory_bytes", lambda: 999)
    with pytest.raises(QueryError, match="results of 1,000"):
        ask(tracer, query, np.zeros((1000, 3)))
    monkeypatch.setattr(memory, "free_memory_bytes", lambda: 40_000)
    ask(tracer, query, np.zeros((1000, 3)))


def test_pictures_that_do_not_fit_are_refused(mesh, monkeypatch):
    monkeypatch.setattr(memory, "free_memory_bytes", lambda: 2**30)
    with Renderer(mesh) as renderer:
        with pytest.raises(SceneError, match="a picture of 65535 x 65535 needs about"):
            renderer.render(width=65535, height=65535)
        with pytest.raises(SceneError, match="the rays of 65,535 rows need about"):
            renderer.camera.rays(65535, 65535)
        assert renderer.render(width=4, height=3).rgb.shape == (3, 4, 3)
