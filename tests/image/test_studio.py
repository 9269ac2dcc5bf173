"""The shadings `studio` and `ao`: references that were looked at, and answers by formula."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

import clbvh
from clbvh import Light, Scene
from clbvh.geometry.appearance.appearance import Appearance
from clbvh.geometry.appearance.srgb import srgb_to_linear
from clbvh.rendering import painters as painters_module

KNOT = clbvh.make_shape("knot", triangles=4000, seed=1)
VIEW = clbvh.View(width=96, height=64, up="y")

DARK = Light(direction=(0, 0, 1), colour=(0, 0, 0), sky=(0, 0, 0), ground=(0, 0, 0))
CORNERS = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
FACES = [(0, 1, 2), (0, 2, 3)]
UVS = np.array([[(0, 0), (1, 0), (1, 1)], [(0, 0), (1, 1), (0, 1)]], np.float32)


def make_square(**appearance):
    """A square that fills the picture of `show`: 20 x 20 pixels, the outermost half pixel included."""
    return clbvh.Mesh.from_arrays(CORNERS, FACES, appearance=Appearance(**appearance))


def show(mesh, **settings):
    fov = np.degrees(2 * np.arctan(1 / 4))
    scene = Scene(mesh)
    view = clbvh.View(eye=(0, 0, 4), look_at=(0, 0, 0), fov=fov, width=20, height=20, ground=False, smooth=0.0)
    with clbvh.Renderer(scene, view, **settings) as renderer:
        return renderer.render(keeps_film=True)


@pytest.mark.parametrize("shading", ["studio", "ao"])
def test_each_shading_looks_as_it_did(shading, compare_with_reference):
    compare_with_reference(f"knot-{shading}", clbvh.render(KNOT, VIEW, shading=shading).rgb)


@pytest.mark.parametrize("shading", ["studio", "ao"])
def test_bands_and_batches_do_not_show(shading, monkeypatch):
    view = VIEW.changed(shading=shading, samples=7)
    whole = clbvh.render(KNOT, view).rgb
    # Two samples in each launch, and 7 rows in each band.
    monkeypatch.setattr(painters_module, "_LAUNCH_S", 0.0)
    monkeypatch.setattr(painters_module, "BAND_PIXELS", VIEW.width * 7)
    assert np.array_equal(clbvh.render(KNOT, view).rgb, whole)


def test_a_picture_that_is_stopped_has_the_samples_that_were_taken():
    with clbvh.Renderer(KNOT, VIEW) as renderer:
        stopped = renderer.render(samples=8, is_stopped=lambda: True)
        assert stopped.samples == 2
        assert np.array_equal(stopped.rgb, renderer.render(samples=2).rgb)


def test_bands_have_shares_of_the_time(monkeypatch):
    monkeypatch.setattr(painters_module, "BAND_PIXELS", VIEW.width * 7)
    monkeypatch.setattr(painters_module, "_LAUNCH_S", 0.0)
    now = itertools.count()
    # Each launch reads the clock twice.
    monkeypatch.setattr(painters_module, "time", SimpleNamespace(perf_counter=lambda: float(next(now))))
    with clbvh.Renderer(KNOT, VIEW) as renderer:
        picture = renderer.render(time_limit_s=8 * VIEW.height)
    # Of the last band, which has one row.
    assert picture.samples >= 6


def test_the_samples_of_a_picture_in_bands_are_those_of_the_poorest(monkeypatch):
    monkeypatch.setattr(painters_module, "BAND_PIXELS", VIEW.width * 7)
    monkeypatch.setattr(painters_module, "_LAUNCH_S", 0.0)
    launches = []

    def stops_in_the_middle():
        launches.append(None)
        return len(launches) in (6, 7)

    with clbvh.Renderer(KNOT, VIEW) as renderer:
        assert renderer.render(samples=8, is_stopped=stops_in_the_middle).samples == 2


def test_a_seed_changes_the_noise_alone():
    first, second = (clbvh.render(KNOT, VIEW, seed=seed).rgb.astype(float) for seed in (0, 1))
    assert (first != second).any()
    assert abs(first.mean() - second.mean()) < 0.3


def test_an_open_plane_is_white():
    assert (show(make_square(), shading="ao").rgb[1:-1, 1:-1] == 255).all()


def test_a_closed_box_is_black():
    # The reach of occlusion is a share of the scene's size, which a far triangle makes large.
    vertices, faces = _box()
    far = np.array([(40, 40, 40), (41, 40, 40), (40, 41, 40)])
    mesh = clbvh.Mesh.from_arrays(np.concatenate((vertices, far)), np.concatenate((faces, [(8, 9, 10)])))
    scene = Scene(mesh)
    view = clbvh.View(eye=(0, 0, 0), look_at=(0, 0, 1), fov=60, width=16, height=16, shading="ao")
    assert (clbvh.render(scene, view).rgb == 0).all()


def _box():
    import trimesh

    box = trimesh.creation.box((2, 2, 2))
    return box.vertices, box.faces


@pytest.mark.parametrize("colour", [(10, 128, 250), (0, 255, 64)])
def test_a_flat_colour_is_stored_as_it_was_given(colour):
    # Light that the surface sends out, and no other.
    material = clbvh.Material(emission=tuple(srgb_to_linear(np.array(colour) / 255)))
    picture = show(make_square(materials=(material,)), light=DARK)
    assert (np.abs(picture.rgb[1:-1, 1:-1].astype(int) - colour) <= 1).all()


def test_a_texture_appears_where_uv_says():
    # Row 0 is the top: red and green above blue and white.
    pixels = np.full((2, 2, 4), 255, np.uint8)
    pixels[0, 0, :3], pixels[0, 1, :3], pixels[1, 0, :3] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
    texture = clbvh.Texture("checker", np.repeat(np.repeat(pixels, 64, axis=0), 64, axis=1))
    material = clbvh.Material(emission=(1, 1, 1), emission_texture=texture)
    rgb = show(make_square(uvs=UVS, materials=(material,)), light=DARK).rgb
    assert (rgb[2:8, 2:8] == (255, 0, 0)).all()
    assert (rgb[2:8, 12:18] == (0, 255, 0)).all()
    assert (rgb[12:18, 2:8] == (0, 0, 255)).all()
    assert (rgb[12:18, 12:18] == (255, 255, 255)).all()


def test_vertex_colours_are_blended_in_linear_light():
    colours = np.zeros((2, 3, 4), np.uint8)
    colours[..., 3] = 255
    # White on the right.
    colours[..., :3] = np.where(UVS[..., :1] > 0, 255, 0)
    ambient = Light(direction=(0, 0, -1), colour=(0, 0, 0), sky=(0.3, 0.3, 0.3), ground=(0.3, 0.3, 0.3))
    film = show(make_square(colours=colours), light=ambient).film[10, 1:-1, 0]
    steps = np.diff(film)
    assert steps.min() > 0
    # The reflection at the edges is a little stronger than in the middle.
    np.testing.assert_allclose(steps, steps.mean(), rtol=0.02)


def test_a_transparent_background_leaves_colours_at_edges_as_they_are():
    material = clbvh.Material(emission=(1, 1, 1))
    mesh = clbvh.Mesh.from_arrays(CORNERS, FACES, appearance=Appearance(materials=(material,)))
    scene = Scene(mesh)
    view = clbvh.View(eye=(0, 0, 6), look_at=(0.013, 0.02, 0), up=(0.2, 1, 0), width=40, height=40, light=DARK)
    picture = clbvh.render(scene, view, transparent=True, ground=False)
    is_edge = (picture.alpha > 0) & (picture.alpha < 255)
    assert is_edge.sum() > 20
    assert set(np.unique(picture.alpha)) <= {round(255 * covered / 16) for covered in range(17)}
    # Black light elsewhere would darken the edge if colours were multiplied by alpha.
    assert (picture.rgb[picture.alpha > 0] == 255).all()
    assert (picture.rgb[picture.alpha == 0] == 0).all()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_shadows_of_light_along_an_axis_are_those_of_light_nearby(axis):
    # Such a light is parallel to sides of the box around the objects, outside which no shadow is looked for.
    up = np.eye(3)[axis]
    beside = up + 1e-6
    ball = clbvh.make_shape("icosphere", triangles=320)
    scene = Scene(ball)
    view = clbvh.View(up=tuple(up), eye=tuple(4 * up + 3 * np.roll(up, 1)), look_at=(0, 0, 0), width=48, height=48)
    along, near = (
        clbvh.render(scene, view, transparent=True, light=Light(direction=tuple(to_light))).alpha.astype(int)
        for to_light in (up, beside)
    )
    is_shadow = (near > 0) & (near < 255)
    assert is_shadow.sum() > 48
    assert np.abs(along - near)[is_shadow].mean() < 1.0


def test_a_shadow_on_a_transparent_ground_is_black_with_alpha():
    picture = clbvh.render(KNOT, VIEW, transparent=True)
    is_shadow = (picture.hits.prim_id < 0) & (picture.alpha > 60)
    assert is_shadow.sum() > 20
    assert picture.alpha[picture.hits.prim_id < 0].max() <= 255
    assert (picture.rgb[is_shadow].min(axis=-1) == 0).any()


@pytest.mark.parametrize("exposure", [0.0, 2.0])
def test_the_filmic_curve_is_that_of_its_source(exposure):
    picture = show(make_square(), tone_curve="filmic", exposure=exposure, samples=2)
    x = 2.0**exposure * picture.film[..., :3].astype(float)
    mapped = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1)
    encoded = np.where(mapped <= 0.0031308, 12.92 * mapped, 1.055 * mapped ** (1 / 2.4) - 0.055)
    assert np.abs(255 * encoded - picture.rgb).max() < 0.51


def test_a_coarse_ball_has_no_facets_in_its_shadow():
    films = []
    for triangles in (320, 81920):
        ball = clbvh.make_shape("icosphere", triangles=triangles)
        light = Light(direction=(1, 0.2, 0.1), sky=(0, 0, 0), ground=(0, 0, 0))
        view = clbvh.View(width=64, height=64, ground=False, light=light)
        with clbvh.Renderer(ball, view, eye=(0, 0, 5), look_at=(0, 0, 0), samples=16) as renderer:
            films.append(renderer.render(keeps_film=True).film[20:44, 20:44, 0])
    assert np.abs(films[0] - films[1]).max() < 0.03


def test_a_room_is_lit_from_the_eye():
    box = clbvh.Mesh.from_arrays(*_box())
    inside = Scene(box)
    view = clbvh.View(eye=(0, 0, 0), look_at=(0, 0, -1), width=32, height=24, ground=False)
    assert clbvh.render(inside, view).rgb.mean() > 150
    # A light that was asked for stays outside.
    assert clbvh.render(inside, view, light_direction=(0, 1, 0)).rgb.mean() < 140
