"""Memory of a tracer: of one chunk at most, in smaller pieces where there is little, and one error where none is."""

import dataclasses

import numpy as np
import pytest

from clbvh import ConfigError, DeviceMemoryError, QueryError, Renderer, Tracer
from clbvh.device.host import session as host_session
from clbvh.structs import HIT, PACKED_RAY
from clbvh.trace import tracer as tracer_module
from clbvh.trace.rays import pieces

from ...chain import make_chain

FIELDS = ("t", "u", "v", "prim_id")
RAY_QUERIES = ("closest_hit", "closest_prim", "any_hit", "count_hits", "all_hits", "ambient_occlusion")


@pytest.fixture(scope="module")
def expected(tracer, rays):
    return tracer.closest_hit(*rays)


def assert_same(obtained, expected, rows=slice(None)):
    for field in FIELDS:
        assert getattr(obtained, field).tobytes() == getattr(expected, field)[rows].tobytes(), (field, rows)


def ask(tracer, query, rays):
    """The arrays of an answer."""
    answer = getattr(tracer, query)(*(rays if query in RAY_QUERIES else (0.1 * rays[0],)))
    names = (*FIELDS, "offsets", "distance", "point")
    return [answer] if isinstance(answer, np.ndarray) else [getattr(answer, n) for n in names if hasattr(answer, n)]


def record_allocations(session, monkeypatch):
    """A list that gets the size of every buffer from now on."""
    sizes, kind, allocate = [], type(session), type(session).allocate
    monkeypatch.setattr(kind, "allocate", lambda self, size, **how: sizes.append(size) or allocate(self, size, **how))
    return sizes


@pytest.mark.on_both
def test_memory_is_that_of_one_chunk_at_most(session, mesh, rays, expected, monkeypatch):
    monkeypatch.setattr(pieces, "CHUNK_RAYS", 100)
    with Tracer(mesh, device=session.info) as opened:
        sizes = record_allocations(session, monkeypatch)
        for count in (0, 7, 100, 10, 1000, 1000):
            assert_same(opened.closest_hit(rays[0][:count], rays[1][:count]), expected, slice(count))
        opened.any_hit(*rays)
        with pytest.raises(QueryError, match="length zero"):
            opened.closest_hit([[0, 0, 0]], [[0, 0, 0]])
        # The host casts rays where they are.
        is_host = session.info.is_host
        assert sizes == ([] if is_host else [n * dtype.itemsize for n in (7, 100) for dtype in (PACKED_RAY, HIT)])
        # Those of the tree, and of a call that has ended.
        idle = [memory.session.buffer_count for memory in opened._caster.calls._idle]
        assert opened._caster.session.buffer_count == 2
        assert idle == ([] if is_host else [2])


def test_buffers_respect_the_largest_allocation(session, mesh, rays, expected, monkeypatch):
    """As on a device that allocates no more than 16 KiB at a time, apart from the tree."""
    with Tracer(mesh, device=session.info) as opened:
        opened._caster.session.info = dataclasses.replace(session.info, max_allocation_bytes=16384)
        sizes = record_allocations(session, monkeypatch)
        for least_rays in (1 << 16, 100):  # which are not sorted, and which are
            monkeypatch.setattr(pieces, "LEAST_RAYS", least_rays)
            assert_same(opened.closest_hit(*rays), expected)
            np.testing.assert_array_equal(opened.count_hits(*rays), opened.all_hits(*rays).counts)
        opened.closest_point(rays[0])
    assert max(sizes) <= 16384


def test_what_cannot_be_opened_leaves_nothing_on_the_device(session, monkeypatch):
    opened, open_session = [], tracer_module.open_session

    def note(*given):
        opened.append(open_session(*given))
        return opened[-1]

    monkeypatch.setattr(tracer_module, "open_session", note)
    with pytest.raises(ConfigError, match="too deep"):
        Tracer(make_chain(1026, "left")[1], device=session.info, layout="bvh2")
    assert [session.is_closed for session in opened] == [True]


@pytest.fixture
def limit(session, monkeypatch):
    """A function that lets every session refuse buffers of more than some bytes, as a driver or the system does."""

    def set_limit_of_host(largest, error=None):
        refused.clear()

        def check(subject, needed_bytes, kind, advice=""):
            if needed_bytes > largest:
                refused.append(needed_bytes)
                raise kind(f"{subject} cannot hold a buffer of {needed_bytes}: {advice}")

        monkeypatch.setattr(host_session, "check_memory", check)

    def set_limit_of_driver(largest, error=-4):
        import pyopencl as cl

        from clbvh.device.opencl_session import _buffer_type

        refused.clear()

        def allocate_some(self, context, flags, size):
            if size > largest:
                refused.append(size)
                raise cl.MemoryError(cl._cl._ErrorRecord("", error, "clCreateBuffer"))
            cl.Buffer.__init__(self, context, flags, size)

        monkeypatch.setattr(_buffer_type(), "__init__", allocate_some)

    set_limit = set_limit_of_host if session.info.is_host else set_limit_of_driver
    refused = set_limit.refused = []
    return set_limit


@pytest.mark.on_both
@pytest.mark.parametrize("query", [*RAY_QUERIES, "closest_point", "contains"])
def test_little_memory_gives_the_same_answers_in_smaller_pieces(mesh, tracer, rays, session, limit, query, monkeypatch):
    expected = ask(tracer, query, rays)
    if query == "all_hits":  # of few rays on the host, they are in no buffers
        monkeypatch.setattr(pieces, "LEAST_RAYS", 1)
    with Tracer(mesh, device=session.info) as small, Tracer(mesh, device=session.info) as full:
        limit(34_000)  # 3,072 rays take 98 KB and points 37 KB; the fewest rays that are cast at a time 33 KB
        for _ in range(2):
            for one, other in zip(ask(small, query, rays), expected, strict=True):
                np.testing.assert_array_equal(one, other)
        # The host takes rays and points where they are.
        uses_none = session.info.is_host and query not in ("all_hits", "ambient_occlusion")
        needs_buffers = not uses_none
        assert bool(limit.refused) == needs_buffers
        for error in (-4, -5, -6) if needs_buffers else ():
            limit(64, error)
            with pytest.raises(DeviceMemoryError, match=r"cannot hold a buffer of .*: try a smaller job"):
                ask(full, query, rays)


def test_a_picture_is_drawn_in_narrower_bands(mesh, limit):
    shading = {"width": 64, "height": 48, "shading": "lambert+shadow"}
    with Renderer(mesh) as roomy, Renderer(mesh) as small:
        expected = roomy.render(**shading)
        limit(10_000)  # a row of hits takes 1 KB
        np.testing.assert_array_equal(small.render(**shading).rgb, expected.rgb)
        assert limit.refused
