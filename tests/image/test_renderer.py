"""A renderer of many pictures: each is what `render` makes, nothing is made twice, and it can be shared and closed."""

import threading
import time

import numpy as np
import pytest

import clbvh
from clbvh import Camera, Light, QueryError, Renderer, Scene, SceneError
from clbvh.device import program
from clbvh.device.host.session import HostSession
from clbvh.device.session import DeviceSession
from clbvh.rendering import painters

from ..concurrency.threads import run_in_threads
from .test_pictures import KNOT, same_picture

SIZE = (80, 60)
VIEW = clbvh.View(width=SIZE[0], height=SIZE[1], up="y", shading="lambert+shadow")


@pytest.fixture(scope="module")
def renderer():
    with Renderer(KNOT, VIEW) as opened:
        yield opened


def test_pictures_are_those_of_render_and_leave_nothing_to_the_next(renderer):
    first = renderer.render()
    rows = [
        {"shading": "normal"},
        {"width": 31, "height": 77},
        {"camera": Camera((3, 1, 4), (0, 0, 0), fov=60), "shading": "depth"},
        {"light": Light(direction=(1, 2, 3), colour=(1, 0, 0))},
        {"surface": (0.1, 0.9, 0.3), "background": ((0, 0, 0), (1, 1, 1))},
    ]
    for changes in rows:
        assert same_picture(renderer.render(**changes), clbvh.render(KNOT, VIEW, **changes)), changes
        assert same_picture(renderer.render(), first)
    # The scene's camera follows the shape of the picture.
    assert renderer.render(width=30, height=90).camera == renderer.find_camera(width=30, height=90) != renderer.camera


def test_a_turn_keeps_device_tree_kernels_and_buffers(renderer, monkeypatch):
    renderer.render()
    made = []
    session = type(renderer.tracer._caster.session)
    for owner, name in ((session, "allocate"), (DeviceSession, "__init__"), (program, "_compile")):
        monkeypatch.setattr(owner, name, lambda *_, **__: made.append(1))
    assert all(renderer.render(camera=camera).hits.count > 500 for camera in renderer.turntable(8))
    assert made == []


def test_timings_are_those_of_the_picture_alone(renderer):
    picture, once = renderer.render(), clbvh.render(KNOT, VIEW)
    phases = ["load", "cache", "build", "open", "layout", "compile", "upload", "kernel", "download", "other", "total"]
    assert list(picture.timings) == list(renderer.timings) == list(once.timings) == phases
    assert picture.timings["kernel"] > 0
    assert picture.timings["build"] == picture.timings["load"] == picture.timings["compile"] == 0


def test_phases_add_up_however_long_uploads_take(monkeypatch):
    move = HostSession._move

    def move_slowly(session, label, target, source):
        begin_s = time.perf_counter()
        move(session, label, target, source)
        time.sleep(0.002)
        session.times.add(label, (time.perf_counter() - begin_s) * 1e3)

    monkeypatch.setattr(HostSession, "_move", move_slowly)
    # Tables of the sky and of lights are uploaded for the shading, after the tree.
    with Renderer(KNOT, VIEW, clbvh.RenderOptions(device="host"), shading="path") as renderer:
        for times in (renderer.timings, renderer.render().timings):
            assert sum(times.values()) - times["total"] == pytest.approx(times["total"])


def test_a_renderer_has_the_objects_of_its_beginning():
    scene = Scene(KNOT)
    with Renderer(scene, VIEW) as renderer:
        before = renderer.render()
        scene.place(scene.geometries[0], clbvh.Transform(scale=5))
        assert same_picture(renderer.render(), before)
        assert renderer.memory_bytes > 4000 * 36
    assert renderer.is_closed
    renderer.close()
    with pytest.raises(QueryError, match="the renderer is closed"):
        renderer.render()


def test_a_failure_gives_the_devices_memory_back(session, monkeypatch):
    closed, close = [], type(session).close
    monkeypatch.setattr(type(session), "close", lambda self: closed.append(self) or close(self))

    def fail(*_, **__):
        raise SceneError("broken")

    monkeypatch.setattr(painters.Painters, "painter", fail)
    with pytest.raises(SceneError, match="broken"):
        Renderer(KNOT, VIEW)
    assert len(closed) == 1


def test_threads_share_a_renderer(renderer):
    views = [{"camera": renderer.camera.orbit(40 * number), "width": 31 + 10 * number} for number in range(6)]
    expected = [renderer.render(**view) for view in views]

    def draw_all(seed):
        for number in np.random.default_rng(seed).permutation(6):
            assert same_picture(renderer.render(**views[number]), expected[number])

    run_in_threads(*(lambda seed=seed: draw_all(seed) for seed in range(6)))


