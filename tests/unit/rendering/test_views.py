"""Settings of pictures: each is checked where it is declared, has the same name everywhere, and reaches the device."""

import pickle

import numpy as np
import pytest

import clbvh
from clbvh import Camera, Fisheye, Light, Mesh, Orthographic, SceneError, View, Wireframe
from clbvh.choices import SHADINGS
from clbvh.rendering.kernel_view import make_kernel_view
from clbvh.support.settings import list_settings

CAMERA = Camera((0, 0, 5), (0, 0, 0))
NUMBER = [float("nan"), float("inf"), "1", True, 10**400]
VECTOR = [(1, 2), "1,2", 5, (0, float("nan"), 0), [True, 1, 2]]
SIDE = [0, 65_536, 10.5, "10", True]

# For each setting values that it takes, with what is kept of them, and values that it refuses.
CASES = {
    "camera": ([(CAMERA, CAMERA)], ["front", np.eye(4)]),
    "side": ([("iso", "iso")], ["Front", "", ("front",)]),
    "eye": ([([1, 2, 3], (1.0, 2.0, 3.0)), ("1,2,-3", (1.0, 2.0, -3.0)), (np.ones(3), (1.0,) * 3)], VECTOR),
    "look_at": ([((0, 1, 0), (0.0, 1.0, 0.0))], VECTOR),
    "up": ([("auto", "auto"), ("+Z", (0, 0, 1)), ("-y", (0, -1, 0)), ("0,2,1", (0, 2, 1))], ["w", "--z", *VECTOR]),
    "frame": ([("all", "all")], ["some", 1]), "fov": ([(90, 90.0), (np.float32(0.5), 0.5)], [0, 180, *NUMBER]),
    "projection": (
        [("perspective", None), ("fisheye:220", Fisheye(220)), (Orthographic(2), Orthographic(2))],
        ["fisheye:", "sphere", 5, "panorama:3", "orthographic:-1", "fisheye:361", Fisheye],
    ),
    "aperture": ([(0.5, 0.5)], [-1, *NUMBER]), "focus_distance": ([(3, 3.0), (None, None)], [0, *NUMBER]),
    "cut": (
        [("0,0,0;0,1,0", clbvh.Cut.plane((0, 0, 0), (0, 1, 0)))],
        ["w=1", "1,2,3", 5, "z=%", "z=", "z=inf%", "1,2;3,4,5", "a,b,c;1,2,3", "nan,0,0;1,1,1", "box 1,1,1;0,0,0"],
    ),
    "light": ([({"sky": (1, 1, 1)}, Light(sky=(1, 1, 1)))], [5, "above", {"moon": 1}]),
    "light_direction": ([((0, 3, 4), (0.0, 3.0, 4.0)), (None, None)], [(0, 0, 0), *VECTOR]),
    "light_colour": ([("1,2,3", (1.0, 2.0, 3.0))], VECTOR), "light_sky": ([((0, 0, 0), (0.0,) * 3)], VECTOR),
    "light_ground": ([((0, 0, 0), (0.0,) * 3)], VECTOR),
    "environment": ([("sky.hdr", clbvh.EnvironmentMap("sky.hdr"))], ["sky.png", 5, [[1]]]),
    "environment_rotation": ([(-720, -720.0)], NUMBER), "environment_strength": ([(0, 0.0)], [-1, 1e11, *NUMBER]),
    "shading": ([("lambert+shadow", "lambert+shadow")], ["phong", [], None]),
    "noise": ([(0.03, 0.03), (0, 0.0)], [-0.1, 1.1, *NUMBER]),
    "denoise": ([(True, True)], [None, 1, "yes"]),
    "samples": ([(np.int64(7), 7), (None, None)], [0, 2**24 + 1, 1.5, "4", True]),
    "seed": ([(2**32 - 1, 2**32 - 1)], [-1, 2**32, 0.5]), "max_bounces": ([(0, 0)], [-1, 1001, None]),
    "smooth": ([(180, 180.0)], [-1, 181, *NUMBER]), "ground": ([(False, False), (None, None)], [1, "yes"]),
    "surface": ([((1, 0.5, 0), (1.0, 0.5, 0.0))], VECTOR),
    "wireframe": ([(True, Wireframe()), (False, None), ({"width": 2}, Wireframe(2))], [2, "thin"]),
    "wireframe_width": ([(1000, 1000.0)], [0, 1001, *NUMBER]),
    "wireframe_colour": ([((0, 1, 0.5), (0.0, 1.0, 0.5))], [(0, 0, 2), (-1, 0, 0), *VECTOR]),
    "section": ([({"hatch": 8}, clbvh.Section(hatch=8))], [5, "red", {"colours": 1}]),
    "section_fill": ([(False, False)], [None, 1]), "section_colour": ([((0, 1, 0.5), (0.0, 1.0, 0.5))], VECTOR),
    "section_hatch": ([(12, 12)], [-1, 1001, 0.5]),
    "width": ([(np.uint16(640), 640)], SIDE), "height": ([(1, 1)], SIDE),
    "exposure": ([(-2, -2.0)], [101, -101, *NUMBER]), "tone_curve": ([("linear", "linear"), (None, None)], ["aces", 1]),
    "clamp": ([(10, 10.0), (None, None)], [0, 1e31, *NUMBER]), "transparent": ([(True, True)], [None, 1, "yes"]),
    "background": (
        [((1, 0.5, 0), ((1.0, 0.5, 0.0),) * 2), ("1,1,1;0,0,0", ((1.0,) * 3, (0.0,) * 3))],
        [0.5, ((0, 0, 0), (1, 1)), "black", [], {"top": 1}],
    ),
}  # fmt: skip
NEEDED = {"look_at": {"eye": (9, 9, 9)}}


