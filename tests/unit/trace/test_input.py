"""Rays and points as users give them: any shapes, numbers and order in memory; what cannot be a ray is named."""

import re
import tracemalloc

import numpy as np
import pandas
import pytest

from clbvh import ConfigError, QueryError, Renderer, SceneError
from clbvh.support import memory
from clbvh.trace.rays import pieces

FIELDS = ("t", "u", "v", "prim_id", "is_front")
RAY_QUERIES = ("closest_hit", "closest_prim", "any_hit", "count_hits", "all_hits")
POINT_QUERIES = ("closest_point", "contains", "signed_distance")
DOWN = [0.725, 0.01, 5], [0, 0, -1]

# Shapes of origins and directions, and of the rays.
SHAPES = (
    ((3,), (50, 3), (50,)), ((1, 3), (50, 3), (50,)), ((50, 3), (3,), (50,)), ((3,), (3,), ()),
    ((6, 11, 3), (11, 3), (6, 11)), ((7, 1, 3), (13, 3), (7, 13)), ((4, 1, 5, 3), (6, 1, 3), (4, 6, 5)),
    ((1, 0, 3), (4, 1, 3), (4, 0)),
)  # fmt: skip


def ask(tracer, query, origins, directions):
    return getattr(tracer, query)(origins, *([directions] if query in RAY_QUERIES else []))


def arrays_of(answer):
    names = (*FIELDS, "offsets", "distance", "point")
    return [answer] if isinstance(answer, np.ndarray) else [getattr(answer, n) for n in names if hasattr(answer, n)]


def assert_same(obtained, expected, case=None):
    for one, other in zip(arrays_of(obtained), arrays_of(expected), strict=True):
        assert isinstance(one, np.ndarray)
        assert one.tobytes() == other.tobytes(), case


@pytest.mark.parametrize(("chunk", "least_rays"), [(7, 1 << 16), (20, 1)])
@pytest.mark.parametrize("shapes", SHAPES, ids=str)
def test_broadcast_rays_are_answered_as_copied_ones(tracer, monkeypatch, shapes, chunk, least_rays):
    """In pieces, in and out of order."""
    monkeypatch.setattr(pieces, "CHUNK_RAYS", chunk)
    monkeypatch.setattr(pieces, "LEAST_RAYS", least_rays)
    of_origins, of_directions, shape = shapes
    generator = np.random.default_rng(0)
    origins = generator.normal(size=of_origins) * 3
    rays = origins, generator.normal(size=of_directions) * 0.3 - origins.reshape(-1, 3)[:1].sum(axis=0)
    flat = [np.ascontiguousarray(array).reshape(-1, 3) for array in np.broadcast_arrays(*rays)]
    for query in RAY_QUERIES + POINT_QUERIES:
        answer = ask(tracer, query, *rays)
        assert_same(answer, ask(tracer, query, *(flat if query in RAY_QUERIES else (origins.reshape(-1, 3), None))))
        if query != "all_hits":
            assert arrays_of(answer)[0].shape == (shape if query in RAY_QUERIES else origins.shape[:-1]), query
    hits = tracer.closest_hit(*rays)
    assert hits.locations.shape == hits.normals.shape == hits.offset_origins().shape == (*shape, 3)
    for of_limits in {shape, shape[-1:], ()}:
        limits = {"t_min": generator.random(of_limits), "t_max": 1 + generator.random(of_limits)}
        flat_limits = {name: np.broadcast_to(limit, shape).reshape(-1) for name, limit in limits.items()}
        assert_same(tracer.closest_hit(*rays, **limits), tracer.closest_hit(*flat, **flat_limits), of_limits)


def test_any_order_in_memory_and_kind_of_number(tracer, rays):
    origins, directions = (np.round(array[:500] * 8) for array in rays)
    directions[(directions == 0).all(axis=1)] = 1
    expected = tracer.closest_hit(origins, directions)
    wide = np.concatenate((origins, directions), axis=1)[::-1]
    unaligned = np.frombuffer(b"." + directions.tobytes(), np.uint8)[1:].view(float).reshape(-1, 3)
    kinds = ("f4", "f4"), ("f4", "f8"), (">f8", ">f4"), (np.longdouble, "f2"), ("i1", "i8")
    given = [(origins.astype(one), directions.astype(other)) for one, other in kinds]
    given += [(origins.tolist(), directions.tolist()), (wide[::-1, :3], wide[::-1, 3:])]
    for case in (*given, (np.asfortranarray(origins), unaligned)):
        copies = [np.array(array) for array in case]
        assert_same(tracer.closest_hit(*case), expected, case)
        np.testing.assert_array_equal(case, copies)
    assert len(tracer.closest_hit([], [])) == 0
    grid = np.moveaxis(np.random.default_rng(6).normal(size=(3, 5, 6, 7)), 0, -1)
    assert_same(tracer.contains(grid), tracer.contains(np.ascontiguousarray(grid)))


def test_columns_of_tables_are_found_by_name(tracer, rays):
    (origins, directions), limits = (array[:200] for array in rays), np.arange(200) / 50
    table = pandas.DataFrame({"reach": limits, **dict(zip("zyx", origins.T[::-1], strict=True))}).astype("Float64")
    unnamed = pandas.DataFrame(directions, index=range(7, 207), columns=["dx", "dy", "dz"])
    expected = tracer.closest_hit(origins, directions, t_max=limits)
    assert_same(tracer.closest_hit(table, unnamed, t_max=table["reach"]), expected)
    assert_same(tracer.contains(table), tracer.contains(origins))
    table.loc[3, "y"] = pandas.NA
    with pytest.raises(QueryError, match=r"^points must be numbers: "):
        tracer.contains(table)