def close_while_others_draw(renderer, draw):
    """Close a renderer once one of two threads has drawn; these draw on until it says that it is closed."""
    begun = threading.Event()

    def draw_on():
        while True:
            draw()
            begun.set()

    def draw_until_closed():
        with pytest.raises(QueryError, match="closed"):
            draw_on()

    def close():
        assert begun.wait(60)
        renderer.close()

    run_in_threads(draw_until_closed, draw_until_closed, close)


def test_closing_waits_for_pictures_of_other_threads():
    opened = Renderer(KNOT, VIEW)
    close_while_others_draw(opened, lambda: opened.render(width=200, height=150))
    assert opened.tracer._caster.session.buffer_count == 0


def test_a_thread_that_waits_for_a_closing_renderer_reads_that_it_is_closed():
    opened, locked = Renderer(KNOT, VIEW), threading.Event()

    def ask():
        assert locked.wait(60)
        with pytest.raises(QueryError, match="closed"):
            _ = opened.mesh

    def close():
        with opened._lock:
            locked.set()
            time.sleep(0.1)  # The other thread comes as far as the lock.
            opened.close()

    run_in_threads(ask, close)


class TestRenderersOfTracers:
    @pytest.fixture
    def tracer(self, session):
        scene = Scene()
        scene.place(scene.add(KNOT, name="knot"), name="moves")
        scene.place(scene.geometries[0], clbvh.Transform(translate=(2, 0, 0)))
        with clbvh.Tracer(scene) as opened:
            yield opened

    @pytest.mark.on_both
    def test_they_show_what_it_is_at_now_and_share_its_trees(self, tracer):
        with (
            Renderer(tracer, VIEW) as renderer,
            Renderer(tracer, VIEW, shading="studio", samples=2, smooth=30) as second,
        ):
            counts = []
            for step in range(6):
                for each in (renderer, second):
                    picture, new = each.render(), Renderer(Scene.from_state(tracer._caster.world.state), each.view)
                    with new:
                        assert same_picture(picture, new.render())
                    hits = each.hits_at([[40, 30], [0, 0]])
                    centre = each.camera.rays_at([[40, 30], [0, 0]], *SIZE)
                    assert hits.t.tobytes() == tracer.closest_hit(*centre).t.tobytes()
                tracer.set_transforms("moves", clbvh.Transform(translate=(0, step + 1, 0)))
                tracer.set_vertices("knot", KNOT.vertices * [1, 1 + step / 4, 1])
                counts.append([each.buffer_count for each in (tracer._caster.session, second._session)])
            assert renderer.tracer is second.tracer is tracer
            assert counts[3] == counts[4] == counts[5]
        assert not tracer.is_closed

    def test_its_end_is_theirs(self, tracer):
        renderer = Renderer(tracer, VIEW)
        renderer.render()
        tracer.close()
        assert renderer.is_closed
        for ask in (renderer.render, renderer.find_camera, lambda: renderer.hits_at([1, 1])):
            with pytest.raises(QueryError, match="the renderer is closed"):
                ask()
        renderer.close()
        with pytest.raises(QueryError, match="the tracer is closed"):
            Renderer(tracer, VIEW)

    def test_a_renderer_may_be_closed_while_another_thread_draws(self, tracer):
        renderer, expected = Renderer(tracer, VIEW), clbvh.render(tracer, VIEW)

        def draw():
            assert same_picture(renderer.render(), expected)

        close_while_others_draw(renderer, draw)
        assert tracer.closest_hit([0, 0, 9], [0, 0, -1]).t.shape == ()

    def test_options_that_a_tracer_has_are_refused(self, tracer):
        with pytest.raises(clbvh.ConfigError, match="a tracer has its device"):
            Renderer(tracer, VIEW, clbvh.RenderOptions(layout="bvh4"))
        assert clbvh.render(tracer, VIEW, clbvh.RenderOptions(validate=True)).validated_pixels > 1000

    def test_an_own_tracer_casts_and_moves(self):
        with Renderer(KNOT, VIEW) as renderer:
            assert renderer.bvh is not None
            assert renderer.render().report()["nodes"] > 1000
            renderer.tracer.update(KNOT.vertices + np.array([0, 0, 5.0]))
            with Renderer(KNOT.with_vertices(KNOT.vertices + np.array([0, 0, 5.0])), VIEW) as new:
                assert same_picture(renderer.render(), new.render())
            assert renderer.render().report()["nodes"] is None
