from __future__ import annotations

import json
import math
import shlex
import time

import imageio.v3 as imageio
import numpy as np
import pytest

import clbvh
from clbvh.cli.app import make_app
from clbvh.viewer import navigate
from clbvh.viewer.open import prepare

from .page import Page


@pytest.fixture(scope="module")
def scene():
    parts = [("south", 0, 160), ("north", 160, 320)]
    ball = clbvh.make_shape("icosphere", triangles=320)
    ball = clbvh.Mesh.from_arrays(ball.vertices, ball.faces, parts=parts)
    scene = clbvh.Scene()
    added = scene.add(ball, name="ball")
    scene.place(added, name="left")
    scene.place(added, clbvh.Transform(translate=(3, 0, 0)), name="right")
    return scene


@pytest.fixture(scope="module")
def renderer(scene):
    with clbvh.Renderer(scene, samples=4, side="front") as renderer:
        yield renderer


@pytest.fixture
def page(renderer):
    with Page(renderer) as page:
        page.settle()
        yield page


def settled_equals(page: Page, renderer, **changes) -> bool:
    """Whether the picture that settles is that of the Python that the page copies."""
    pixels, names = page.settle(), {"clbvh": clbvh}
    exec(page.text("python").splitlines()[0], names)
    return np.array_equal(pixels, renderer.render(names["view"]).rgb)


# What a person does, and whether the picture is another one then.
ACTIONS = {
    "orbits": lambda page: page.drag((30, 30), (60, 40)),
    "orbits beside everything": lambda page: page.drag((2, 2), (60, 40)),
    "pans": lambda page: page.drag((30, 30), (60, 40), button=2),
    "zooms": lambda page: page.do("wheel", x=30, y=30, dx=0, dy=-100),
    "focuses": lambda page: page.do("double_click", x=70, y=32),
    "presses a key for a side": lambda page: page.do("key_down", key="t"),
    "presses a key for a shading": lambda page: page.do("key_down", key="3"),
    "cuts": lambda page: page.do("set", name="cut", value="x=50%"),
    "shows edges": lambda page: page.do("set", name="wireframe", value=True),
    "resizes": lambda page: page.do("resize", width=60, height=50, pixel_ratio=1.5),
}


@pytest.mark.parametrize("action", ACTIONS.values(), ids=ACTIONS)
def test_the_picture_settles_to_that_of_the_copied_view(page, renderer, action):
    before = page.text("python")
    action(page)
    assert settled_equals(page, renderer)
    assert page.text("python") != before


# Settings of a scene file, and what is changed.
FILE_CASES = {
    "a side gives way": ('side = "right"', lambda page: page.drag((30, 30), (60, 40))),
    "one sample": ("samples = 4", lambda page: page.do("key_down", key="1")),
    "no edges": ("wireframe = {width = 3}", lambda page: page.do("key_down", key="m")),
    "an environment": ('shading = "path"\nsamples = 2\nenvironment = "sky.hdr"', lambda page: None),
}


@pytest.mark.parametrize(("text", "action"), FILE_CASES.values(), ids=FILE_CASES)
def test_what_is_copied_says_how_a_view_differs_from_that_of_a_scene_file(tmp_path, text, action):
    file = tmp_path / "scene.toml"
    file.write_text(f'[[object]]\nshape = "icosphere"\ntriangles = 320\n[view]\nup = "y"\n{text}\n')
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n"
    (tmp_path / "sky.hdr").write_bytes(head + bytes([90, 100, 110, 128] * 2))
    opened = prepare(str(file), None, None, {})()
    with opened.renderer, Page(opened.renderer, **opened.settings) as page:
        action(page)
        page.do("resize", width=48, height=32, pixel_ratio=1)
        page.last("frame", settled=True, width=48)
        pixels, names = page.settle(), {"clbvh": clbvh}
        words = shlex.split(page.text("command"))
        exec(page.text("python"), names)
    assert np.array_equal(names["picture"].rgb, pixels)
    make_app()([*words[1:-1], str(tmp_path / "copied.png"), "--json"])
    assert np.array_equal(imageio.imread(tmp_path / "copied.png"), pixels)


