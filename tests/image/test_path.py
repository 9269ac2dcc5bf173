"""Paths of light, of lamps and of environments: radiance that is known by a formula or by numerical integration."""

import pickle

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh import Appearance, Light, Material, Mesh, Renderer, Scene, SceneError, Spheres, View
from clbvh.rendering import frame
from clbvh.rendering.environment_tables import find_axes, make_environment_tables, solid_angles
from clbvh.rendering.kernel_view import _LIGHT_SPREAD

SIDE = 12  # pixels of most pictures
ERRORS = 5  # the widest difference in standard errors of the mean of all pixels
BLACK, WHITE = (0, 0, 0), (1, 1, 1)
SUN_WIDTH = 1 - 1 / np.hypot(1, _LIGHT_SPREAD)  # 1 - cos of half the angle of the sun


def matte(colour=WHITE, **changes):
    """A surface that scatters evenly, without a coat."""
    return Material(base_colour=colour, roughness=1, ior=1.0, **changes)


def lamp(emission, **changes):
    """A surface that shines and reflects nothing."""
    return Material(base_colour=BLACK, ior=1.0, emission=tuple(np.broadcast_to(emission, 3).tolist()), **changes)


def square(material, half=100, height=0.0):
    """In the plane y = height, around the y axis."""
    corners = [[-half, height, -half], [half, height, -half], [half, height, half], [-half, height, half]]
    return Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3]], appearance=Appearance(materials=(material,)))


def box(material, size):
    solid = trimesh.creation.box(size)
    return Mesh.from_arrays(solid.vertices, solid.faces, appearance=Appearance(materials=(material,)))


def make_scene(*shapes, **settings):
    scene = Scene()
    for shape in shapes:
        scene.place(scene.add(shape))
    view = clbvh.View(
        shading="path", light=Light(colour=BLACK), background=BLACK, width=SIDE, height=SIDE, samples=256,
        eye=(0, 0, 3), look_at=(0, 0, 0), fov=0.2, up="y",
    )  # fmt: skip
    return scene, view.changed(**settings)


def render_film(scene_and_view, **changes):
    with Renderer(*scene_and_view) as renderer:
        return renderer.render(keeps_film=True, **changes).film[..., :3].astype(np.float64)


def check_mean(film, expected, systematic=2e-4):
    """The mean of all pixels is `expected`, but for noise and a share for what numerical integration leaves."""
    pixels = film.reshape(-1, 3)
    noise = ERRORS * pixels.std(axis=0) / np.sqrt(len(pixels))
    np.testing.assert_array_less(np.abs(pixels.mean(axis=0) - expected), noise + systematic * np.max(expected))


def view_at(cosine, distance=5.0):
    """Settings of a camera that sees the origin of the plane y = 0 at an angle."""
    return {"eye": (distance * np.sqrt(1 - cosine**2), distance * cosine, 0.01), "look_at": (0, 0, 0)}


def fresnel(cosine, ior=1.5):
    inner = np.sqrt(1 - (1 - cosine**2) / ior**2)
    parallel, across = (ior * cosine - inner) / (ior * cosine + inner), (cosine - ior * inner) / (cosine + ior * inner)
    return (parallel**2 + across**2) / 2


def shadowing(cosine, alpha):
    return (np.sqrt(1 + alpha**2 * (1 / cosine**2 - 1)) - 1) / 2


def single_scattering(cosine, roughness, reflectance, count=1000):
    """The share of light that facets reflect once, out of one direction: an integral over the facets' normals."""
    alpha = roughness**2
    u, turn = np.meshgrid((np.arange(count) + 0.5) / count, 2 * np.pi * (np.arange(count) + 0.5) / count)
    # Facets weighted by their projected area: D cos = 1 / pi alpha^2 in the plane of slopes, drawn by its inverse.
    tangent = alpha * np.sqrt(u / (1 - u))
    z = 1 / np.sqrt(1 + tangent**2)
    towards = np.sqrt(1 - cosine**2) * z * tangent * np.cos(turn) + cosine * z
    light_z = 2 * towards * z - cosine
    seen = (towards > 0) & (light_z > 0)
    both = 1 / (1 + shadowing(cosine, alpha) + shadowing(np.where(seen, light_z, 1), alpha))
    return np.where(seen, reflectance(np.clip(towards, 0, 1)) * both * towards / (cosine * z), 0).mean()