@pytest.mark.parametrize("case", ["broadcast", "outer", "limits"])
def test_the_host_copies_no_array_of_the_length_of_the_rays(tracer, monkeypatch, case):
    monkeypatch.setattr(pieces, "CHUNK_RAYS", 2**15)
    count, one = 1_500_000, np.array([0.0, 0.0, 9.0])
    many = np.tile([0.0, 0.0, 1.0], (count, 1))
    rays, limits = {
        "broadcast": ((np.broadcast_to(one, many.shape), many), {}),
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
    # One byte per ray is the result; 8 bytes per ray are a third of what a copy of the vectors would be.
    assert peak < blocked.nbytes + 8 * count


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
    strange = (["a", "b", "c"], [[1, 2], [1, 2, 3]], [1j, 0, 0], [True, False, True], [object(), 1, 2], [10**400, 0, 0])
    for origins, directions, limits, message in (
        (np.zeros((0, 2)), np.ones((0, 3)), {}, f"origins {shape_of_points}(0, 2)"),
        (np.zeros((2, 4, 3)), np.ones((2, 3)), {}, f"{against}(2, 4, 3) and (2, 3)"),
        (np.ones((1,) * 33 + (3,)), np.ones((5, 3)), {}, against),
        (spoilt((9, 3), (7, 0), (4, 0)).astype("f4"), one, {}, "origins[4] is not finite: "),
        (spoilt((5, 1, 3), (3, 0)), spoilt((4, 3), 3), {}, "directions[3] is not finite: "),
        (nine, spoilt((9, 3), 3, 6, value=-0.0), {}, "directions[3] has length zero"),
        (nine, one, {"t_max": np.ones((9, 1))}, f"t_max {of_limits}(9, 1)"),
        (nine, one, {"t_min": [0, 1, 0, -2, 1, -3, 0, 0, 0]}, "t_min[3] must be a number from 0, not -2.0"),
        (one, np.ones((2, 4, 3)), {"t_max": [[1], [np.nan]]}, "t_max[1, 0] must be a number, not nan"),
        *((bad, one, {}, "origins must be numbers") for bad in strange),
        (one, masked, {}, "directions must be numbers"),
    ):
        for query in RAY_QUERIES:
            with pytest.raises(QueryError, match="^" + re.escape(message)):
                getattr(tracer, query)(origins, directions, **limits)
    for points, message in (
        (np.zeros((4, 2)), f"points {shape_of_points}(4, 2)"),
        (spoilt((2, 3, 4, 3), (1, 2, 3)), "points[1, 2, 3] is not finite: "),
        (masked, "points must be numbers"),
    ):
        for query in POINT_QUERIES:
            with pytest.raises(QueryError, match="^" + re.escape(message)):
                getattr(tracer, query)(points)
    hits = tracer.closest_hit([[9, 9, 5], DOWN[0], DOWN[0]], DOWN[1])
    for towards, message in (
        ([0, 0, 0], r"towards must be finite directions of length above 0.*of the hit \(1,\)"),
        ([0, -np.inf, 0], r"towards must be finite directions of length above 0.*of the hit \(1,\)"),
    ):
        with pytest.raises(QueryError, match=message):
            hits.offset_origins(towards=towards)
    for bad in (0, 1.5, 2**31):
        for query in (tracer.all_hits, tracer.count_hits):
            with pytest.raises(ConfigError, match="max_hits must be None or a number from 1"):
                query(*DOWN, max_hits=bad)


@pytest.mark.parametrize("query", RAY_QUERIES + POINT_QUERIES)
def test_more_results_than_fit_are_refused_before_the_work(tracer, mesh, query, monkeypatch):
    many = np.broadcast_to(np.array([0.0, 0.0, 5.0]), (2**40, 3))
    with pytest.raises(QueryError, match=r"results of 1,099,511,627,776 \w+ need about .* are free: ask for fewer"):
        ask(tracer, query, many, DOWN[1])
    with pytest.raises(QueryError, match="results of 1,099,511,627,776 rays"):
        tracer.closest_hit(*DOWN).offset_origins(towards=many)
    monkeypatch.setattr(memory, "_LEAST_CHECKED", 0)
    monkeypatch.setattr(memory, "free_memory_bytes", lambda: 999)
    with pytest.raises(QueryError, match="results of 1,000"):
        ask(tracer, query, np.zeros((1000, 3)), DOWN[1])
    monkeypatch.setattr(memory, "free_memory_bytes", lambda: 60_000)
    ask(tracer, query, np.zeros((1000, 3)), DOWN[1])


def test_pictures_that_do_not_fit_are_refused(mesh, monkeypatch):
    monkeypatch.setattr(memory, "free_memory_bytes", lambda: 2**30)
    with Renderer(mesh) as renderer:
        with pytest.raises(SceneError, match="a picture of 65535 x 65535 needs about"):
            renderer.render(width=65535, height=65535)
        with pytest.raises(SceneError, match="the rays of 65,535 rows need about"):
            renderer.camera.rays(65535, 65535)