def test_the_copied_command_renders_what_is_seen(tmp_path, renderer):
    mesh = clbvh.make_shape("icosphere", triangles=320)
    file = tmp_path / "ball's mesh.obj"
    rows = [*("v {} {} {}\n".format(*v) for v in mesh.vertices), *("f {} {} {}\n".format(*f + 1) for f in mesh.faces)]
    file.write_text("".join(rows))
    changes = {"projection": "orthographic:3", "light_direction": (1, 2, 3), "samples": 4}
    opened = prepare(str(file), None, None, changes)()
    with opened.renderer, Page(opened.renderer, **opened.settings) as page:
        page.settle()
        page.drag((30, 30), (60, 40))
        page.do("set", name="cut", value="y=50%")
        page.do("set", name="wireframe", value=True)
        pixels = page.settle()
        words = shlex.split(page.text("command"))
    make_app()([*words[1:-1], str(tmp_path / "copied.png"), "--json"])
    assert np.array_equal(imageio.imread(tmp_path / "copied.png"), pixels)


def test_a_view_from_above_moves_without_a_jump_and_keeps_the_up_of_the_scene(page):
    page.do("key_down", key="t")
    page.settle()
    page.drag((30, 30), (40, 40), button=2)
    names = {"clbvh": clbvh}
    exec(page.text("python").splitlines()[0], names)
    view = names["view"]
    assert view.up == (0.0, 1.0, 0.0)
    down = np.subtract(view.look_at, view.eye) / np.linalg.norm(np.subtract(view.look_at, view.eye))
    assert -1.0 < down[1] < -0.999


@pytest.mark.parametrize("ratio", [1.0, 2.0])
def test_a_click_says_what_the_closest_hit_is(renderer, ratio):
    with Page(renderer, 96, 64, ratio) as page:
        page.settle()
        lines = page.click(25.25, 30.25)
        width, height = int(96 * ratio), int(64 * ratio)
        camera = renderer.find_camera(width=width, height=height)
        origins, directions = camera.rays_at(np.multiply((25.25, 30.25), ratio), width, height)
        with clbvh.Tracer(renderer.scene) as tracer:
            hit = tracer.closest_hit(origins, directions)
        assert lines["face"] == f"{int(hit.prim_id):,}"
        assert lines["distance"] == f"{float(hit.t):.7g}"
        assert lines["part"] == ("south" if hit.prim_id < 160 else "north")
        assert lines["instance"] == "left (0)"


def test_a_click_beside_the_circle_of_a_fisheye_hits_nothing(renderer):
    view = renderer.view.changed(projection="fisheye", eye=(0, 0, 0), transparent=True)
    with Page(renderer, view=view) as page:
        page.last("frame", settled=True)
        assert {each["format"] for each, _ in page.messages if each["type"] == "frame"} == {"png"}  # with alpha
        assert page.click(48, 32)
        assert page.click(1, 1) == {}


def test_two_clicks_measure_and_highlight_and_a_third_starts_anew(page):
    begin, lines = page.click(25, 30), page.click(70, 30)
    overlay, mask = page.last("overlay")
    points = [[float(part) for part in each["location"].split(",")] for each in (begin, lines)]
    assert float(lines["measured"]) == pytest.approx(math.dist(*points), rel=1e-4)
    assert overlay["measure"] == f"{float(lines['measured']):.6g}"
    assert [round(mark["x"]) for mark in overlay["marks"]] == [25, 70]
    assert mask
    assert page.click(1, 1) == {}
    assert page.last("overlay") == ({"type": "overlay", "marks": [], "bytes": 0}, b"")


def test_a_cut_shows_and_clicks_what_is_behind_it(page):
    front = page.click(25, 30)
    page.do("set", name="cut", value="z=50%")
    behind = page.click(25, 30)
    assert float(behind["distance"]) > float(front["distance"])
    assert float(behind["location"].split(",")[2]) < 1e-6


def test_a_wrong_event_is_a_note_and_the_page_goes_on(page):
    for name, value in (("cut", "nonsense"), ("shading", "none"), ("eye", 1)):
        page.do("set", name=name, value=value)
        assert page.last("note")[0]["is_error"]
    page.do("unknown")
    page.do("key_down", key="3")
    assert page.settle().shape == (64, 96, 3)


