"""Pictures without noise, and the base colours that guide their filter."""

import builtins

import numpy as np
import pytest

import clbvh
from clbvh import ConfigError, Renderer, Transform
from clbvh.rendering import frame

from .test_pictures import KNOT

BOX = {"width": 128, "height": 128, "shading": "path", "keeps_film": True}


def colours_of(picture):
    return picture.film[..., :3].astype(np.float64)


def test_few_samples_come_as_near_the_truth_as_four_times_as_many():
    pytest.importorskip("pyoidn", exc_type=ImportError)
    with Renderer("cornell") as renderer:
        truth = colours_of(renderer.render(samples=1024, seed=1, **BOX))

        def error(**settings):
            # The median: at the edges of the lamp the filters of pixels differ, and no noise is as large as that.
            difference = colours_of(renderer.render(**settings, **BOX)) - truth
            return float(np.median(np.abs(difference) / (truth + 0.1)))

        # Noise that pixels shared with their neighbours would stay, as a texture: 0.9 of the error.
        assert error(samples=16, denoise=True) < 0.8 * error(samples=64)
        noisy, clean = (renderer.render(samples=16, denoise=each, **BOX) for each in (False, True))
    assert (clean.rgb != noisy.rgb).any()
    np.testing.assert_array_equal(clean.hits.prim_id, noisy.hits.prim_id)


def test_bands_do_not_show(monkeypatch):
    pytest.importorskip("pyoidn", exc_type=ImportError)
    view = clbvh.View(width=40, height=30, samples=2, denoise=True, transparent=True)
    whole = clbvh.render(KNOT, view)
    monkeypatch.setattr(frame, "BAND_PIXELS", 40 * 8)
    banded = clbvh.render(KNOT, view)
    np.testing.assert_array_equal(whole.pixels, banded.pixels)
    assert whole.film is None


def test_shadings_without_noise_stay_as_they_are():
    for shading in ("lambert", "albedo"):
        view = clbvh.View(width=24, height=18, shading=shading)
        np.testing.assert_array_equal(clbvh.render(KNOT, view).rgb, clbvh.render(KNOT, view, denoise=True).rgb)


def test_a_missing_library_is_named(monkeypatch):
    imported = builtins.__import__

    def refuse(name, *rest):
        if name == "pyoidn":
            raise ImportError("none here")
        return imported(name, *rest)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(ConfigError, match="denoise needs pyoidn: run 'pip install pyoidn'"):
        clbvh.render(KNOT, width=24, height=18, denoise=True)


def test_albedo_shows_base_colours():
    scene = clbvh.Scene()
    square = scene.add(([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]]))
    scene.place(square, material=clbvh.Material(base_colour=(0.3, 0.5, 0.7), emission=(9, 9, 9)))
    scene.place(square, Transform(translate=(2, 0, 0)), colour=(0.1, 0.2, 0.3))
    view = clbvh.View(shading="albedo", width=8, height=2, eye=(1, 0, 3), look_at=(1, 0, 0), fov=20, up="y")
    with Renderer(scene, view) as renderer:
        film = renderer.render(keeps_film=True).film
    np.testing.assert_allclose(film[:, 1:3], np.broadcast_to([0.3, 0.5, 0.7, 1], (2, 2, 4)), rtol=1e-6)
    np.testing.assert_allclose(film[:, 5:7], np.broadcast_to([0.1, 0.2, 0.3, 1], (2, 2, 4)), rtol=1e-6)
