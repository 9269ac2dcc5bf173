"""Heat maps: colours, the bar, its numbers."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Camera, Fisheye, build, make_shape
from clbvh.errors import ConfigError
from clbvh.rendering.cameras.framing import frame_mesh
from clbvh.rendering.heat_map import _colour_of, count_picture, draw_heat_map, draw_heat_map_of, open_counter
from clbvh.trace.hits.closest import count_steps


def lightness(colours):
    """Return CIE L* of sRGB colours."""
    share = np.asarray(colours, float) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    luminance = linear @ [0.2126, 0.7152, 0.0722]
    return np.where(luminance > 0.008856, 116 * np.cbrt(luminance) - 16, 903.3 * luminance)


def test_lightness_rises_evenly():
    steps = np.diff(lightness(_colour_of(np.linspace(0, 1, 18))))
    assert (steps > 0).all()
    assert steps.max() < 1.5 * steps.min()


def test_more_is_lighter_and_the_bar_is_below():
    counts = np.arange(200).reshape(1, 200).repeat(4, axis=0)
    picture = draw_heat_map(counts, "nodes")
    assert picture.shape[0] > 4
    assert picture.shape[1:] == (200, 3)
    assert picture.dtype == np.uint8
    assert (np.diff(lightness(picture[0])) >= -1e-9).all()
    assert (picture[:4] == picture[0]).all()


@pytest.mark.parametrize("counts", [np.zeros((3, 40), int), np.full((3, 40), 7), np.eye(40, dtype=int)[:3]])
def test_few_different_counts(counts):
    assert draw_heat_map(counts, "triangles").shape[1] == 40


def test_a_few_bright_pixels_do_not_darken_the_others():
    counts = np.full((100, 100), 50)
    counts[0, 0] = 10_000
    picture = draw_heat_map(counts, "nodes")
    assert lightness(picture[50, 50]) > 80
    assert (picture[0, 0] == _colour_of(np.array(1.0))).all()


@pytest.mark.parametrize("width", [1, 5, 33, 800, 3840])
def test_pictures_of_any_width(width):
    assert draw_heat_map(np.ones((2, width), int), "nodes").shape[1] == width


def test_an_unknown_quantity_is_refused():
    with pytest.raises(ConfigError, match="the heat map must be one of nodes, triangles, not 'boxes'"):
        draw_heat_map(np.ones((2, 2), int), "boxes")


def test_counts_are_those_of_the_pictures_rays():
    bvh = build(make_shape("knot", triangles=1000))
    camera = frame_mesh(bvh.mesh, aspect=2)
    with open_counter(bvh) as caster:
        expected = count_steps(caster, *camera.rays(40, 20)).reshape(20, 40)
    assert np.array_equal(count_picture(bvh, camera, 40, 20), expected)
    picture = draw_heat_map_of(bvh, camera, 40, 20, "triangles")
    assert np.array_equal(picture, draw_heat_map(expected["prim_tests"], "triangles"))


def test_a_fisheye_takes_no_steps_outside_its_circle():
    bvh = build(make_shape("icosphere", triangles=80))
    # Beyond its circle, rays go straight behind the camera, where the sphere is.
    camera = Camera(eye=(0, 0, 3), look_at=(0, 0, 6), projection=Fisheye(360))
    is_outside = ~camera.sees(40, 20)
    assert count_picture(bvh, camera, 40, 20)["node_steps"][is_outside].min() > 0
    expected = np.where(is_outside, 0, count_picture(bvh, camera, 40, 20)["node_steps"])
    np.testing.assert_array_equal(draw_heat_map_of(bvh, camera, 40, 20, "nodes"), draw_heat_map(expected, "nodes"))