@pytest.mark.parametrize("cosine", [0.95, 0.5, 0.15])
def test_furnace(cosine):
    """Background of 1 everywhere: a picture shows which share of light a surface reflects."""
    colour, facing = np.array([0.9, 0.5, 0.1]), 1 - fresnel(cosine)
    mirror = Material(base_colour=tuple(colour), metallic=1, roughness=0)
    glass = Material(base_colour=WHITE, roughness=0, transmission=1)
    rows = [(square(mirror), colour + (1 - colour) * (1 - cosine) ** 5), (box(glass, (40, 1, 40)), 1)]
    for roughness in (0.3, 1.0):
        coat = square(Material(base_colour=WHITE, roughness=roughness))
        metal = square(Material(base_colour=WHITE, metallic=1, roughness=roughness))
        rows.append((coat, facing + single_scattering(cosine, roughness, fresnel)))
        rows.append((metal, single_scattering(cosine, roughness, np.ones_like)))
    for shape, expected in rows:
        film = render_film(make_scene(shape, background=WHITE, max_bounces=50, **view_at(cosine)))
        check_mean(film, expected, 1e-3)
        assert film.mean() <= 1.001


def test_lamps_light_a_floor_by_their_configuration_factor():
    """The radiance of a diffuse floor is albedo / pi times the irradiance."""
    floor, near = square(matte(), 30), view_at(0.5, 1.2)
    faint = Spheres([[0, 0.3, -40]], 0.01, materials=(lamp((9, 0, 0)),))

    def factor(half):
        """Of a square at height 1: that of a corner of a parallel rectangle, four times."""
        slant = half / np.sqrt(1 + half**2)
        return 4 * slant * np.arctan(slant) / np.pi

    rows = [(square(lamp((3, 2, 1)), half, 1.0), factor(half) * np.array([3, 2, 1])) for half in (0.01, 0.5, 20.0)]
    # Half of the light of a thin lamp, and through it that of the background.
    rows.append((square(lamp(1, alpha=0.5), 0.5, 1.0), 0.5 * factor(0.5)))
    spheres = [(Spheres([[0, 1, 1]], size, materials=(lamp(5),)), 5 * size**2 / np.sqrt(8)) for size in (0.05, 0.9)]
    for shape, expected in rows + spheres:
        check_mean(render_film(make_scene(floor, shape, samples=1024, **near)), expected, 3e-3)
    # Lamps of instances have their material and size: twice as large, and with another one beside.
    placed = np.diag([2.0, 2.0, 2.0, 1.0])
    placed[1, 3] = 1
    for shape, share in ((Spheres([[0, 0, 0]], 0.1), 0.2**2), (square(matte(), 0.1), factor(0.2))):
        scene, view = make_scene(floor, faint, samples=1024, **view_at(0.5))
        scene.place(scene.add(shape), placed, material=lamp(5))
        check_mean(render_film((scene, view)), 5 * share, 2e-3)


def test_the_sun_on_a_floor_in_mirrors_and_on_the_ground():
    """A disk of directions around that of the light; its mean cosine to the middle is a little below 1."""
    colour = np.array([2, 1, 0.5])
    mean_cosine = 2 * (np.hypot(1, _LIGHT_SPREAD) - 1) / _LIGHT_SPREAD**2
    for height in (0.2, 1.0):
        sun = Light(direction=(1, height, 0), colour=tuple(colour))
        film = render_film(make_scene(square(matte()), light=sun, **view_at(0.5)))
        check_mean(film, colour * mean_cosine * height / np.hypot(1, height))
    clear = Material(transmission=1, ior=1.0, roughness=0, base_colour=WHITE)
    for surface, y in ((Material(base_colour=WHITE, metallic=1, roughness=0), 0.6), (clear, -0.6)):
        sun = Light(direction=(-0.8, y, 0), colour=tuple(colour))
        film = render_film(make_scene(square(surface), light=sun, samples=16, **view_at(0.6)))
        check_mean(film, colour / (2 * SUN_WIDTH), 1e-3)
    # A camera does not show it.
    assert not render_film(make_scene(Spheres([[0, 0, 9]], 0.1), light_direction=(0, 0, -1), samples=4)).any()


def test_each_bounce_in_a_closed_room():
    """Its walls emit e and reflect a: each bounce adds e a^n."""
    albedo, emission = np.array([0.8, 0.5, 0.2]), np.array([1, 2, 3])
    wall = matte(tuple(albedo), emission=tuple(emission))
    inside = {"eye": (0.1, 0.2, 0.3), "look_at": (1, 0.5, 0.4), "fov": 60, "samples": 128}
    for room in (Spheres([[0, 0, 0]], 1, materials=(wall,)), box(wall, (2, 2, 2))):
        with Renderer(*make_scene(room, **inside)) as renderer:
            for bounces in (0, 1, 2, 60):
                film = renderer.render(max_bounces=bounces, keeps_film=True).film[..., :3].astype(np.float64)
                check_mean(film, emission * sum(albedo**n for n in range(bounces + 1)), 1e-3)


