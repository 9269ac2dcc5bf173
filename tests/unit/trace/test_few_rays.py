"""Queries with few rays: their errors, their times, and what they see of updates."""

import numpy as np
import pytest

from clbvh import Mesh, QueryError, Tracer, make_shape
from clbvh.structs import NO_PRIM
from clbvh.trace.hits import closest
from clbvh.trace.put_rays import cut_batch, put_rays
from clbvh.trace.rays import pieces
from clbvh.trace.rays.batch import read_rays

from ...concurrency.threads import run_in_threads

LAYOUTS = ["bvh4", "bvh8"]
DOWN = [[0.25, 0.25, 2.0]], [[0.0, 0.0, -1.0]]
TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_t_of_the_device_is_the_last_one_that_hits(open_tracer, mesh, rays, layout):
    """To the last bit: a t_max of the t found is within the limits, and the number below it is not."""
    # Directions with a longest component of 1 are not scaled on their way, so neither is t.
    directions = rays[1] / np.abs(rays[1]).max(axis=1, keepdims=True)
    directions = directions.astype(np.float32).astype(np.float64)
    directions[np.arange(len(directions)), np.abs(directions).argmax(axis=1)] = 1.0
    tracer, batch = open_tracer(mesh, layout=layout), read_rays(rays[0], directions, 0.0, np.inf)
    with tracer._caster.open_call() as call:
        (piece,) = cut_batch(call, batch)
        with call.cast(closest.CLOSEST_HIT, put_rays(call, batch, piece)) as found:
            t, is_hit = found["t"].copy(), found["prim_id"] != NO_PRIM
    hits = rays[0][is_hit], directions[is_hit]
    assert is_hit.sum() > 500
    assert tracer.any_hit(*hits, t_max=t[is_hit]).all()
    assert not tracer.any_hit(*hits, t_max=np.nextafter(t[is_hit], np.float32(-1))).any()


def test_bad_rays_are_named_whatever_thread_meets_them(session):
    many = np.arange(4000)[:, None]  # for several threads
    with Tracer((np.array(TRIANGLE[0]) * 1e-9, TRIANGLE[1]), device=session.info, layout="bvh8") as tracer:
        for origins, directions, message in (
            ([[0, 0, 0], [0, np.nan, 0]], [0, 0, 1], r"^origins\[1\] is not finite: \[ 0. nan  0.\]$"),
            ([0, 0, 0], [[0, 0, 1], [1, 0, 0], [0, 0, 0]], r"^directions\[2\] has length zero$"),
            ([1e308, 0, 0], [0, 0, 1], "^origins is too far"),
            (np.where(many == 3900, np.inf, (0, 0, 0)), [0, 0, 1], r"^origins\[3900\] is"),
            (np.where(many % 2000 == 1900, np.inf, (0, 0, 0)), [0, 0, 1], r"^origins\[1900\] is"),
        ):
            for query in (tracer.closest_hit, tracer.any_hit):
                with pytest.raises(QueryError, match=message):
                    query(origins, directions)


def test_a_query_counts_its_time_and_may_close_its_tracer(session):
    tracer, told = Tracer(TRIANGLE, device=session.info, layout="bvh8"), []
    assert tracer.any_hit(*DOWN).all()
    before = tracer.timings_ms["kernel"]
    tracer.closest_hit(*DOWN)
    assert tracer.timings_ms["kernel"] > before > 0
    # Progress is told once, and may close.
    tracer.any_hit(*DOWN, progress=lambda *counts: (told.append(counts), tracer.close()))
    assert told == [(1, 1)]
    with pytest.raises(QueryError, match="the tracer is closed"):
        tracer.any_hit(*DOWN)


def test_updates_are_followed(session):
    """In both copies of the tree, each written while the host has seen it before."""
    # A triangle that stays: a mesh that moves as a whole keeps its tree.
    vertices = np.array([*TRIANGLE[0], [5, 5, 0], [6, 5, 0], [5, 6, 0]], np.float64)
    moves = np.array([[1, 0, 0]] * 3 + [[0, 0, 0]] * 3)
    with Tracer(Mesh.from_arrays(vertices, [[0, 1, 2], [3, 4, 5]]), device=session.info, layout="bvh8") as tracer:
        for way in (0.0, 3.0, 0.0, 3.0, 3.0, 0.0):
            tracer.update(vertices + way * moves)
            assert tracer.any_hit(*DOWN).tolist() == [way == 0.0]
            assert tracer.closest_hit([[5.25, 5.25, 2]], DOWN[1]).t.tolist() == [2.0]


