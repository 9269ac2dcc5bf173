"""Paths of light: scenes whose radiance is known by a formula or by numerical integration."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh import Appearance, Light, Material, Mesh, Renderer, Scene, Spheres
from clbvh.rendering import painters as painters_module
from clbvh.rendering.kernel_view import _LIGHT_SPREAD

# Pixels a side of most pictures, and the widest difference in standard errors of the mean of all pixels.
SIDE = 12
ERRORS = 5
ROUNDING = 2e-4

BLACK, WHITE = (0, 0, 0), (1, 1, 1)


def matte(colour=WHITE, **changes):
    """A surface that scatters evenly, without a coat."""
    return Material(base_colour=colour, roughness=1, ior=1.0, **changes)


def quad(corners, material):
    faces = [[0, 1, 2], [0, 2, 3]]
    return Mesh.from_arrays(corners, faces, appearance=Appearance(materials=(material,)))


def floor(material, half=100):
    """A square in the plane y = 0 around the origin."""
    return quad([[-half, 0, -half], [half, 0, -half], [half, 0, half], [-half, 0, half]], material)


def panel(material, half, height):
    return quad([[-half, height, -half], [half, height, -half], [half, height, half], [-half, height, half]], material)


def make_scene(*shapes, **settings):
    defaults = {
        "shading": "path", "light": Light(colour=BLACK), "background": BLACK, "width": SIDE, "height": SIDE,
        "samples": 256, "eye": (0, 0, 3), "look_at": (0, 0, 0), "fov": 0.2,
    }  # fmt: skip
    scene = Scene()
    for shape in shapes:
        scene.place(scene.add(shape))
    return scene, clbvh.View(up="y").changed(**defaults | settings)


def render_film(scene_and_view, **changes):
    with Renderer(*scene_and_view) as renderer:
        return renderer.render(keeps_film=True, **changes).film[..., :3].astype(np.float64)


def check_mean(film, expected, systematic=ROUNDING):
    """The mean of all pixels is `expected`, but for noise and a share for what numerical integration leaves."""
    pixels = film.reshape(-1, 3)
    noise = ERRORS * pixels.std(axis=0) / np.sqrt(len(pixels))
    np.testing.assert_array_less(np.abs(pixels.mean(axis=0) - expected), noise + systematic * np.max(expected))


def view_at(cosine, distance=5.0):
    """Settings of a camera that sees the origin of the plane y = 0 at an angle."""
    sine = np.sqrt(1 - cosine**2)
    return {"eye": (distance * sine, distance * cosine, 0.01), "look_at": (0, 0, 0)}


def fresnel(cosine, ior):
    inner = np.sqrt(1 - (1 - cosine**2) / ior**2)
    parallel, across = (ior * cosine - inner) / (ior * cosine + inner), (cosine - ior * inner) / (cosine + ior * inner)
    return (parallel**2 + across**2) / 2


def single_scattering(cosine, roughness, reflectance, count=1000):
    """The share of light that facets reflect once, out of one direction: an integral over the facets' normals."""
    alpha = roughness**2
    u, turn = (np.arange(count) + 0.5) / count, 2 * np.pi * (np.arange(count) + 0.5) / count
    u, turn = np.meshgrid(u, turn)
    # Facets weighted by their projected area: D cos = 1 / pi alpha^2 in the plane of slopes, drawn by its inverse.
    tangent = alpha * np.sqrt(u / (1 - u))
    z = 1 / np.sqrt(1 + tangent**2)
    x = z * tangent * np.cos(turn)
    towards = np.sqrt(1 - cosine**2) * x + cosine * z
    light_z = 2 * towards * z - cosine
    seen = (towards > 0) & (light_z > 0)

    def shadowing(cosine):
        return (np.sqrt(1 + alpha**2 * (1 - cosine**2) / cosine**2) - 1) / 2

    both = 1 / (1 + shadowing(cosine) + shadowing(np.where(seen, light_z, 1)))
    values = reflectance(np.clip(towards, 0, 1)) * both * towards / (cosine * z)
    return np.where(seen, values, 0).mean()


