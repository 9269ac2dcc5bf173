"""Environments as settings of views: checks, equality, files."""

import pickle

import numpy as np
import pytest

import clbvh
from clbvh.errors import SceneError
from clbvh.rendering.environment_map import EnvironmentMap
from clbvh.rendering.image_files import write_exr

PIXELS = np.arange(24.0).reshape(2, 4, 3)


def write_map(path, pixels=PIXELS):
    with path.open("wb") as file:
        write_exr(file, {name: pixels[..., index].astype(np.float32) for index, name in enumerate("RGB")})
    return path


def test_an_array_is_copied():
    pixels = PIXELS.copy()
    view = clbvh.View(environment=pixels)
    pixels[:] = -1
    np.testing.assert_array_equal(view.environment.pixels, PIXELS.astype(np.float32))
    with pytest.raises(ValueError, match="read-only"):
        view.environment.pixels[0] = 1


def test_views_with_equal_environments_are_equal():
    first, second = clbvh.View(environment=PIXELS), clbvh.View(environment=PIXELS.tolist())
    assert first == second
    assert hash(first) == hash(second)
    assert first != clbvh.View(environment=PIXELS + 1)
    assert first != clbvh.View()
    assert first != clbvh.View(environment="map.exr")
    assert clbvh.View(environment="map.exr") == clbvh.View(environment="map.exr") != clbvh.View(environment="b.exr")
    assert first.changed(width=9).environment is first.environment
    assert pickle.loads(pickle.dumps(first)).environment == first.environment


def test_a_file_is_read_when_it_is_needed(tmp_path):
    environment = EnvironmentMap(tmp_path / "map.exr")
    assert repr(environment) == f"EnvironmentMap({str(tmp_path / 'map.exr')!r})"
    write_map(tmp_path / "map.exr")
    np.testing.assert_array_equal(environment.pixels, PIXELS)


def test_saved_scenes_hold_the_pixels(tmp_path):
    write_map(tmp_path / "map.exr")
    view = clbvh.View(environment=tmp_path / "map.exr", environment_rotation=30, environment_strength=2.5)
    clbvh.save_scene(tmp_path / "a.scene", clbvh.Scene(), view)
    (tmp_path / "map.exr").unlink()
    _, loaded = clbvh.open_scene(tmp_path / "a.scene")
    np.testing.assert_array_equal(loaded.environment.pixels, PIXELS)
    assert (loaded.environment_rotation, loaded.environment_strength) == (30, 2.5)


@pytest.mark.parametrize(
    ("value", "text"),
    [(-1.0, "green at row 1, column 2 is -1.0"), (np.nan, "column 2 is nan"), (np.inf, "is inf"), (1e21, "is 1e\\+21")],
)
def test_pixels_that_are_no_light_are_named(value, text):
    pixels = PIXELS.copy()
    pixels[1, 2, 1] = value
    with pytest.raises(SceneError, match=text):
        clbvh.View(environment=pixels)


def test_files_are_named_in_messages(tmp_path):
    write_map(tmp_path / "map.exr", np.full((1, 1, 3), 1e21))
    with pytest.raises(SceneError, match=r"map\.exr: the environment's light"):
        _ = EnvironmentMap(tmp_path / "map.exr").pixels


@pytest.mark.parametrize(
    "value",
    [7, [[1, 2], [3]], np.ones((2, 2)), np.ones((0, 2, 3)), np.ones((2, 2, 4)), np.ones((1, 1, 3), complex), "a.png"],
    ids=str,
)
def test_other_values_are_refused(value):
    with pytest.raises(SceneError, match="the environment must be"):
        clbvh.View(environment=value)


def test_maps_that_are_too_large_are_refused():
    with pytest.raises(SceneError, match="room for"):
        clbvh.View(environment=np.broadcast_to(np.float32(1), (1, 2**16 + 1, 3)))
    with pytest.raises(SceneError, match="room for"):
        clbvh.View(environment=np.broadcast_to(np.float32(1), (2**14, 2**14, 3)))


def test_a_scene_file_names_a_map_beside_it(tmp_path):
    write_map(tmp_path / "sky.exr")
    (tmp_path / "a.toml").write_text(
        '[[object]]\nshape = "icosphere"\n[view]\nenvironment = "sky.exr"\nenvironment_strength = 0.5\n'
    )
    _, view = clbvh.open_scene(tmp_path / "a.toml")
    np.testing.assert_array_equal(view.environment.pixels, PIXELS)
    assert view.environment_strength == 0.5
