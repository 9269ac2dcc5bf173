"""Pictures in the light of environments, against their answers by formula."""

import numpy as np
import pytest

import clbvh
from clbvh.rendering.environment_map import solid_angles

MATT = clbvh.Material(base_colour=(1, 1, 1), roughness=1.0, ior=1.0)
MIRROR = clbvh.Material(base_colour=(1, 1, 1), metallic=1.0, roughness=0.0)
SIZE = {"width": 48, "height": 32}
PLANE = ([[-50, 0, -50], [50, 0, -50], [50, 0, 50], [-50, 0, 50]], [[0, 2, 1], [0, 3, 2]])


def make_scene(shape, **settings):
    scene = clbvh.Scene()
    scene.place(scene.add(shape))
    return scene, clbvh.View(**{"shading": "path", "samples": 64, "up": "y", **SIZE, **settings})


def make_ball(material):
    return clbvh.Spheres([[0, 0, 0]], 1.0, materials=[material], material_ids=[0])


def make_plane(material=MATT):
    appearance = clbvh.Appearance(materials=(material,))
    return clbvh.Mesh.from_arrays(*PLANE, appearance=appearance)


def film_of(scene_and_view, **options):
    with clbvh.Renderer(*scene_and_view) as renderer:
        return renderer.render(keeps_film=True, **options).film[..., :3].astype(np.float64)


def test_a_white_ball_is_invisible_in_a_white_furnace():
    film = film_of(make_scene(make_ball(MATT), environment=np.ones((4, 8, 3)), max_bounces=50))
    np.testing.assert_allclose(film[:, 0], 1, rtol=1e-6)
    np.testing.assert_allclose(film.mean(axis=(0, 1)), 1, rtol=2e-3)
    np.testing.assert_allclose(film, 1, atol=0.15)


@pytest.mark.parametrize("rotation", [0, 90, 200])
def test_a_bright_pixel_lights_a_plane_by_formula(rotation):
    height, width, row, column, light = 64, 128, 10, 64, 500.0
    pixels = np.zeros((height, width, 3))
    pixels[row, column] = light * np.array([1, 0.5, 0.25])
    scene = make_scene(
        make_plane(), environment=pixels, environment_rotation=rotation, eye=(0, 5, 0.01), look_at=(0, 0, 0), fov=20
    )
    film = film_of(scene)
    angle = np.pi * (row + 0.5) / height
    # Of a white surface: irradiance over pi.
    expected = light * solid_angles(width, height)[row] * np.cos(angle) / np.pi
    np.testing.assert_allclose(film.mean(axis=(0, 1)), expected * np.array([1, 0.5, 0.25]), rtol=0.01)


@pytest.mark.parametrize("rotation", [0, 90, -45])
def test_rotation_turns_the_light(rotation):
    # A ball half of which is lit: the light comes along +x, turned counter-clockwise about +y.
    pixels = np.zeros((16, 32, 3))
    pixels[8, 16] = 100
    scene = make_scene(make_ball(MATT), environment=pixels, environment_rotation=rotation, samples=16, max_bounces=1)
    film = film_of(scene, camera=clbvh.Camera((0, 9, 0.001), (0, 0, 0), (0, 1, 0), 20))[..., 0]
    rows, columns = np.mgrid[: film.shape[0], : film.shape[1]]
    right = (film * (columns - (film.shape[1] - 1) / 2)).sum() / film.sum()
    above = (film * ((film.shape[0] - 1) / 2 - rows)).sum() / film.sum()
    # Seen from above with -z at the top, +x is to the right.
    assert np.degrees(np.arctan2(above, right)) == pytest.approx(rotation - 180 / 32, abs=3)


def quadrants():
    """A map whose four quarters, from left to right, are black, red, green and blue, with a white top."""
    pixels = np.zeros((64, 128, 3))
    for quarter in range(1, 4):
        pixels[:, 32 * quarter : 32 * (quarter + 1), quarter - 1] = 1
    pixels[:8] = 1
    return pixels


