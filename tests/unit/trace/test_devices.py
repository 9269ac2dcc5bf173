"""Several devices answer as one does, to the last byte: whoever casts which rays, and whoever fails on the way."""

import re
import signal
import threading
import warnings
from functools import partial

import numpy as np
import pyopencl as cl
import pytest

import clbvh
from clbvh import DeviceError, DeviceWarning, KernelBuildError, QueryError, Scene, Tracer, Transform, choose_device
from clbvh.device.opencl_session import OpenclSession
from clbvh.errors import DeviceMemoryError
from clbvh.rendering import painters
from clbvh.trace import launch, ranges
from clbvh.trace.points import ambient_occlusion

from ...concurrency.queries import ask
from ...concurrency.threads import PATIENCE_S, run_in_threads

pytestmark = pytest.mark.on_opencl

SIDE = 64  # of a picture


@pytest.fixture(scope="module")
def halves():
    """Two devices: halves of the CPU."""
    try:
        devices = choose_device().cl_device.create_sub_devices([cl.device_partition_property.EQUALLY, 1])
    except cl.Error as error:
        pytest.skip(f"the CPU has no parts: {error}")
    return devices[:2] if len(devices) > 1 else pytest.skip("the CPU has one core")


@pytest.fixture
def open_both(halves, monkeypatch):
    """A function from a source to a tracer on both devices, which share queries of a hundred rays."""
    monkeypatch.setattr(ranges, "LEAST_RANGE", 50)
    monkeypatch.setattr(ambient_occlusion, "_LEAST_RANGE_POINTS", 50)
    monkeypatch.setattr(ambient_occlusion, "LEAST_RAYS", 50)
    return lambda source, **options: Tracer(source, device=halves, **options)


def have_worked(tracer):
    """Whether each device has run a kernel."""
    return [each.session.times.sums_ms()["kernel"] > 0 for each in tracer._caster.all]


def fail_on(monkeypatch, context, error, *, first=0, waits=False, of=(launch.Call, "cast")):
    """Let the launches on a device raise, from one on; return how many there were. Other devices may wait for it."""
    run, count, has_failed = getattr(*of), [], threading.Event()

    def run_or_fail(owner, *arguments, **named):
        if getattr(owner, "session", owner).context != context:
            assert not waits or has_failed.wait(PATIENCE_S)
            return run(owner, *arguments, **named)
        count.append(owner)
        if len(count) <= first:
            return run(owner, *arguments, **named)
        has_failed.set()
        raise error

    monkeypatch.setattr(*of, run_or_fail)
    return count