def test_threads_cast_while_the_mesh_moves_and_until_the_tracer_is_closed(mesh, rays):
    """What a call refers to stays until its kernel returns: arrays that nobody else has, buffers given back."""
    few = rays[0][:7], rays[1][:7]
    with Tracer(mesh, device="host") as tracer:
        expected = [tracer.closest_hit(*few).t.tobytes()]
        tracer.update(2 * mesh.vertices)
        expected.append(tracer.closest_hit(*few).t.tobytes())

        def cast():
            found = set()
            try:
                while True:
                    found.add(tracer.closest_hit(*few).t.tobytes())
            except QueryError as error:
                assert "the tracer is closed" in str(error)  # noqa: PT017 (calls before it succeed)
            return found

        def move():
            for step in range(60):
                tracer.update((1 + step % 2) * mesh.vertices)
            tracer.close()

        found = run_in_threads(cast, cast, cast, move)[:3]
    assert set().union(*found) == set(expected)


@pytest.mark.parametrize("dtype", ["f4", "f8", ">f8", "i4"])
def test_arrays_of_any_layout_are_read_where_they_are(mesh, rays, dtype):
    origins, directions = (np.round(part[:480] * 8).astype(dtype) for part in rays)
    directions[(directions == 0).all(axis=1)] = 1
    both = np.concatenate((origins, directions), axis=1)
    unaligned = [
        np.frombuffer(b"x" + part.tobytes(), part.dtype, offset=1).reshape(-1, 3) for part in (origins, directions)
    ]
    grids = origins.reshape(20, 24, 3), directions.reshape(20, 24, 3)
    t_max, hit_count = np.random.default_rng(3).uniform(0, 2, 480), 0
    with Tracer((8 * mesh.vertices, mesh.faces), device="host") as tracer:
        for given, plain in [
            ((both[::-1, :3], both[::-1, 3:]), (origins[::-1], directions[::-1])),
            ([np.asfortranarray(part) for part in (origins, directions)], (origins, directions)),
            (unaligned, (origins, directions)),
            ([part[3:17, ::-5] for part in grids], [part[3:17, ::-5] for part in grids]),
            ([part.transpose(1, 0, 2) for part in grids], [part.transpose(1, 0, 2) for part in grids]),
            ((origins[:20, None], directions[:24]), [np.repeat(origins[:20, None], 24, axis=1), directions[:24]]),
            ((origins[0], directions[:, None]), (origins[0], directions[:, None])),
        ]:
            shape = np.broadcast_shapes(*(part.shape[:-1] for part in given))
            rows = [np.array(np.broadcast_to(part, (*shape, 3)).reshape(-1, 3), np.float64) for part in plain]
            limit = np.broadcast_to(t_max[: shape[-1]], shape)
            found, expected = (
                tracer.closest_hit(*given, t_max=limit),
                tracer.closest_hit(*rows, t_max=limit.reshape(-1)),
            )
            assert found.shape == shape
            assert (found.t.tobytes(), found.prim_id.tobytes()) == (expected.t.tobytes(), expected.prim_id.tobytes())
            hit_count += expected.count
    assert hit_count > 300


@pytest.mark.parametrize("query", ["closest_hit", "any_hit", "all_hits", "closest_point"])
def test_a_query_on_the_host_ends_with_its_results_when_its_tracer_is_closed(mesh, rays, monkeypatch, query):
    monkeypatch.setattr(pieces, "LEAST_RAYS", 1)
    monkeypatch.setattr(pieces, "CHUNK_RAYS", 1000)
    given = rays[:1] if query == "closest_point" else rays
    with Tracer(mesh, device="host") as tracer:
        expected, told = getattr(tracer, query)(*given), []
        found = getattr(tracer, query)(*given, progress=lambda *counts: (told.append(counts), tracer.close()))
        one, other = (getattr(answer, "prim_id", answer) for answer in (found, expected))
        np.testing.assert_array_equal(one, other)
        assert query == "closest_point" or len(told) >= 4
        for count in (0, 1, len(rays[0])):
            with pytest.raises(QueryError, match="the tracer is closed"):
                getattr(tracer, query)(*(part[:count] for part in given))


def test_a_bad_ray_among_those_that_are_sampled_has_its_own_number(session):
    generator = np.random.default_rng(5)
    origins = generator.normal(size=(300, 400, 3))
    directions = -origins + generator.normal(size=(300, 400, 3)) / 8
    directions[0, 0] = directions[299, 7] = 0
    with Tracer(make_shape("icosphere", triangles=320), device=session.info, layout="bvh8") as tracer:
        for bad, message in (((0, 0), r"^directions\[0, 0\] has"), ((299, 7), r"^directions\[299, 7\] has")):
            with pytest.raises(QueryError, match=message):
                tracer.closest_hit(origins, directions)
            directions[bad] = 1


def test_what_loops_are_told_of_rays_stays_while_rays_of_many_shapes_come(mesh, rays):
    batch = read_rays(*rays, 0.0, np.inf)
    axes_at = batch.addresses[6]
    for count in range(300):  # more than are remembered
        assert read_rays(np.zeros((count, 1, 3)), [0, 0, 1], 0.0, np.inf).axes.shape[1] == 6
    assert axes_at == batch.axes.ctypes.data
