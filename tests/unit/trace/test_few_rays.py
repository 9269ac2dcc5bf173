"""Queries with few rays: their errors, their times, and what they see of updates."""

import numpy as np
import pytest

from clbvh import Mesh, QueryError, Tracer
from clbvh.structs import NO_PRIM
from clbvh.trace.hits import closest
from clbvh.trace.put_rays import cut_batch, put_rays
from clbvh.trace.rays.batch import read_rays

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
