"""Heat maps: colours, the bar, and the steps of the rays that trees are compared by."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Camera, ConfigError, Fisheye, build, make_shape
from clbvh.rendering.cameras.framing import frame_mesh
from clbvh.rendering.heat_map import count_picture, draw_heat_map, draw_heat_map_of, open_counter
from clbvh.trace.hits.closest import count_steps


def lightness(colours):
    """Return CIE L* of sRGB colours."""
    share = np.asarray(colours, float) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    luminance = linear @ [0.2126, 0.7152, 0.0722]
    return np.where(luminance > 0.008856, 116 * np.cbrt(luminance) - 16, 903.3 * luminance)


def test_more_is_evenly_lighter_and_the_bar_is_below():
    picture = draw_heat_map(np.arange(200).reshape(1, 200).repeat(4, axis=0), "nodes")
    assert picture.shape[0] > 4
    assert (picture[:4] == picture[0]).all()
    steps = np.diff(lightness(picture[0])[:200:20])
    assert steps.min() > 0
    assert steps.max() < 1.5 * steps.min()
    for counts in (np.zeros((3, 40), int), np.full((3, 40), 7), np.ones((2, 1), int), np.ones((2, 3840), int)):
        assert draw_heat_map(counts, "triangles").shape[1] == counts.shape[1]
    with pytest.raises(ConfigError, match="the heat map must be one of nodes, triangles, not 'boxes'"):
        draw_heat_map(np.ones((2, 2), int), "boxes")


def test_a_few_bright_pixels_do_not_darken_the_others():
    counts = np.full((100, 100), 50)
    counts[0, 0] = 10_000
    picture = draw_heat_map(counts, "nodes")
    assert lightness(picture[50, 50]) > 80
    assert lightness(picture[0, 0]) == lightness(picture[:100]).max()


def test_counts_are_those_of_the_pictures_rays():
    bvh = build(make_shape("knot", triangles=1000))
    camera = frame_mesh(bvh.mesh, aspect=2)
    with open_counter(bvh) as caster:
        expected = count_steps(caster, *camera.rays(40, 20)).reshape(20, 40)
    for quantity, field in (("triangles", "prim_tests"), ("nodes", "node_steps")):
        picture = draw_heat_map_of(bvh, camera, 40, 20, quantity)
        assert np.array_equal(picture, draw_heat_map(expected[field], quantity))
    # Beyond the circle of a fisheye, rays go straight behind the camera, where the mesh is; but nobody casts them.
    camera = Camera(eye=(0, 0, 6), look_at=(0, 0, 9), projection=Fisheye(360))
    steps, is_seen = count_picture(bvh, camera, 40, 20)["node_steps"], camera.sees(40, 20)
    assert steps[~is_seen].min() > 0
    expected = draw_heat_map(np.where(is_seen, steps, 0), "nodes")
    np.testing.assert_array_equal(draw_heat_map_of(bvh, camera, 40, 20, "nodes"), expected)