class TestFurnace:
    """Background of 1 everywhere: a picture shows which share of light a surface reflects."""

    def test_a_white_sphere_cannot_be_seen(self):
        scene = make_scene(Spheres([[0, 0, 0]], 1, materials=(matte(),)), background=WHITE, fov=60)
        film = render_film(scene, samples=64)
        np.testing.assert_allclose(film, 1, rtol=2e-5)

    @pytest.mark.parametrize("cosine", [0.95, 0.5, 0.15])
    @pytest.mark.parametrize("roughness", [0.0, 0.3, 1.0])
    def test_a_coated_floor(self, roughness, cosine):
        coat = Material(base_colour=WHITE, roughness=roughness)
        film = render_film(make_scene(floor(coat), background=WHITE, **view_at(cosine)))
        smooth = fresnel(cosine, 1.5)
        coated = smooth if roughness == 0 else single_scattering(cosine, roughness, lambda each: fresnel(each, 1.5))
        check_mean(film, 1 - smooth + coated, 1e-3)
        assert film.mean() <= 1.001

    @pytest.mark.parametrize("cosine", [0.95, 0.5, 0.15])
    @pytest.mark.parametrize("roughness", [0.2, 0.6, 1.0])
    def test_a_rough_metal_loses_what_facets_reflect_twice(self, roughness, cosine):
        metal = Material(base_colour=WHITE, metallic=1, roughness=roughness)
        film = render_film(make_scene(floor(metal), background=WHITE, **view_at(cosine)))
        check_mean(film, single_scattering(cosine, roughness, np.ones_like), 1e-3)

    @pytest.mark.parametrize("cosine", [1.0, 0.6, 0.2])
    def test_a_mirror_has_its_colour(self, cosine):
        colour = np.array([0.9, 0.5, 0.1])
        mirror = Material(base_colour=tuple(colour), metallic=1, roughness=0)
        film = render_film(make_scene(floor(mirror), background=WHITE, **view_at(cosine)), samples=16)
        np.testing.assert_allclose(film.mean(axis=(0, 1)), colour + (1 - colour) * (1 - cosine) ** 5, rtol=1e-3)

    @pytest.mark.parametrize("ior", [1.0, 1.5, 2.4])
    def test_a_slab_of_glass_loses_nothing(self, ior):
        glass = Material(base_colour=WHITE, roughness=0, transmission=1, ior=ior)
        box = trimesh.creation.box((4, 1, 4))
        slab = Mesh.from_arrays(box.vertices, box.faces, appearance=Appearance(materials=(glass,)))
        film = render_film(make_scene(slab, background=WHITE, max_bounces=50, **view_at(0.6)))
        check_mean(film, 1, 1e-3)


