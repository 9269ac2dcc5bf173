"""A device with too little memory is asked again in smaller pieces: the same answers, and one error when none fits."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Tracer, View, build
from clbvh.device.session import DeviceSession
from clbvh.errors import DeviceError, DeviceMemoryError
from clbvh.rendering.cameras.bounds import SceneBounds
from clbvh.rendering.kernel_view import make_kernel_view
from clbvh.rendering.painters import FrameRenderer, OneRayPainter
from clbvh.rendering.view_finder import ViewFinder
from clbvh.trace.launch import MOST_HALVINGS

from ...worlds import open_mesh

QUERIES = {
    "closest_hit": lambda tracer, rays: tracer.closest_hit(*rays),
    "closest_prim": lambda tracer, rays: tracer.closest_prim(*rays),
    "any_hit": lambda tracer, rays: tracer.any_hit(*rays),
    "count_hits": lambda tracer, rays: tracer.count_hits(*rays),
    "all_hits": lambda tracer, rays: tracer.all_hits(*rays),
    "closest_point": lambda tracer, rays: tracer.closest_point(rays[0]),
    "contains": lambda tracer, rays: tracer.contains(0.1 * rays[0]),
    "ambient_occlusion": lambda tracer, rays: tracer.ambient_occlusion(*rays),
}


def arrays_of(answer):
    if isinstance(answer, np.ndarray):
        return [answer]
    names = ("t", "u", "v", "prim_id", "offsets", "distance", "point")
    return [getattr(answer, name) for name in names if hasattr(answer, name)]


@pytest.fixture
def limit(monkeypatch):
    """A function that lets every session refuse buffers of more than some bytes, as a driver does."""

    def set_limit(largest, error=-4):
        import pyopencl as cl

        from clbvh.device.session import _buffer_type

        refused.clear()

        def allocate_some(self, context, flags, size):
            if size > largest:
                refused.append(size)
                raise cl.MemoryError(cl._cl._ErrorRecord("", error, "clCreateBuffer"))
            cl.Buffer.__init__(self, context, flags, size)

        monkeypatch.setattr(_buffer_type(), "__init__", allocate_some)

    refused = set_limit.refused = []
    return set_limit


@pytest.mark.parametrize("name", QUERIES)
def test_the_same_answers_in_smaller_pieces(mesh, tracer, rays, session, limit, name):
    expected = arrays_of(QUERIES[name](tracer, rays))
    with Tracer(build(mesh), device=session.info) as small:
        limit(34_000)  # 3,072 rays take 98 KB and points 37 KB; the fewest rays that are cast at a time 33 KB
        for _ in range(2):
            found = arrays_of(QUERIES[name](small, rays))
            for one, other in zip(found, expected, strict=True):
                np.testing.assert_array_equal(one, other)
    assert limit.refused


@pytest.mark.parametrize("error", [-4, -5, -6])
def test_a_device_without_any_memory_is_one_error(mesh, rays, session, limit, error):
    with Tracer(build(mesh), device=session.info) as full:
        limit(64, error)
        with pytest.raises(DeviceMemoryError, match=r"cannot hold a buffer of .*: try a smaller job"):
            full.closest_hit(*rays)


def test_other_errors_of_a_device_are_not_tried_again(mesh, rays, session, monkeypatch):
    calls = []

    def fail(self, *arguments, **named):
        calls.append(1)
        raise DeviceError("broken")

    with Tracer(build(mesh), device=session.info) as broken:
        monkeypatch.setattr(DeviceSession, "run", fail)
        with pytest.raises(DeviceError, match="broken"):
            broken.closest_hit(*rays)
    assert len(calls) == 1


def test_a_picture_is_drawn_in_narrower_bands(mesh, session, limit):
    with DeviceSession(session.info) as opened:
        world = open_mesh(opened, mesh, build(mesh))
        settings = View(width=64, height=48, shading="lambert+shadow", up="y")
        view = make_kernel_view(settings, ViewFinder(SceneBounds.of_mesh(mesh)).camera(settings), mesh)
        painter = OneRayPainter(opened, world)
        renderer = FrameRenderer(opened, world)
        expected = renderer.render(view, painter)
        renderer = FrameRenderer(opened, world)  # without the other one's memory
        limit(10_000)  # a row of hits takes 1 KB
        for found, wanted in zip(renderer.render(view, painter), expected, strict=True):
            np.testing.assert_array_equal(found, wanted)
        assert limit.refused
        renderer = FrameRenderer(opened, world)
        limit(500)
        with pytest.raises(DeviceMemoryError, match="cannot hold a buffer"):
            renderer.render(view, painter)


def test_threads_that_are_refused_together_halve_once(tracer):
    caster = tracer._caster
    before = caster.halvings
    try:
        assert [caster.cut_smaller(before) for _ in range(8)] == [True] * 8
        assert caster.halvings == before + 1
        assert not caster.cut_smaller(MOST_HALVINGS)
    finally:
        caster.halvings = before