def test_each_setting_keeps_a_value_in_one_form_and_refuses_others():
    assert set(CASES) == {each.name for each in list_settings(View)}
    for name, (taken, refused) in CASES.items():
        for value, kept in taken:
            view = View().changed(**NEEDED.get(name, {}), **{name: value})
            group, _, member = name.partition("_")
            found = getattr(view, name) if hasattr(view, name) else getattr(getattr(view, group), member)
            assert found == kept, name
            assert type(found) is type(kept) or name == "up"
            assert pickle.loads(pickle.dumps(view)) == view
            assert hash(view) == hash(view.changed())
        for value in refused:
            with pytest.raises(SceneError) as caught:
                pytest.fail(str(View().changed(**NEEDED.get(name, {}), **{name: value})))
            # A group and a text name what they are.
            words = name, name.split("_")[0], "must be"
            assert any(word in str(caught.value) for word in words), caught.value
            assert len(str(caught.value)) < 300


def test_the_default_samples_and_curve_depend_on_the_shading():
    found = {shading: (View(shading=shading).sample_count, View(shading=shading).curve) for shading in SHADINGS}
    expected = {"studio": (16, "linear"), "ao": (16, "linear"), "path": (64, "filmic"), "albedo": (16, "linear")}
    assert found == {shading: expected.get(shading, (1, "linear")) for shading in SHADINGS}


def test_one_way_to_choose_a_camera_takes_the_place_of_another():
    eye = View(eye=(1, 2, 3), look_at=(0, 0, 0))
    assert (eye.changed(side="top").eye, eye.changed(side="top").look_at) == (None, None)
    assert eye.changed(camera=CAMERA).eye is None
    assert View(side="top").changed(eye=(1, 2, 3)).side is None
    assert View(camera=CAMERA).changed(side="top").camera is None
    assert View(fov=50).changed(projection="panorama").fov == 35
    assert View(fov=50).changed(projection="perspective").fov == 50
    assert View(projection="panorama").changed(fov=50).projection is None


def test_settings_that_contradict_each_other_are_refused():
    rows = [
        ({"look_at": (0, 0, 0)}, "needs an eye"), ({"side": "top", "camera": CAMERA}, "and a camera"),
        ({"projection": "fisheye", "aperture": 0.1}, "no plane of focus"),
        ({"shading": "normal", "samples": 4}, "'normal' has one sample"),
    ]  # fmt: skip
    for settings, words in rows:
        with pytest.raises(SceneError, match=words):
            View(**settings)


def test_the_device_has_the_view_in_local_coordinates():
    mesh = Mesh.from_arrays(np.array([[0, 0, 0], [4, 0, 0], [0, 2, 6.0]]) + 1e6, [[0, 1, 2]])
    camera = Camera((1e6 + 2, 1e6 + 1, 1e6 + 13), (1e6 + 2, 1e6 + 1, 1e6 + 3), fov=90)
    settings = View(width=200, height=100, up=(0, 0, 2))
    view = make_kernel_view(settings, camera, mesh)[0]
    assert mesh.scale == 0.25
    assert (view["depth_near"], view["depth_far"]) == (7 / 4, 13 / 4)
    # The automatic light comes from the viewer's left, from above and from behind.
    assert np.linalg.norm(view["to_light"]) == pytest.approx(1)
    assert (np.sign(view["to_light"]) == [-1, 1, 1]).all()
    # The principal point is 60 columns to the left of the middle, and 25 rows below it.
    lens = Camera.from_intrinsics([[50, 10, 40], [0, 25, 75], [0, 0, 1]], camera.camera_to_world(), (200, 100))
    of_lens = make_kernel_view(settings.changed(light_direction=(0, 3, 4)), lens, mesh)[0]
    assert np.allclose(of_lens["to_light"], [0, 0.6, 0.8])
    expected = {"eye": (0, 0, 2.5), "optical_axis": (0, 0, -1), "right": (2, 0, 0)}
    # The sky of a lens is the scene's, that of a camera its own.
    plain = {"forward": (0, 0, -1), "up": (0, 1, 0), "to_sky": (0, 1, 0)}
    skewed = {"forward": (60 / 50 + 10 / 50, 1, -1), "up": (2 * 10 / 50, 2, 0), "to_sky": (0, 0, 1)}
    for found, rows in ((view, expected | plain), (of_lens, expected | skewed)):
        for name, values in rows.items():
            assert np.allclose(found[name], values), name


def test_depths_of_a_flat_mesh_are_a_range_and_an_eye_beyond_float32_is_refused():
    flat = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    view = make_kernel_view(View(up="y"), CAMERA, flat)
    assert view["depth_near"] < view["depth_far"]
    assert np.isfinite(make_kernel_view(View(up="y"), Camera((1e28, 0, 0), (0, 0, 0)), flat)["eye"]).all()
    for distance in (1e35, 1.7e308):
        with pytest.raises(SceneError, match="sizes of the mesh away"):
            make_kernel_view(View(up="y"), Camera((distance, 0, 0), (0, 0, 0)), flat)