class TestEmitters:
    """Diffuse floors below lamps that reflect nothing: the radiance is albedo / pi times the irradiance."""

    @pytest.mark.parametrize("half", [0.01, 0.5, 20.0])
    def test_a_square(self, half):
        lamp = Material(base_colour=BLACK, ior=1.0, emission=(3, 2, 1))
        film = render_film(make_scene(floor(matte((0.5, 0.5, 0.5)), 30), panel(lamp, half, 1.0), **view_at(0.5, 1.2)))
        # The configuration factor of a corner of a parallel rectangle, four times.
        slant = half / np.sqrt(1 + half**2)
        factor = 4 * 2 * slant * np.arctan(slant) / (2 * np.pi)
        check_mean(film, 0.5 * factor * np.array([3, 2, 1]), 2e-3)

    @pytest.mark.parametrize("radius", [0.05, 0.9])
    def test_a_sphere(self, radius):
        at = np.array([0, 1.0, 1.0])
        lamp = Spheres([at], radius, materials=(Material(base_colour=BLACK, ior=1.0, emission=(5, 5, 5)),))
        film = render_film(make_scene(floor(matte(), 30), lamp, samples=1024, **view_at(0.5)))
        distance = np.linalg.norm(at)
        check_mean(film, 5 * (radius / distance) ** 2 * at[1] / distance, 2e-3)

    @pytest.mark.parametrize("kind", ["sphere", "square"])
    def test_a_lamp_of_an_instance(self, kind):
        """Lamps have the material and the size of their instance: twice as large, and with another one beside."""
        lamp = Material(base_colour=BLACK, ior=1.0, emission=(5, 5, 5))
        faint = Spheres([[0, 0.3, -40]], 0.01, materials=(Material(base_colour=BLACK, ior=1.0, emission=(9, 0, 0)),))
        shape = Spheres([[0, 0, 0]], 0.1) if kind == "sphere" else panel(matte(), 0.1, 0)
        scene, view = make_scene(floor(matte(), 30), faint, samples=1024, **view_at(0.5))
        transform = np.diag([2.0, 2.0, 2.0, 1.0])
        transform[:3, 3] = 0, 1, 0
        scene.place(scene.add(shape), transform, material=lamp)
        slant = 0.2 / np.sqrt(1.04)
        share = 0.2**2 if kind == "sphere" else 4 * slant * np.arctan(slant) / np.pi
        check_mean(render_film((scene, view)), 5 * share, 2e-3)

    @pytest.mark.parametrize("height", [0.2, 1.0])
    def test_the_sun(self, height):
        """A disk of directions around that of the light; its mean cosine to the middle is a little below 1."""
        sun = Light(direction=(1, height, 0), colour=(2, 1, 0.5))
        film = render_film(make_scene(floor(matte()), light=sun, **view_at(0.5)))
        mean_cosine = 2 * (np.sqrt(1 + _LIGHT_SPREAD**2) - 1) / _LIGHT_SPREAD**2
        check_mean(film, np.array([2, 1, 0.5]) * mean_cosine * height / np.sqrt(1 + height**2))

    def test_a_lamp_over_a_rough_metal(self):
        """Light that is drawn and light that is found add up: an integral over the lamp."""
        roughness, cosine, half = 0.5, 0.6, 0.7
        lamp = Material(base_colour=BLACK, ior=1.0, emission=WHITE)
        metal = Material(base_colour=WHITE, metallic=1, roughness=roughness)
        scene = make_scene(floor(metal, 30), panel(lamp, half, 1.0), samples=512, **view_at(cosine, 1.2))
        count = 400
        place = half * ((2 * np.arange(count) + 1) / count - 1)
        x, z = np.meshgrid(place, place)
        squared = x**2 + 1 + z**2
        to_light = np.stack([x, np.ones_like(x), z], axis=-1) / np.sqrt(squared)[..., None]
        to_eye = np.array([np.sqrt(1 - cosine**2), cosine, 0])
        facet = to_light + to_eye
        facet /= np.linalg.norm(facet, axis=-1, keepdims=True)
        alpha = roughness**2
        density = alpha**2 / np.pi / (1 + facet[..., 1] ** 2 * (alpha**2 - 1)) ** 2

        def shadowing(level):
            return (np.sqrt(1 + alpha**2 * (1 / level**2 - 1)) - 1) / 2

        light_y = to_light[..., 1]
        value = density / (4 * cosine * light_y * (1 + shadowing(cosine) + shadowing(light_y)))
        expected = (value * light_y * light_y / squared).sum() * (2 * half / count) ** 2
        check_mean(render_film(scene), expected, 3e-3)

    def test_a_lamp_that_is_half_there(self):
        """Half of the light of a thin lamp, and through it that of the background."""
        lamp = Material(base_colour=BLACK, ior=1.0, emission=WHITE, alpha=0.5)
        film = render_film(make_scene(floor(matte(), 30), panel(lamp, 0.5, 1.0), samples=1024, **view_at(0.5, 1.2)))
        slant = 0.5 / np.sqrt(1.25)
        check_mean(film, 0.5 * 4 * slant * np.arctan(slant) / np.pi, 3e-3)


class TestRooms:
    """Closed rooms whose walls emit e and reflect a: each bounce adds e a^n."""

    ROOM = matte((0.8, 0.5, 0.2), emission=(1, 2, 3))

    @pytest.mark.parametrize("kind", ["sphere", "box"])
    @pytest.mark.parametrize("bounces", [0, 1, 2, 5, 60])
    def test_each_bounce(self, kind, bounces):
        if kind == "sphere":
            room = Spheres([[0, 0, 0]], 1, materials=(self.ROOM,))
        else:
            box = trimesh.creation.box((2, 2, 2))
            room = Mesh.from_arrays(box.vertices, box.faces, appearance=Appearance(materials=(self.ROOM,)))
        scene = make_scene(room, eye=(0.1, 0.2, 0.3), look_at=(1, 0.5, 0.4), fov=60, max_bounces=bounces)
        albedo, emission = np.array([0.8, 0.5, 0.2]), np.array([1, 2, 3])
        expected = emission * sum(albedo**n for n in range(bounces + 1))
        check_mean(render_film(scene, samples=128), expected, 1e-3)


class TestSamples:
    SCENE = make_scene(
        floor(Material(base_colour=(0.7, 0.6, 0.5), roughness=0.4)),
        panel(Material(emission=(4, 4, 4)), 0.5, 1.0),
        Spheres([[0.5, 0.2, 0]], 0.2, materials=(Material(transmission=1, roughness=0.2),)),
        background=(0.1, 0.2, 0.3), eye=(2, 0.7, 1.5), look_at=(0, 0.2, 0), fov=40, width=24, height=20,
    )  # fmt: skip

    def test_the_error_falls_with_the_root_of_the_samples(self):
        exact = render_film(self.SCENE, seed=1, samples=4096)
        films = [render_film(self.SCENE, seed=2, samples=count) for count in (4, 64, 1024)]
        errors = [np.sqrt(((film - exact) ** 2).mean()) for film in films]
        assert errors[1] < errors[0] / 4 * 1.3
        assert errors[2] < errors[1] / 4 * 1.3

    def test_bits_are_equal_for_batches_and_bands(self, monkeypatch):
        expected = render_film(self.SCENE, samples=9)
        monkeypatch.setattr(painters_module, "_LAUNCH_S", 0.0)
        np.testing.assert_array_equal(render_film(self.SCENE, samples=9), expected)
        monkeypatch.setattr(painters_module, "BAND_PIXELS", 7 * 24)
        np.testing.assert_array_equal(render_film(self.SCENE, samples=9), expected)

    @pytest.mark.parametrize("layout", ["bvh2", "bvh4", "bvh8"])
    def test_bits_are_equal_for_layouts(self, layout):
        with Renderer(*self.SCENE) as renderer:
            expected = renderer.render(samples=5, keeps_film=True).film
        with Renderer(*self.SCENE, options=clbvh.RenderOptions(layout=layout)) as renderer:
            np.testing.assert_array_equal(renderer.render(samples=5, keeps_film=True).film, expected)