def test_a_panorama_camera_sees_the_map():
    # It looks along +x, where the middle of the map is: the picture is the map, upright and not mirrored.
    scene = make_scene(make_ball(MATT), environment=quadrants(), samples=4, width=128, height=64)
    camera = clbvh.Camera((0, 50, 0), (1, 50, 0), (0, 1, 0), projection=clbvh.Panorama())
    film = film_of(scene, camera=camera)
    inner = np.s_[10:50]
    for column in (10, 20, 40, 50, 75, 85, 105, 120):
        np.testing.assert_allclose(film[inner, column], quadrants()[inner, column], atol=1e-4)
    np.testing.assert_allclose(film[:6], 1, atol=1e-4)


def test_a_mirror_ball_shows_the_map_behind_the_camera():
    # Seen along -x from +x: the middle of the ball reflects +x, the boundary of red and green. To the picture's right
    # is -z, which is left of the middle in the map: red.
    scene = make_scene(make_ball(MIRROR), environment=quadrants(), eye=(9, 0, 0), look_at=(0, 0, 0), fov=15, samples=16)
    film = film_of(scene)
    red, green = film[16, 28], film[16, 20]
    assert red.argmax() == 0
    assert red[1] < 0.1 * red[0]
    assert green.argmax() == 1
    assert green[0] < 0.1 * green[1]
    # The normal halfway up reflects the zenith, which is white.
    upper = film[3:16, 26].min(axis=1)
    lower = film[17:29, 26].min(axis=1)
    assert upper.max() > 0.9
    assert lower.max() < 0.1


def test_black_environments_and_those_without_strength_are_black():
    for settings in (
        {"environment": np.zeros((2, 2, 3))},
        {"environment": np.ones((2, 2, 3)), "environment_strength": 0},
    ):
        assert not film_of(make_scene(make_ball(MATT), samples=2, **settings)).any()


def test_the_light_with_a_direction_shines_beside_the_environment():
    light = clbvh.Light(direction=(0, 1, 0), colour=(1, 1, 1))
    settings = {"eye": (0, 5, 0.01), "look_at": (0, 0, 0), "fov": 20}
    film = film_of(make_scene(make_plane(), environment=np.ones((2, 4, 3)), light=light, **settings))
    np.testing.assert_allclose(film.mean(axis=(0, 1)), 2, rtol=0.01)
    automatic = film_of(make_scene(make_plane(), environment=np.ones((2, 4, 3)), **settings))
    np.testing.assert_allclose(automatic.mean(axis=(0, 1)), 1, rtol=0.01)


def test_pictures_do_not_depend_on_bands_and_batches(monkeypatch):
    scene = make_scene(make_ball(MATT), environment=quadrants(), samples=5)
    with clbvh.Renderer(*scene) as renderer:
        whole = renderer.render(keeps_film=True)
        renderer._frames._band_pixels = 7 * SIZE["width"]
        parts = renderer.render(keeps_film=True)
        assert whole.film.tobytes() == parts.film.tobytes()
        assert whole.rgb.tobytes() == parts.rgb.tobytes()
        monkeypatch.setattr("clbvh.rendering.painters._LAUNCH_S", 0.0)
        assert renderer.render(keeps_film=True).film.tobytes() == whole.film.tobytes()


def test_an_environment_is_uploaded_once_and_can_change(monkeypatch):
    scene = make_scene(make_ball(MATT), environment=quadrants(), samples=1)
    with clbvh.Renderer(*scene) as renderer:
        first = renderer.render()
        white = {"environment": np.ones((2, 2, 3)), "environment_strength": 0.25}
        second = renderer.render(keeps_film=True, **white)
        renderer.render(environment_rotation=360.0)
        known = list(renderer._painters._known)
        assert sum(isinstance(key, clbvh.EnvironmentMap) for key in known) == 2
        assert sum(isinstance(key, tuple) and key[0] == "path" for key in known) == 1
    assert (first.rgb != second.rgb).any()
    np.testing.assert_allclose(second.film[0, :, :3], 0.25, rtol=1e-5)
