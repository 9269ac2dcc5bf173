"""Settings of pictures: each is checked where it is declared, and has the same name everywhere."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import clbvh
from clbvh import Camera, Fisheye, Light, Orthographic, View, Wireframe
from clbvh.errors import MeshError, SceneError
from clbvh.rendering.settings import as_plain, list_settings

SETTINGS = {each.name: each for each in list_settings(View)}

# For each setting values that it takes, with what is kept of them, and values that it refuses.
CAMERA = Camera((0, 0, 5), (0, 0, 0))
NUMBER = [float("nan"), float("inf"), "1", True, (1,), 10**400]
VECTOR = [(1, 2), ((1, 2), 3, 4), "1,2", "up", 5, (0, float("nan"), 0), [True, 1, 2]]
CASES = {
    "camera": ([(CAMERA, CAMERA)], ["front", np.eye(4)]),
    "side": ([("iso", "iso")], ["Front", "", 3, ("front",)]),
    "eye": ([([1, 2, 3], (1.0, 2.0, 3.0)), ("1,2,-3", (1.0, 2.0, -3.0)), (np.ones(3), (1.0,) * 3)], VECTOR),
    "up": ([("auto", "auto"), ("z", (0, 0, 1)), ("-y", (0, -1, 0)), ("0,0,2", (0, 0, 2))], ["w", *VECTOR]),
    "frame": ([("all", "all")], ["some", 1]),
    "fov": ([(90, 90.0), (np.float32(0.5), 0.5)], [0, 180, -1, *NUMBER]),
    "projection": (
        [("perspective", None), ("fisheye:220", Fisheye(220)), (Orthographic(2), Orthographic(2))],
        ["fisheye:", "sphere", 5, "panorama:3", "orthographic:-1"],
    ),
    "aperture": ([(0.5, 0.5)], [-1, *NUMBER]),
    "focus_distance": ([(3, 3.0), (None, None)], [0, *NUMBER]),
    "cut": ([("0,0,0;0,1,0", clbvh.Cut.plane((0, 0, 0), (0, 1, 0)))], ["w=1", "1,2,3", 5, "z=%", "0,0,0;0,0,0"]),
    "light": ([({"sky": (1, 1, 1)}, Light(sky=(1, 1, 1)))], [5, "above", {"moon": 1}]),
    "environment": ([("sky.hdr", clbvh.EnvironmentMap("sky.hdr"))], ["sky.png", 5, [[1]]]),
    "environment_rotation": ([(-720, -720.0)], NUMBER),
    "environment_strength": ([(0, 0.0)], [-1, 1e11, *NUMBER]),
    "shading": ([("lambert+shadow", "lambert+shadow")], ["phong", [], None]),
    "samples": ([(np.int64(7), 7), (None, None)], [0, 2**24 + 1, 1.5, "4", True]),
    "seed": ([(2**32 - 1, 2**32 - 1)], [-1, 2**32, 0.5]),
    "max_bounces": ([(0, 0)], [-1, 1001, None]),
    "smooth": ([(180, 180.0)], [-1, 181, *NUMBER]),
    "ground": ([(False, False), (None, None)], [1, "yes"]),
    "surface": ([((1, 0.5, 0), (1.0, 0.5, 0.0))], VECTOR),
    "wireframe": ([(True, Wireframe()), (False, None), ({"width": 2}, Wireframe(2))], [2, "thin"]),
    "width": ([(np.uint16(640), 640)], [0, 65_536, 10.5, "10", True, 1e9]),
    "height": ([(1, 1)], [0, 65_536, 10.5, "10", True, 1e9]),
    "exposure": ([(-2, -2.0)], [101, -101, *NUMBER]),
    "tone_curve": ([("linear", "linear"), (None, None)], ["aces", 1]),
    "clamp": ([(10, 10.0), (None, None)], [0, 1e31, *NUMBER]),
    "background": (
        [((1, 0.5, 0), ((1.0, 0.5, 0.0),) * 2), ("1,1,1;0,0,0", ((1.0,) * 3, (0.0,) * 3))],
        [0.5, ((0, 0, 0), (1, 1)), "black", [], (1, 2), {"top": 1}],
    ),
    "transparent": ([(True, True)], [None, 1, "yes"]),
    "light_direction": ([((0, 3, 4), (0.0, 3.0, 4.0)), (None, None)], [(0, 0, 0), *VECTOR]),
    "light_colour": ([("1,2,3", (1.0, 2.0, 3.0))], VECTOR),
    "light_sky": ([((0, 0, 0), (0.0,) * 3)], VECTOR),
    "light_ground": ([((0, 0, 0), (0.0,) * 3)], VECTOR),
    "wireframe_width": ([(1000, 1000.0)], [0, 1001, *NUMBER]),
    "wireframe_colour": ([((0, 1, 0.5), (0.0, 1.0, 0.5))], [(0, 0, 2), (-1, 0, 0), *VECTOR]),
}
CASES["look_at"] = CASES["eye"]
NEEDED = {"look_at": {"eye": (9, 9, 9)}}


def get(view, name):
    if hasattr(view, name):
        return getattr(view, name)
    group, _, member = name.partition("_")
    return getattr(getattr(view, group), member)


def test_every_setting_has_cases():
    assert set(CASES) == set(SETTINGS)


@pytest.mark.parametrize(
    ("name", "value", "kept"), [(name, *pair) for name in CASES for pair in CASES[name][0]], ids=str
)
def test_a_value_is_kept_in_one_form(name, value, kept):
    view = View().changed(**NEEDED.get(name, {}), **{name: value})
    assert get(view, name) == kept
    assert type(get(view, name)) is type(kept) or name == "up"
    assert pickle.loads(pickle.dumps(view)) == view
    assert hash(view) == hash(view.changed())


@pytest.mark.parametrize(("name", "value"), [(name, value) for name in CASES for value in CASES[name][1]], ids=str)
def test_a_value_out_of_range_is_refused(name, value):
    with pytest.raises(SceneError) as caught:
        View().changed(**NEEDED.get(name, {}), **{name: value})
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 300
    # A group and a text name what they are.
    assert name in message or name.split("_")[0] in message or "must be" in message


def test_a_name_that_is_no_setting_is_answered_with_the_nearest():
    for call in (View().changed, lambda **changes: clbvh.render("no such mesh.ply", **changes)):
        with pytest.raises(SceneError, match=r"no setting 'samples_count': did you mean 'samples'\?"):
            call(samples_count=3)
    with pytest.raises(SceneError, match="no setting 'zzz': there are camera, side, eye"):
        View().changed(zzz=1)


def test_one_way_to_choose_a_camera_takes_the_place_of_another():
    eye = View(eye=(1, 2, 3), look_at=(0, 0, 0))
    assert (eye.changed(side="top").eye, eye.changed(side="top").look_at) == (None, None)
    assert eye.changed(camera=CAMERA).eye is None
    assert View(side="top").changed(eye=(1, 2, 3)).side is None
    assert View(camera=CAMERA).changed(side="top").camera is None
    assert View(fov=50).changed(projection="panorama").fov == 35
    assert View(fov=50).changed(projection="perspective").fov == 50
    assert View(projection="panorama").changed(fov=50).projection is None


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"look_at": (0, 0, 0)}, "look_at needs an eye"),
        ({"side": "top", "eye": (0, 0, 9)}, "'top' and an eye were given"),
        ({"side": "top", "camera": CAMERA}, "'top' and a camera were given"),
        ({"projection": "panorama", "fov": 50}, "fov is that of a perspective camera"),
        ({"projection": "fisheye", "aperture": 0.1}, "no plane of focus"),
        ({"shading": "normal", "samples": 4}, "'normal' has one sample"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(settings, message):
    with pytest.raises(SceneError, match=message):
        View(**settings)


def test_the_size_is_that_of_the_lens():
    lens = Camera.from_intrinsics([[90, 0, 40], [0, 90, 30], [0, 0, 1]], np.eye(4), (80, 60))
    view = View(camera=lens)
    assert (view.width, view.height) == (80, 60)
    assert (view.changed(width=40).width, view.changed(width=40).height) == (40, 30)
    assert View(width=300).changed(camera=lens).width == 80
    with pytest.raises(SceneError, match="another aspect ratio"):
        view.changed(width=80, height=80)
    assert (View(width=300).width, View(width=300).height) == (300, 450)


def test_members_of_a_group_change_the_group():
    view = View(light=Light(sky=(1, 1, 1))).changed(light_direction=(0, 1, 0), wireframe_width=3)
    assert view.light == Light(direction=(0, 1, 0), sky=(1, 1, 1))
    assert view.wireframe == Wireframe(width=3)
    assert view.changed(wireframe_colour=(1, 0, 0)).wireframe == Wireframe(3, (1, 0, 0))
    assert view.changed(wireframe=False, wireframe_width=2).wireframe == Wireframe(2)


def test_plain_settings_are_those_that_differ():
    assert as_plain(View(light=Light(sky=(1, 1, 1)), samples=3)) == {
        "light": {"sky": (1.0, 1.0, 1.0)}, "samples": 3, "width": 800, "height": 450
    }  # fmt: skip


def test_something_that_is_nothing_to_draw_is_refused():
    with pytest.raises(SceneError, match="not 5"):
        clbvh.open_scene(5)
    with pytest.raises(MeshError, match=r"expected .*a clbvh\.Mesh, .*, not NoneType"):
        clbvh.render(None)
    with pytest.raises(MeshError, match="not by 5"):
        clbvh.load_mesh(5)
    for wrong in ({"view": {"width": 5}}, {"options": {"device": "cpu"}}):
        with pytest.raises(clbvh.ConfigError, match=f"{next(iter(wrong))} must be a clbvh"):
            clbvh.render("no such mesh.ply", **wrong)
    wanted = r"^view must be a clbvh\.View or None, not RenderOptions\(.{40,60}\.\.\.$"
    with pytest.raises(clbvh.ConfigError, match=wanted):
        clbvh.render("no such mesh.ply", clbvh.RenderOptions())
