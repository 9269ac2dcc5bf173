"""The arrays of hits."""

import numpy as np
import pytest

import clbvh
from clbvh.structs import HIT, NO_PRIM
from clbvh.trace.hits.hits import Hits


def hits_of(raw):
    return Hits(*(raw[name] for name in ("t", "u", "v", "prim_id")))


@pytest.fixture
def raw():
    return np.array([(1.5, 0.25, 0.5, 0), (np.inf, 0, 0, NO_PRIM), (2.0, 0, 1, 7), (0.0, 0, 0, 3)], HIT)


def test_fields_are_views_of_the_device_array(raw):
    hits = hits_of(raw)
    for name in HIT.names:
        np.testing.assert_array_equal(getattr(hits, name), raw[name])
        assert np.shares_memory(getattr(hits, name), raw)
        assert getattr(hits, name).dtype == HIT[name]


def test_face_0_is_a_hit_and_no_face_is_a_miss(raw):
    hits = hits_of(raw)
    assert hits.is_hit.tolist() == [True, False, True, True]
    assert hits.count == 3
    assert isinstance(hits.count, int)
    assert len(hits) == 4


def test_pictures_of_hits_are_counted_by_row(raw):
    hits = hits_of(np.stack((raw, raw, raw)))
    assert len(hits) == 3
    assert hits.count == 9
    assert hits.is_hit.shape == (3, 4)


def test_take_counts_in_c_order(raw):
    hits = hits_of(raw.reshape(2, 2)).take(np.array([3, 0, 0]))
    assert hits.prim_id.tolist() == [3, 0, 0]
    assert hits.t.tolist() == [0.0, 1.5, 1.5]
    assert hits.u.tolist() == [0.0, 0.25, 0.25]
    assert hits.v.tolist() == [0.0, 0.5, 0.5]


def test_no_rays_no_hits():
    hits = hits_of(np.empty(0, HIT))
    assert len(hits) == hits.count == 0
    assert hits.take(np.array([], np.int64)).t.shape == (0,)


def test_hits_cannot_be_replaced(raw):
    with pytest.raises(AttributeError):
        hits_of(raw).t = raw["u"]


def test_hits_show_their_numbers_and_no_arrays(raw, session):
    assert repr(hits_of(raw)) == f"Hits(shape={raw.shape}, hits={np.count_nonzero(raw['prim_id'] != NO_PRIM)})"
    with clbvh.Tracer(clbvh.make_shape("icosphere", triangles=80)) as tracer:
        along, past = [[1, 0, 0]] * 2000, np.arange(6000).reshape(2000, 3)
        assert repr(tracer.closest_hit([0, 0, 0], along)) == "Hits(shape=(2000,), hits=2,000)"
        assert repr(tracer.closest_hit([0, 0, 0], [1, 0, 0])) == "Hits(shape=(), hits=1)"
        assert repr(tracer.all_hits([[-5, 0.1, 0.1], [-5, 7, 0]], [1, 0, 0])) == "AllHits(rays=2, hits=2)"
        assert repr(tracer.closest_point(past)) == "ClosestPoints(shape=(2000,), found=2,000)"