def test_the_error_falls_with_the_root_of_the_samples_and_bits_do_not_depend_on_launches(monkeypatch):
    scene = make_scene(
        square(Material(base_colour=(0.7, 0.6, 0.5), roughness=0.4)), square(Material(emission=(4, 4, 4)), 0.5, 1.0),
        Spheres([[0.5, 0.2, 0]], 0.2, materials=(Material(transmission=1, roughness=0.2),)),
        background=(0.1, 0.2, 0.3), eye=(2, 0.7, 1.5), look_at=(0, 0.2, 0), fov=40, width=24, height=20,
    )  # fmt: skip
    exact = render_film(scene, seed=1, samples=4096)
    films = [render_film(scene, seed=2, samples=count) for count in (4, 64, 1024)]
    errors = [np.sqrt(((film - exact) ** 2).mean()) for film in films]
    assert errors[1] < errors[0] / 4 * 1.3
    assert errors[2] < errors[1] / 4 * 1.3
    # A limit never brightens.
    limited = render_film(scene, seed=2, samples=4, clamp=0.5)
    assert (limited <= films[0] + 1e-6).all()
    assert limited.max() <= 0.5 * (1 + 1e-5) < films[0].max()
    expected = render_film(scene, samples=9)
    for layout in ("bvh2", "bvh8"):
        with Renderer(*scene, clbvh.RenderOptions(layout=layout)) as renderer:
            film = renderer.render(samples=9, keeps_film=True).film[..., :3]
            np.testing.assert_array_equal(film, expected)
    monkeypatch.setattr(frame, "BAND_PIXELS", 7 * 24)
    np.testing.assert_array_equal(render_film(scene, samples=9, launch_s=0.0), expected)


def tent_share(edge):
    """The share of the tent filter of two pixels' width below an edge, in pixels from its centre."""
    edge = np.clip(edge, -1, 1)
    return np.where(edge < 0, (1 + edge) ** 2 / 2, 1 - (1 - edge) ** 2 / 2)


def test_each_sample_counts_for_the_pixels_around_it():
    """A lamp on the left of x = right and below y = top; pixels have a side of 1, the middle is 0."""
    columns, rows = np.arange(10) - 4.5, 3.5 - np.arange(8)
    for right, top in ((0.3, 50), (50, -1.25), (-4.9, 50), (1.5, 0.25), (50, 50)):
        corners = [[-50, -50, 0], [right, -50, 0], [right, top, 0], [-50, top, 0]]
        shape = Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3]], appearance=Appearance(materials=(lamp(1),)))
        flat = {"projection": clbvh.Orthographic(height=8), "width": 10, "height": 8, "max_bounces": 0, "fov": 35}
        with Renderer(*make_scene(shape, **flat)) as renderer:
            film = renderer.render(samples=4096, keeps_film=True).film[..., 0]
            expected = tent_share(right - columns) * tent_share(top - rows)[:, None]
            np.testing.assert_allclose(film, expected, rtol=0, atol=2e-3)
            few = renderer.render(samples=3, keeps_film=True)
            if right == top == 50:  # weights add up to the samples
                np.testing.assert_allclose(few.film[..., :3], 1, rtol=0, atol=1e-6)
            # Hits are those of the centres.
            centres = renderer.render(shading="lambert", samples=1).hits
            np.testing.assert_array_equal(few.hits.t, centres.t)


