"""The sun in mirrors, the ground and the limit of samples of `path`, by formulas."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Light, Material, Spheres
from clbvh.rendering.kernel_view import _LIGHT_SPREAD

from .test_path import BLACK, ERRORS, WHITE, check_mean, floor, make_scene, matte, render_film, view_at

# 1 - cos of half the angle of the sun.
SUN_WIDTH = 1 - 1 / np.hypot(1, _LIGHT_SPREAD)


@pytest.mark.parametrize("radius", [1e-4, 0.05, 0.9, 0.9999])
def test_a_sphere_lamp_near_and_far(radius):
    """A lamp alone above the floor: its irradiance below its centre is that of a sphere at distance 1."""
    glow = Material(base_colour=BLACK, ior=1.0, emission=(5 / radius**2,) * 3)
    lamp = Spheres([[0, 1.0, 0]], radius, materials=(glow,))
    scene = make_scene(floor(matte(), 30), lamp, max_bounces=1, **view_at(0.001, 5.0))
    check_mean(render_film(scene, eye=(2.0, 0.05, 0.0), look_at=(0, 0, 0), fov=0.02, samples=256), 5, 2e-2)


@pytest.mark.parametrize("kind", ["metal", "glass"])
def test_a_mirror_shows_the_sun(kind):
    surface = (
        Material(base_colour=WHITE, metallic=1, roughness=0)
        if kind == "metal"
        else Material(transmission=1, ior=1.0, roughness=0, base_colour=WHITE)
    )
    towards = (-0.8, 0.6 if kind == "metal" else -0.6, 0)
    scene = make_scene(floor(surface), light=Light(direction=towards, colour=(2, 1, 0.5)), **view_at(0.6))
    film = render_film(scene, samples=16)
    check_mean(film, np.array([2, 1, 0.5]) / (2 * SUN_WIDTH), 1e-3)


def test_a_camera_does_not_show_the_sun():
    scene = make_scene(Spheres([[0, 0, 9]], 0.1), light_direction=(0, 0, -1))
    assert not render_film(scene, samples=4).any()


def test_furnace_with_a_ground():
    """Light of 1 all around: a ground of albedo 1/2 reflects that, but for what the ball beside it hides."""
    ball = Spheres([[0, 0, 0]], 1, materials=(matte(WHITE),))
    scene = make_scene(ball, background=WHITE, ground=True, fov=60, eye=(0, 3, 8), samples=64)
    film = render_film(scene)
    assert film.max() <= 1 + 1e-5
    assert film.min() > 0.2
    far = {"eye": (3.4, 20, 0.0), "look_at": (3.4, -1, 0.001), "fov": 0.1}
    assert 0.48 < render_film(scene, samples=256, **far).mean() <= 0.5 + 1e-3


def test_the_ground_far_from_objects_has_its_albedo():
    """Seen beside a small ball, the ground reflects half of the sun and of the sky."""
    sun = Light(direction=(0, 1, 0), colour=(1, 1, 1))
    ball = Spheres([[0, 0, 0]], 1, materials=(matte(BLACK),))
    scene = make_scene(ball, light=sun, ground=True, eye=(3.0, 20, 0.0), look_at=(3.0, -1, 0.001), fov=0.1)
    check_mean(render_film(scene, samples=256), 0.5 * (1 - SUN_WIDTH / 2), 5e-3)


@pytest.mark.parametrize("limit", [0.1, 1.0, 10.0])
def test_a_limit_never_brightens(limit):
    lamp = Spheres([[0, 1, 0]], 0.2, materials=(Material(base_colour=BLACK, ior=1.0, emission=(30, 20, 10)),))
    scene = make_scene(floor(matte()), lamp, eye=(0, 1, 4), fov=50, samples=16)
    free, limited = render_film(scene), render_film(scene, clamp=limit)
    assert (limited <= free + 1e-6).all()
    assert limited.max() <= limit * (1 + 1e-5)
    assert free.max() > ERRORS * 2