def tent_share(edge):
    """The share of the tent filter of two pixels' width below an edge, in pixels from its centre."""
    edge = np.clip(edge, -1, 1)
    return np.where(edge < 0, (1 + edge) ** 2 / 2, 1 - (1 - edge) ** 2 / 2)


class TestFilm:
    """Each sample counts for the pixels around it: a lamp alone, seen without perspective."""

    LAMP = Material(base_colour=BLACK, ior=1.0, emission=WHITE)

    def scene(self, right, top, **changes):
        """A lamp on the left of x = right and below y = top; pixels have a side of 1, the middle is 0."""
        corners = [[-50, -50, 0], [right, -50, 0], [right, top, 0], [-50, top, 0]]
        settings = {"projection": clbvh.Orthographic(height=8), "fov": 35, "width": 10, "height": 8, "max_bounces": 0}
        return make_scene(quad(corners, self.LAMP), **(settings | changes))

    @pytest.mark.parametrize("samples", [1, 2, 3, 7, 64])
    def test_weights_add_up_to_the_samples(self, samples):
        film = render_film(self.scene(50, 50), samples=samples)
        np.testing.assert_allclose(film, 1, rtol=0, atol=1e-6)

    @pytest.mark.parametrize(("right", "top"), [(0.3, 50), (50, -1.25), (-4.9, 50), (1.5, 0.25)])
    def test_edges_are_filtered(self, right, top):
        film = render_film(self.scene(right, top), samples=4096)[..., 0]
        columns, rows = np.arange(10) - 4.5, 3.5 - np.arange(8)
        expected = tent_share(right - columns) * tent_share(top - rows)[:, None]
        np.testing.assert_allclose(film, expected, rtol=0, atol=2e-3)

    @pytest.mark.parametrize("samples", [1, 5])
    def test_hits_are_those_of_the_centres(self, samples):
        with Renderer(*self.scene(0.3, 1.2)) as renderer:
            hits = renderer.render(samples=samples).hits
            expected = renderer.render(shading="lambert", samples=1).hits
        np.testing.assert_array_equal(hits.prim_id, expected.prim_id)
        np.testing.assert_array_equal(hits.t, expected.t)


HOSTILE = {
    "mirror": Material(metallic=1, roughness=0),
    "nearly-mirror": Material(metallic=1, roughness=0.0317),
    "black-metal": Material(base_colour=BLACK, metallic=1, roughness=0.5),
    "metal-and-glass": Material(metallic=0.5, transmission=0.5, roughness=0.3),
    "no-boundary": Material(transmission=1, ior=1.0, roughness=0),
    "rough-no-boundary": Material(transmission=1, ior=1.0, roughness=1),
    "not-there": Material(alpha=0, emission=(1, 1, 1)),
    "brightest": Material(emission=(1e12, 1e12, 1e12)),
    "faintest": Material(emission=(1e-30, 0, 0)),
    "black": Material(base_colour=BLACK, ior=1.0),
    "densest": Material(transmission=1, ior=100, roughness=0.1),
}


@pytest.mark.parametrize("max_bounces", [0, 40])
def test_every_value_is_a_number(max_bounces):
    spheres = [Spheres([[i % 4, i // 4, 0.0]], 0.5, materials=(each,)) for i, each in enumerate(HOSTILE.values())]
    scene = make_scene(
        *spheres, floor(matte()), background=WHITE, eye=(1.5, 1, 7), look_at=(1.5, 1, 0), fov=40,
        width=60, height=50, light_direction=(1, 2, 3), max_bounces=max_bounces,
    )  # fmt: skip
    film = render_film(scene, samples=24)
    assert np.isfinite(film).all()
    assert (film >= 0).all()
    assert film.max() >= 1e11