def list_queries(origins, directions):
    """All queries, as `ask` takes them."""
    points = origins / 2
    picture = origins[: SIDE**2 // 2].reshape(-1, SIDE, 3), directions[: SIDE**2 // 2].reshape(-1, SIDE, 3)
    limited = {"t_min": 0.1, "t_max": np.linspace(0.5, 9, len(origins)), "mask": 5}
    of_rays = ["closest_hit", "closest_prim", "any_hit", "count_hits", "all_hits"]
    queries = [(kind, rays, {}) for kind in of_rays for rays in ((origins, directions), picture)]
    queries += [(kind, (origins[0], directions), limited) for kind in of_rays]
    queries += [("all_hits", (origins, directions), {"max_hits": 2, "with_locations": True})]
    for options in ({}, {"mask": np.arange(len(points)) % 4}, {"instance": 0}):
        queries += [(kind, (points,), options) for kind in ("closest_point", "contains", "signed_distance")]
        queries += [("closest_points", (points, 3), options)]
    nothing = np.empty((2, 0, 3))
    return [*queries, ("ambient_occlusion", (points, directions), {"rays": 8}), ("closest_prim", nothing, {})]


def ask_all(tracer, queries):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the knot of a world has no inside where it is placed
        return [ask(tracer, kind, arguments, **options) for kind, arguments, options in queries]


@pytest.mark.parametrize("quality", ["default", "fast"])
def test_the_bytes_are_those_of_one_device(open_tracer, open_both, source, rays, quality):
    queries = list_queries(*rays)
    expected = ask_all(open_tracer(source, quality=quality), queries)
    with open_both(source, quality=quality) as both:
        for query, found, wanted in zip(queries, ask_all(both, queries), expected, strict=True):
            assert found == wanted, query[0]
        assert have_worked(both) == [True, True]
        assert both.devices == (both.device,) * 2
        assert both.memory_bytes == 2 * both._caster.world.memory_bytes


@pytest.mark.parametrize(("count", "step"), [(1_000_000, 1), (1_000_003, 512), (101, 8)])
def test_ranges_cover_all_rays_once_and_shrink(count, step):
    parts = [*iter(ranges.Ranges(count, 2, 50, step).take, None)]
    assert [0, *(part.stop for part in parts)] == [*(part.start for part in parts), count]
    assert all(part.start % step == 0 and len(part) >= 50 for part in parts)
    sizes = [len(part) for part in parts]
    assert sizes[:-1] == sorted(sizes[:-1], reverse=True)


@pytest.mark.parametrize("is_slow_first", [False, True])
def test_a_device_of_a_quarter_of_the_speed_takes_a_fifth(is_slow_first):
    clocks, taken = [0.0, 0.0], [0, 0]
    for part in iter(ranges.Ranges(1_000_000, 2, 1000, 1).take, None):
        device = int(np.argmin(clocks)) if any(clocks) else int(is_slow_first)
        clocks[device] += len(part) * (1, 4)[device]
        taken[device] += len(part)
    assert 0.17 < taken[1] / sum(taken) < 0.23
    assert abs(clocks[0] - clocks[1]) < 0.03 * max(clocks)


@pytest.mark.parametrize(
    "error", [DeviceError("gone"), DeviceMemoryError("full"), KernelBuildError("", "", "")], ids=repr
)
@pytest.mark.parametrize("loser", [0, 1])
def test_a_device_that_fails_is_left_out_with_one_warning(tracer, open_both, mesh, rays, monkeypatch, error, loser):
    expected = ask(tracer, "all_hits", rays)
    with open_both(mesh) as both:
        lost = both._caster.all[loser].session.context
        failures = fail_on(monkeypatch, lost, error, first=1, waits=True)
        with pytest.warns(DeviceWarning, match=f"'{re.escape(both.device.name)}' has failed") as warned:
            assert ask(both, "all_hits", rays) == expected
        assert len(warned) == 1
        assert both.devices == (both.device,)
        failed = len(failures)
        assert ask(both, "all_hits", rays) == expected
        both.closest_hit([0, 0, 9], [0, 0, -1])
        both.update(mesh.vertices + mesh.origin)
        assert ask(both, "all_hits", rays) == expected
        assert len(failures) == failed
    assert all(each.session.is_closed for each in both._caster.all)


def test_the_error_is_raised_where_all_devices_fail(open_both, mesh, rays, monkeypatch):
    with open_both(mesh) as both, monkeypatch.context() as patch:
        [fail_on(patch, each.session.context, DeviceError("gone")) for each in both._caster.all]
        for query in (rays, (rays[0][0], rays[1][0])):
            with pytest.raises(DeviceError, match="gone"):
                both.closest_hit(*query)
        patch.undo()
        assert len(both.devices) == 2
        assert both.closest_hit(*rays).count > 0


def test_small_queries_go_to_the_first_device_or_the_next_one(open_both, mesh, monkeypatch):
    with open_both(mesh) as both:
        both.any_hit([0, 0, 9], [0, 0, -1])
        assert have_worked(both) == [True, False]
        fail_on(monkeypatch, both.context, DeviceError("gone"))
        with pytest.warns(DeviceWarning):
            both.any_hit([0, 0, 9], [0, 0, -1])
        assert have_worked(both) == [True, True]


def test_bad_rays_are_named_as_by_one_device(tracer, open_both, mesh, rays):
    directions = rays[1].copy()
    directions[[700, 2900]] = 0
    for bad in (rays[0], directions), (rays[0].reshape(-1, SIDE, 3), directions.reshape(-1, SIDE, 3)):
        with pytest.raises(QueryError) as expected:
            tracer.closest_hit(*bad)
        with open_both(mesh) as both, pytest.raises(QueryError) as found:
            both.closest_hit(*bad)
        assert str(found.value) == str(expected.value)


def test_moves_reach_all_devices_at_once(open_both, mesh, rays):
    shapes = [mesh.vertices + mesh.origin + [0, 0, shift] for shift in (0.0, 0.3)]
    with open_both(mesh) as both, Tracer(mesh) as one:
        expected = []
        for vertices in shapes:
            one.update(vertices)
            expected.append(ask(one, "closest_hit", rays))
        is_done = threading.Event()

        def move():
            for _ in range(20):
                for vertices in shapes:
                    both.update(vertices)
            is_done.set()

        def look():
            while not is_done.is_set():
                assert ask(both, "closest_hit", rays) in expected

        both.update(shapes[0])
        run_in_threads(move, look)
        assert both.bvh.nodes.tobytes() == one.bvh.nodes.tobytes()

    scene = Scene(mesh)
    scene.place(scene.geometries[0], Transform(translate=(5, 0, 0)))
    with open_both(scene) as both, Tracer(scene) as one:
        for tracer in (both, one):
            tracer.set_transforms(iter([1]), np.diag([2, 1, 1, 1]))
            tracer.set_vertices(scene.geometries[0], shapes[1])
        assert ask(both, "all_hits", rays) == ask(one, "all_hits", rays)


def test_progress_counts_all_rays_in_the_calling_thread(open_both, mesh, rays):
    calls = []
    with open_both(mesh) as both:
        both.closest_hit(*rays, progress=lambda done, of: calls.append((done, of, threading.get_ident())))
        done = [call[0] for call in calls]
        assert len(done) > 4
        assert done == sorted({*done})
        assert {call[1:] for call in calls} == {(done[-1], threading.get_ident())} == {(len(rays[0]), calls[0][2])}
        # It may end the query, or close the tracer.
        for stop in (KeyboardInterrupt, ValueError):
            with pytest.raises(stop):
                both.closest_hit(*rays, progress=lambda *_, stop=stop: (_ for _ in ()).throw(stop))
            assert not any(each.calls._loans for each in both._caster.all)
        expected = both.closest_prim(*rays)
        np.testing.assert_array_equal(both.closest_prim(*rays, progress=lambda *_: both.close()), expected)
        with pytest.raises(QueryError, match="closed"):
            both.closest_prim(*rays)


def test_closing_waits_for_queries_on_all_devices(open_both, mesh, rays):
    both, is_running = open_both(mesh), threading.Event()
    expected = both.closest_prim(*rays)
    trace = partial(both.closest_prim, *rays, progress=lambda *_: is_running.set())
    found, _ = run_in_threads(trace, lambda: is_running.wait(PATIENCE_S) and both.close())
    np.testing.assert_array_equal(found, expected)
    assert all(each.session.is_closed for each in both._caster.all)


def test_ctrl_c_ends_the_work_of_all_devices(open_both, mesh, rays):
    main, before = threading.main_thread().ident, threading.active_count()
    with open_both(mesh) as both:
        timer = threading.Timer(0.3, signal.pthread_kill, (main, signal.SIGINT))
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            both.ambient_occlusion(*rays, rays=1 << 22)  # hours of work: thousands of launches
        assert not any(each.calls._loans for each in both._caster.all)
        assert both.closest_hit(*rays).count > 0
    assert threading.active_count() == before


@pytest.mark.parametrize("settings", [{"shading": "normal"}, {"samples": 5}, {"shading": "path"}], ids=str)
def test_pictures_have_the_bytes_of_one_device(open_both, halves, world, monkeypatch, settings):
    monkeypatch.setattr(painters, "LEAST_RANGE", 64 * 3)
    view, done = {"width": 64, "height": 50, **settings}, []
    expected = clbvh.render(world, **view)
    with clbvh.Renderer(world, options=clbvh.RenderOptions(device=halves)) as renderer:
        found = renderer.render(**view, on_samples=lambda *counts: done.append(counts))
        assert len(renderer.devices) == 2
        assert (found.rgb.tobytes(), found.hits.t.tobytes()) == (expected.rgb.tobytes(), expected.hits.t.tobytes())
        assert found.samples == expected.samples
        assert done == sorted({(count, 64 * 50 * found.samples) for count, _ in done})
        lost = renderer._shown.frames.caster.all[1].session.context
        fail_on(monkeypatch, lost, DeviceError("gone"), waits=True, of=(OpenclSession, "run"))
        with pytest.warns(DeviceWarning):
            assert renderer.render(**view).rgb.tobytes() == expected.rgb.tobytes()


def test_devices_may_be_named_in_many_ways(halves, mesh):
    info = choose_device()
    for given in ([info], (info.number, info, str(info.number))):
        assert Tracer(mesh, device=given).devices == (info,)
    assert Tracer(mesh, device="all").device == choose_device("host")
    assert Tracer(mesh, device=halves[0]).device.compute_units == 1
    with pytest.raises(DeviceError, match="empty"):
        Tracer(mesh, device=[])
