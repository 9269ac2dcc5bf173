"""Environments: maps as settings, their tables, and pictures in their light, against answers by formula."""

import pickle

import numpy as np
import pytest

import clbvh
from clbvh import Appearance, Material, Mesh, SceneError, Spheres, View
from clbvh.rendering.environment_map import find_axes, make_environment_tables, solid_angles

PIXELS = np.arange(24.0).reshape(2, 4, 3)
MATT = Material(base_colour=(1, 1, 1), roughness=1.0, ior=1.0)
MIRROR = Material(base_colour=(1, 1, 1), metallic=1.0, roughness=0.0)
FROM_ABOVE = {"eye": (0, 5, 0.01), "look_at": (0, 0, 0), "fov": 20}


def test_a_map_is_a_value_that_is_copied():
    pixels = PIXELS.copy()
    view = View(environment=pixels)
    pixels[:] = -1
    np.testing.assert_array_equal(view.environment.pixels, PIXELS.astype(np.float32))
    assert view == View(environment=PIXELS.tolist()) != View(environment=PIXELS + 1)
    assert hash(view) == hash(View(environment=PIXELS))
    assert pickle.loads(pickle.dumps(view)) == view


def test_pixels_that_are_no_light_are_refused():
    rows = [
        (PIXELS - 1, "red at row 0, column 0 is -1.0"), ([[[0, np.nan, 1]]], "is nan"), ([[[0, 1, 1e21]]], r"is 1e\+21"),
        ([[1, 2], [3]], "must be"), (np.ones((0, 2, 3)), "must be"), (np.ones((1, 1, 3), complex), "must be"),
        (np.broadcast_to(np.float32(1), (2**14, 2**14, 3)), "room for"),
    ]  # fmt: skip
    for value, words in rows:
        with pytest.raises(SceneError, match=words):
            View(environment=value)


def test_tables_draw_pixels_by_their_light_and_that_of_their_neighbours():
    for width, height in ((1, 1), (1024, 512), (3, 65536)):
        assert width * solid_angles(width, height).sum() == pytest.approx(4 * np.pi, rel=1e-12)
    pixels = np.zeros((6, 8, 3), np.float32)
    pixels[2, 0] = 1  # beside the seam
    arrays = make_environment_tables(pixels).arrays
    weights = np.array([0, 1, 6, 1, 0, 0]) * solid_angles(8, 6)
    np.testing.assert_allclose(np.diff(arrays["environment_rows"], prepend=0), weights / weights.sum(), atol=1e-7)
    columns = np.diff(arrays["environment_columns"], prepend=0)
    np.testing.assert_allclose(columns[2], np.array([6, 1, 0, 0, 0, 0, 0, 1]) / 8, atol=1e-7)
    assert (arrays["environment_columns"][:, -1] == 1).all()
    assert make_environment_tables(np.zeros((3, 4, 3), np.float32)).arrays == {}


def test_the_middle_is_along_x_and_turns_counter_clockwise_from_above():
    rows = [
        ((0, 1, 0), 0, (1, 0, 0), (0, 0, 1)), ((0, 0, 1), 0, (1, 0, 0), (0, -1, 0)),
        ((1, 0, 0), 0, (0, 1, 0), (0, 0, -1)), ((0, 0, 1), 90, (0, 1, 0), (1, 0, 0)),
    ]  # fmt: skip
    for up, degrees, front, right in rows:
        np.testing.assert_allclose(find_axes(np.array(up, float), degrees), [front, right], atol=1e-15)


def film_of(material=MATT, source=None, **settings):
    """The film of a ball, or of something else, in an environment."""
    ball = Spheres([[0, 0, 0]], 1.0, materials=[material], material_ids=[0])
    view = View(shading="path", samples=64, up="y", width=48, height=32)
    with clbvh.Renderer(ball if source is None else source, view, **settings) as renderer:
        return renderer.render(keeps_film=True).film[..., :3].astype(np.float64)


PLANE = Mesh.from_arrays(
    [[-50, 0, -50], [50, 0, -50], [50, 0, 50], [-50, 0, 50]], [[0, 2, 1], [0, 3, 2]],
    appearance=Appearance(materials=(MATT,)),
)  # fmt: skip


def test_a_white_ball_is_invisible_in_a_white_furnace_and_black_in_the_dark():
    ball = clbvh.make_shape("icosphere", triangles=80)  # few triangles with smooth normals
    smooth = Mesh.from_arrays(ball.vertices, ball.faces, appearance=Appearance(materials=(MATT,)))
    for source in (None, smooth):
        film = film_of(source=source, environment=np.ones((4, 8, 3)), max_bounces=50)
        np.testing.assert_allclose(film.mean(axis=(0, 1)), 1, rtol=2e-3)
    assert not film_of(environment=np.zeros((2, 2, 3)), samples=2).any()
    assert not film_of(environment=np.ones((2, 2, 3)), environment_strength=0, samples=2).any()


def test_a_bright_pixel_and_a_light_beside_the_map_light_a_plane_by_formula():
    height, width, row, light = 64, 128, 10, 500.0
    pixels = np.zeros((height, width, 3))
    pixels[row, 64] = light * np.array([1, 0.5, 0.25])
    # Of a white surface: irradiance over pi.
    expected = light * solid_angles(width, height)[row] * np.cos(np.pi * (row + 0.5) / height) / np.pi
    for rotation in (0, 200):
        film = film_of(source=PLANE, environment=pixels, environment_rotation=rotation, **FROM_ABOVE)
        np.testing.assert_allclose(film.mean(axis=(0, 1)), expected * np.array([1, 0.5, 0.25]), rtol=0.01)
    down = clbvh.Light(direction=(0, 1, 0), colour=(1, 1, 1))
    for settings, expected in (({"light": down}, 2), ({}, 1)):
        film = film_of(source=PLANE, environment=np.ones((2, 4, 3)), **settings, **FROM_ABOVE)
        np.testing.assert_allclose(film.mean(axis=(0, 1)), expected, rtol=0.01)


def quadrants():
    """A map whose four quarters, from left to right, are black, red, green and blue, with a white top."""
    pixels = np.zeros((64, 128, 3))
    for quarter in range(1, 4):
        pixels[:, 32 * quarter : 32 * (quarter + 1), quarter - 1] = 1
    pixels[:8] = 1
    return pixels


def test_a_panorama_camera_sees_the_map_and_a_mirror_what_is_behind_the_camera():
    # It looks along +x, where the middle of the map is: the picture is the map, upright and not mirrored.
    camera = clbvh.Camera((0, 50, 0), (1, 50, 0), (0, 1, 0), projection=clbvh.Panorama())
    film = film_of(environment=quadrants(), samples=4, width=128, height=64, camera=camera)
    columns = [10, 20, 40, 50, 75, 85, 105, 120]
    np.testing.assert_allclose(film[10:50, columns], quadrants()[10:50, columns], atol=1e-4)
    np.testing.assert_allclose(film[:6], 1, atol=1e-4)
    # Seen along -x from +x: the middle of the ball reflects +x, the boundary of red and green. To the picture's right
    # is -z, which is left of the middle in the map: red.
    film = film_of(MIRROR, environment=quadrants(), eye=(9, 0, 0), look_at=(0, 0, 0), fov=15, samples=16)
    assert film[16, [28, 20]].argmax(axis=1).tolist() == [0, 1]
