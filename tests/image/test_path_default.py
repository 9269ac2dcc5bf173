"""`path` on plain meshes: light that nobody has chosen is that of `studio`; and few smooth triangles."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh
from clbvh import Appearance, Light, Material, Mesh, Renderer

BLACK, WHITE = (0, 0, 0), (1, 1, 1)
SIZE = {"width": 96, "height": 64}
SQUARE = {"width": 64, "height": 64, "eye": (0, 0, 5), "look_at": (0, 0, 0)}


def ball(triangles=5120, **material):
    shape = clbvh.make_shape("icosphere", triangles=triangles)
    materials = (Material(**material),) if material else ()
    return Mesh.from_arrays(shape.vertices, shape.faces, appearance=Appearance(materials=materials))


BALL = ball()


def draw(shape=BALL, **settings):
    return clbvh.render(shape, **(SIZE | {"shading": "path", "samples": 32} | settings))


def draw_film(shape, **settings):
    with Renderer(shape, shading="path", ground=False, **(SQUARE | settings)) as renderer:
        picture = renderer.render(keeps_film=True)
    return picture.film[..., 0].astype(float), picture.hits.prim_id >= 0


class TestLight:
    def test_a_plain_mesh_is_as_bright_and_as_varied_as_in_studio(self):
        path, studio = draw(), draw(shading="studio")
        is_ball = path.hits.prim_id >= 0
        expected = studio.rgb[is_ball].mean(axis=-1)
        values = path.rgb[is_ball].mean(axis=-1)
        assert abs(values.mean() - expected.mean()) < 10
        assert 0.8 < values.std() / expected.std() < 1.25

    def test_the_background_is_that_of_studio(self):
        path, studio = draw().rgb[:8, :8], draw(shading="studio").rgb[:8, :8]
        np.testing.assert_allclose(path.astype(int), studio.astype(int), rtol=0, atol=1)

    @pytest.mark.parametrize("up", [(0, 1, 0), (0.3, 1, -0.2)])
    def test_the_ground_shows_the_background_but_for_the_shadow(self, up):
        path = draw(samples=128, up=up).rgb.astype(float)
        difference = path - draw(ground=False, up=up).rgb.astype(float)
        # On the side of the light, nothing is in shadow, and the ball reflects a little.
        assert abs(difference[-12:, :12].mean()) < 6
        # On the other side is the ball's shadow.
        assert difference[-24:, 64:].min() < -60

    def test_a_transparent_picture_has_no_ground(self):
        assert not draw(transparent=True).alpha[-1].any()
        assert draw(transparent=True, ground=True).alpha[-1].all()

    @pytest.mark.parametrize(
        "chosen",
        [
            {"light_colour": WHITE}, {"background": (0.2, 0.3, 0.4)},
            {"environment": np.ones((4, 8, 3))}, {"shape": ball(emission=(0.1, 0.1, 0.1))},
            {"eye": (0, 0, 0.9), "look_at": (0, 0, 2)},
        ],
        ids=["colour", "background", "environment", "emission", "inside"],
    )  # fmt: skip
    def test_a_choice_brings_neither_ground_nor_linear_curve(self, chosen):
        picture = draw(**chosen)
        explicit = draw(**chosen, ground=False, tone_curve="filmic")
        np.testing.assert_array_equal(picture.rgb, explicit.rgb)
        np.testing.assert_array_equal(picture.alpha, explicit.alpha)

    def test_a_light_from_elsewhere_keeps_the_ground(self):
        picture = draw(light_direction=(1, 2, 3))
        assert picture.alpha[-1].any()
        assert (picture.rgb != draw().rgb).any()


class TestFewTriangles:
    """Balls of 80 and 320 triangles with smooth normals."""

    def test_a_white_ball_in_white_light_cannot_be_seen(self):
        shape = ball(80, base_colour=WHITE, roughness=1, ior=1)
        film, _ = draw_film(shape, background=WHITE, light_colour=BLACK, samples=64, max_bounces=50)
        np.testing.assert_allclose(film, 1, rtol=2e-5)

    @pytest.mark.parametrize("roughness", [0.0, 0.5, 1.0])
    def test_a_coat_adds_no_light(self, roughness):
        shape = ball(80, base_colour=WHITE, roughness=roughness)
        film, _ = draw_film(shape, background=WHITE, light_colour=BLACK, samples=256, max_bounces=50)
        assert film.max() <= 1.01

    def test_facets_do_not_show_in_the_shadow(self):
        light = Light(direction=(1, 0.2, 0.1))
        coarse, fine = (draw_film(ball(count), background=BLACK, light=light, samples=256)[0] for count in (320, 81920))
        # 0.107 with rays from the facets.
        assert np.abs(coarse - fine)[16:48, 16:48].max() < 0.08

    @pytest.mark.parametrize("triangles", [80, 320])
    def test_an_edge_towards_the_light_is_bright(self, triangles):
        light = Light(direction=(-1, 0.3, 0))
        size = {"width": 128, "height": 128, "fov": 24}
        shape = ball(triangles, base_colour=WHITE, roughness=0.5)
        film, is_hit = draw_film(shape, background=BLACK, light=light, samples=64, **size)
        is_inner = is_hit.copy()
        for axis in (0, 1):
            is_inner &= np.roll(is_hit, 1, axis) & np.roll(is_hit, -1, axis)
        # 0.25 and 0.35 where the coat of facets at the edge reflects all.
        assert min(film[row][is_inner[row]][:6].min() for row in range(44, 84)) > 0.44
