"""Pictures of `path` whose noise decides how many samples each tile gets."""

import numpy as np
import pytest

import clbvh
from clbvh import Renderer

from .test_pictures import KNOT

BOX = {"width": 96, "height": 96, "shading": "path", "keeps_film": True}


@pytest.fixture(scope="module")
def box():
    with Renderer("cornell") as renderer:
        yield renderer


def find_errors(film, truth):
    """Return the error of each 8 x 8 pixels, relative to their light, as `View.noise` counts it."""
    difference, light = ((each @ (0.2126, 0.7152, 0.0722)) for each in (film[..., :3] - truth, truth))
    change, light = (each.reshape(12, 8, 12, 8).mean((1, 3)) for each in (difference**2, light))
    return np.sqrt(change) / (light + 0.1)


def test_samples_go_where_the_noise_is(box):
    truth = box.render(samples=2048, seed=1, **BOX).film[..., :3].astype(np.float64)
    adaptive = box.render(noise=0.04, **BOX)
    even = box.render(samples=adaptive.samples, **BOX)
    errors, even_errors = (find_errors(each.film, truth) for each in (adaptive, even))
    # Pixels have the samples of nine cells, so their error is below that of cells.
    assert np.quantile(errors, 0.9) < 0.04
    assert np.quantile(errors, 0.9) < 0.9 * np.quantile(even_errors, 0.9)
    assert 16 < adaptive.samples < 128


def test_less_noise_takes_more_samples(box):
    taken = [box.render(noise=each, **BOX).samples for each in (0.5, 0.1, 0.05)]
    assert taken[0] == 16 < taken[1] < taken[2]
    assert box.render(noise=0.05, samples=16, **BOX).samples == 16


def test_a_scene_s_number_of_samples_is_no_bound():
    assert clbvh.View(samples=16, shading="path").changed(noise=0.1).sample_count == 4096
    assert clbvh.View(shading="path").changed(noise=0.1, samples=16).sample_count == 16


def test_neighbouring_tiles_with_other_samples_have_no_seam(box):
    film = box.render(noise=0.05, **BOX).film
    np.testing.assert_allclose(film[16:80, 16:80, 3], 1.0, atol=1e-5)  # the covered share: the room fills the middle


def test_the_samples_are_a_bound(box):
    plain, bound = (box.render(samples=24, noise=each, **BOX) for each in (0.0, 1e-9))
    assert 20 < bound.samples <= plain.samples == 24  # the background has no noise
    middle = np.s_[16:80, 16:80]
    np.testing.assert_allclose(bound.film[middle], plain.film[middle], rtol=1e-4)


def test_shadings_with_even_noise_stay_as_they_are():
    for shading in ("studio", "lambert"):
        view = clbvh.View(width=24, height=18, shading=shading)
        np.testing.assert_array_equal(clbvh.render(KNOT, view).rgb, clbvh.render(KNOT, view, noise=0.5).rgb)


def test_exposed_pictures_are_judged_as_they_are_seen(box):
    dark, bright = (box.render(noise=0.1, exposure=each, **BOX).samples for each in (-10, 4))
    assert dark == 16 < bright