def test_every_value_is_a_number():
    hostile = [
        Material(metallic=1, roughness=0), Material(metallic=1, roughness=0.0317), Material(alpha=0, emission=WHITE),
        Material(base_colour=BLACK, metallic=1, roughness=0.5), Material(emission=(1e12,) * 3), lamp((1e-30, 0, 0)),
        Material(metallic=0.5, transmission=0.5, roughness=0.3), Material(transmission=1, ior=1.0, roughness=0),
        Material(transmission=1, ior=1.0, roughness=1), Material(transmission=1, ior=100, roughness=0.1), lamp(0),
    ]  # fmt: skip
    spheres = [Spheres([[i % 4, i // 4, 0.0]], 0.5, materials=(each,)) for i, each in enumerate(hostile)]
    place = {"eye": (1.5, 1, 7), "look_at": (1.5, 1, 0), "fov": 40, "width": 60, "height": 50}
    scene = make_scene(*spheres, square(matte()), background=WHITE, light_direction=(1, 2, 3), **place)
    for max_bounces in (0, 40):
        film = render_film(scene, samples=24, max_bounces=max_bounces)
        assert np.isfinite(film).all()
        assert film.min() >= 0
        assert film.max() >= 1e11


def plain_ball(triangles=1280, **material):
    shape = clbvh.make_shape("icosphere", triangles=triangles)
    materials = (Material(**material),) if material else ()
    return Mesh.from_arrays(shape.vertices, shape.faces, appearance=Appearance(materials=materials))


def test_light_that_nobody_has_chosen_is_that_of_studio():
    view = {"shading": "path", "samples": 32, "width": 96, "height": 64, "up": "y"}
    path, studio = clbvh.render(plain_ball(), **view), clbvh.render(plain_ball(), **view | {"shading": "studio"})
    values, expected = (picture.rgb[path.hits.is_hit].mean(axis=-1) for picture in (path, studio))
    assert abs(values.mean() - expected.mean()) < 10
    assert 0.8 < values.std() / expected.std() < 1.25
    np.testing.assert_allclose(path.rgb[:8, :8].astype(int), studio.rgb[:8, :8].astype(int), rtol=0, atol=1)
    # The ground shows the background but for the ball's shadow, away from the light.
    difference = path.rgb.astype(float) - clbvh.render(plain_ball(), **view, ground=False).rgb
    assert abs(difference[-12:, :12].mean()) < 6
    assert difference[-24:, 64:].min() < -60
    # A choice brings neither ground nor linear curve.
    rows = [
        {"light_colour": WHITE}, {"background": (0.2, 0.3, 0.4)}, {"environment": np.ones((4, 8, 3))},
        {"source": plain_ball(emission=(0.1, 0.1, 0.1))}, {"eye": (0, 0, 0.9), "look_at": (0, 0, 2)},
    ]  # fmt: skip
    for chosen in rows:
        picture = clbvh.render(**({"source": plain_ball()} | view | {"samples": 2} | chosen))
        chosen = {"source": plain_ball()} | view | {"samples": 2, "ground": False, "tone_curve": "filmic"} | chosen
        np.testing.assert_array_equal(picture.rgb, clbvh.render(**chosen).rgb)


@pytest.mark.on_both
def test_the_weekend_looks_as_it_did(session, compare_with_reference):
    scene, view = clbvh.open_scene("weekend")
    compare_with_reference("weekend", clbvh.render(scene, view, samples=16, width=96, height=54).rgb)


PIXELS = np.arange(24.0).reshape(2, 4, 3)
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
        (PIXELS - 1, "red at row 0, column 0 is -1.0"), ([[[0, np.nan, 1]]], "nan"), ([[[0, 1, 1e21]]], r"is 1e\+21"),
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


def film_of(source=None, **settings):
    """The film of a ball, or of something else, in an environment."""
    ball = Spheres([[0, 0, 0]], 1.0, materials=[matte()], material_ids=[0])
    view = View(shading="path", samples=64, up="y", width=48, height=32)
    with clbvh.Renderer(ball if source is None else source, view, **settings) as renderer:
        return renderer.render(keeps_film=True).film[..., :3].astype(np.float64)


def test_a_white_ball_is_invisible_in_a_white_furnace_and_black_in_the_dark():
    ball = clbvh.make_shape("icosphere", triangles=80)  # few triangles with smooth normals
    smooth = Mesh.from_arrays(ball.vertices, ball.faces, appearance=Appearance(materials=(matte(),)))
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
        film = film_of(source=square(matte(), 50), environment=pixels, environment_rotation=rotation, **FROM_ABOVE)
        np.testing.assert_allclose(film.mean(axis=(0, 1)), expected * np.array([1, 0.5, 0.25]), rtol=0.01)
    down = Light(direction=(0, 1, 0), colour=(1, 1, 1))
    for settings, expected in (({"light": down}, 2), ({}, 1)):
        film = film_of(source=square(matte(), 50), environment=np.ones((2, 4, 3)), **settings, **FROM_ABOVE)
        np.testing.assert_allclose(film.mean(axis=(0, 1)), expected, rtol=0.01)


def test_a_panorama_camera_sees_the_map():
    # Its four quarters, from left to right, are black, red, green and blue, with a white top.
    pixels = np.repeat([[[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]], 64, axis=0).repeat(32, axis=1)
    pixels[:8] = 1
    # It looks along +x, where the middle of the map is: the picture is the map, upright and not mirrored.
    camera = clbvh.Camera((0, 50, 0), (1, 50, 0), (0, 1, 0), projection=clbvh.Panorama())
    film = film_of(environment=pixels, samples=4, width=128, height=64, camera=camera)
    columns = [10, 20, 40, 50, 75, 85, 105, 120]
    np.testing.assert_allclose(film[10:50, columns], pixels[10:50, columns], atol=1e-4)
    np.testing.assert_allclose(film[:6], 1, atol=1e-4)