NESTED = json.loads("[" * 900 + "]" * 900)
MALFORMED = {
    "no object": (None, [], "x", 1.5, NESTED),
    "a size": [
        {"event_type": "resize", "width": 96, "height": 64, **wrong}
        for wrong in (
            *({"width": each} for each in (0, -1, 1e-300, 1e308, math.inf, math.nan, 10**400, "x", None, NESTED)),
            {"pixel_ratio": 0}, {"pixel_ratio": 1e308},
        )
    ],
    "a point": [
        {"event_type": kind, "x": 1, "y": 1, "dy": 1, "button": 1, "buttons": [1], "modifiers": [], **wrong}
        for kind in ("pointer_down", "pointer_move", "double_click", "wheel")
        for wrong in ({"x": math.inf}, {"y": 1e308}, {"y": math.nan}, {"modifiers": 1}, {"buttons": [None]})
    ],
    "fields left out": [{"event_type": kind} for kind in ("resize", "pointer_down", "wheel", "key_up", "set", "ask")],
    "others": (
        {"event_type": "frame_feedback", "index": math.inf},
        {"event_type": "key_down", "key": ["w"]},
        {"event_type": "key_down", "key": "w", "modifiers": [[]]},
        {"event_type": "set", "name": "cut", "value": NESTED},
        {"event_type": "set", "name": {}, "value": 1},
    ),
}  # fmt: skip


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("events", MALFORMED.values(), ids=MALFORMED)
def test_a_malformed_event_is_refused_by_one_line(page, events, capfd):
    for event in events:
        page.messages.clear()
        page.session.handle(event)
        (message,) = [each for each, _ in page.messages]
        assert message["is_error"]
        assert " must be " in message["text"]
        assert len(message["text"]) < 200
    page.do("key_down", key="1" * 5000)  # no key of a shading
    page.do("key_down", key="3")
    assert page.settle().shape == (64, 96, 3)
    assert capfd.readouterr().err == ""


def test_the_thread_survives_what_cannot_be_rendered(renderer, monkeypatch):
    with Page(renderer, view=clbvh.View(projection="panorama", samples=4)) as page:
        page.do("key_down", key="t")
        assert page.last("note", is_error=True)[0]["text"].startswith("a panorama")
        assert "side='top'" not in page.text("python")
        page.settle()
        with monkeypatch.context() as patch:
            patch.setattr(renderer, "render", lambda *_, **__: bytearray(2**62))
            page.do("key_down", key="r")
            page.last("note", text="MemoryError()")
        page.do("key_down", key="l")
        page.settle()


def test_a_picture_is_saved_once_it_has_settled(page):
    page.do("key_down", key="t")
    page.do("ask", what="png")
    (_, saved), (_, shown) = page.last("file"), page.last("frame", settled=True)
    assert saved == shown


@pytest.mark.parametrize("changes", [
    {"projection": "panorama"}, {"projection": "fisheye:300"}, {"projection": "orthographic:1e-7"}, {"fov": 1e-6},
], ids=str)  # fmt: skip
def test_a_point_stays_under_the_cursor_also_beside_the_camera_and_close_up(renderer, changes):
    view = clbvh.View(eye=(0, 0, 3), look_at=(0, 0, 0), shading="lambert", width=400, height=400).changed(**changes)
    camera, size = renderer.find_camera(view), (400, 400)
    point = navigate.find_opposite(camera, (210, 195), size)
    for pixel in ((330, 230), (40, 200)):
        camera = navigate.drag(camera, point, pixel, size)
        assert camera.project(point, *size)[0] == pytest.approx(pixel, abs=0.01)


# A page that was loaded again says its size, and nothing about the pictures before.
@pytest.mark.parametrize("answer", ["frame_feedback", "resize"])
def test_one_picture_is_in_flight_and_the_newest_camera_wins(page, answer):
    page.draws = False
    page.do("key_down", key="t")
    first = page.last("frame")[0]
    for key in "rblf":
        page.do("key_down", key=key)
    time.sleep(0.3)
    assert page.last("frame")[0] == first
    page.draws = True
    page.do(answer, index=first["index"], width=96, height=64)
    page.settle()
    assert "side='front'" in page.text("python")


def test_flying_and_the_turntable_go_on_until_they_are_stopped(page):
    page.do("set", name="fly", value=True)
    page.do("key_down", key="w")
    page.do("key_down", key=" ")
    begin = page.last("frame")[0]["index"]
    while page.last("frame")[0]["index"] < begin + 5:
        time.sleep(0.01)
    page.do("key_up", key="w")
    page.do("key_down", key=" ")
    page.settle()
    here = page.text("python")
    time.sleep(0.3)
    assert page.text("python") == here
    page.do("ask", what="home")
    page.settle()
    assert "side='front'" in page.text("python")


def test_a_closed_page_stops_work_and_may_come_back(page):
    page.do("resize", width=4000, height=3000, pixel_ratio=1)
    page.do("close")
    count = len(page.messages)
    assert page.messages[-1][0]["type"] == "opened"  # for another view of the widget
    time.sleep(0.3)
    assert len(page.messages) == count
    page.do("resize", width=40, height=30, pixel_ratio=1)
    assert page.settle().shape == (30, 40, 3)
