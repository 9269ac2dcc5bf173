"""Colours against their formulas in float64."""

import numpy as np
import pytest

from clbvh.structs import SHADINGS, VIEW

FLOAT3 = (np.float32, (3,))

# Bound on the error of an encoded colour: far below a step of 8 bits, which is 4e-3.
SRGB_ERROR = 1e-6

HEIGHT = 64


def encode_srgb(linear):
    """The transfer function of IEC 61966-2-1."""
    limited = np.clip(linear, 0.0031308, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * limited ** (1 / 2.4) - 0.055)


def mix(a, b, fraction):
    return a + (b - a) * fraction


@pytest.fixture(scope="module")
def view():
    """A view with distinct colours and unit directions."""
    generator = np.random.default_rng(71)
    view = np.zeros(1, VIEW)
    for name in ("to_light", "to_sky", "forward", "optical_axis"):
        direction = generator.normal(size=3)
        view[name] = direction / np.linalg.norm(direction)
    for name in (
        "light_colour", "sky_colour", "ground_colour", "surface_colour", "background_top", "background_bottom",
    ):  # fmt: skip
        view[name] = generator.uniform(0.05, 1, 3)
    view["eye"] = generator.normal(size=3)
    view["depth_near"], view["depth_far"] = 0.5, 2.5
    view["height"] = HEIGHT
    return view


@pytest.fixture(scope="module")
def shade(run_shell, view):
    """A function from vectors, (n, 3), to the arrays of `shade_points.cl`."""

    def run(vectors, shading="lambert"):
        changed = view.copy()
        changed["shading"] = SHADINGS[shading]
        return run_shell("shade_points", [np.asarray(vectors, np.float32), changed], [FLOAT3] * 5)

    return run


def of(view, name):
    return view[name][0].astype(np.float64)


def random_normals(count, generator):
    normals = generator.normal(size=(count, 3))
    return (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)


def test_srgb_is_that_of_the_standard(shade):
    linear = np.concatenate((np.linspace(0, 1, 30_000), np.geomspace(1e-6, 1, 30_000))).astype(np.float32)
    encoded, *_ = shade(linear.reshape(-1, 3))
    expected = encode_srgb(linear.astype(np.float64))
    np.testing.assert_allclose(encoded.ravel(), expected, rtol=0, atol=SRGB_ERROR)
    # Both branches are taken.
    assert 0.1 < (linear > 0.0031308).mean() < 0.9


def test_bright_light_is_white_and_none_is_black(shade):
    encoded, *_ = shade([[1, 1.5, 1000], [0, 0, 0]])
    np.testing.assert_allclose(encoded, [[1, 1, 1], [0, 0, 0]], rtol=0, atol=SRGB_ERROR)


def test_every_8_bit_value_survives(shade):
    values = np.arange(256)
    encoded = values / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    obtained, *_ = shade(np.stack([linear] * 3, axis=1))
    np.testing.assert_array_equal(np.rint(255 * obtained), np.stack([values] * 3, axis=1))


def test_lambert_is_a_light_and_a_sky(shade, view):
    normals = random_normals(5000, np.random.default_rng(72))
    _, lit, unlit, _, _ = shade(normals)
    wide = normals.astype(np.float64)
    ambient = mix(of(view, "ground_colour"), of(view, "sky_colour"), 0.5 + 0.5 * (wide @ of(view, "to_sky"))[:, None])
    directed = np.maximum(wide @ of(view, "to_light"), 0)[:, None] * of(view, "light_colour")
    # The encoding is at most 12.92 times as steep as the light.
    error = SRGB_ERROR + 12.92 * 1e-6
    expected = encode_srgb((ambient + directed) * of(view, "surface_colour"))
    np.testing.assert_allclose(lit, expected, rtol=0, atol=error)
    np.testing.assert_allclose(unlit, encode_srgb(ambient * of(view, "surface_colour")), rtol=0, atol=error)
    # A light from behind changes nothing.
    is_behind = wide @ of(view, "to_light") < -1e-6
    assert is_behind.any()
    np.testing.assert_array_equal(lit[is_behind], unlit[is_behind])


def test_depth_is_linear_between_near_and_far(shade, view):
    generator = np.random.default_rng(73)
    positions = (of(view, "eye") + generator.uniform(-3, 3, (5000, 3))).astype(np.float32)
    _, _, _, depths, _ = shade(positions, "depth")
    depth = (positions.astype(np.float64) - of(view, "eye")) @ of(view, "optical_axis")
    expected = 1 - np.clip((depth - 0.5) / 2.0, 0, 1)
    np.testing.assert_allclose(depths, np.stack([expected] * 3, axis=1), rtol=0, atol=2e-6)
    assert {0.0, 1.0} < set(depths[:, 0].tolist())


@pytest.mark.parametrize("shading", SHADINGS)
def test_the_background_is_a_gradient_or_black(shade, view, shading):
    *_, backgrounds = shade(np.zeros((HEIGHT, 3)), shading)
    if shading in ("normal", "depth"):
        assert (backgrounds == 0).all()
        return
    down = (np.arange(HEIGHT)[:, None] + 0.5) / HEIGHT
    expected = encode_srgb(mix(of(view, "background_top"), of(view, "background_bottom"), down))
    np.testing.assert_allclose(backgrounds, expected, rtol=0, atol=SRGB_ERROR + 12.92 * 2e-7)
