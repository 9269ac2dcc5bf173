"""Polynomials against numpy in float64, with the error bounds that math/trigonometry.cl states."""

import numpy as np
import pytest

FLOAT2 = (np.float32, (2,))

SINE_ERROR = 1.0e-7
ARCTANGENT_ERROR = 2e-7
ARCCOSINE_ERROR = 2.5e-7


@pytest.fixture(scope="module")
def derive(run_shell):
    """A function from vectors, (n, 2), to sines and cosines, arctangents and arccosines."""

    def run(vectors):
        vectors = np.ascontiguousarray(vectors, np.float32)
        return run_shell("derive_angles", [vectors], [FLOAT2, np.float32, np.float32], "sampling_shells", {})

    return run


def turned(turns):
    """Sines and cosines of float32 turns in float64; whole turns are taken off exactly."""
    angle = 2 * np.pi * (turns.astype(np.float64) - np.rint(turns.astype(np.float64)))
    return np.stack((np.sin(angle), np.cos(angle)), axis=1)


def with_zero(values):
    return np.stack((values, np.zeros_like(values)), axis=1)


@pytest.mark.parametrize("reach", [1e-20, 1e-3, 0.6, 4, 1000, 1e6])
def test_sines_and_cosines(derive, reach):
    turns = np.random.default_rng(11).uniform(-reach, reach, 200_000).astype(np.float32)
    sines, _, _ = derive(with_zero(turns))
    np.testing.assert_allclose(sines, turned(turns), rtol=0, atol=SINE_ERROR)


def test_a_small_sine_keeps_its_digits(derive):
    turns = np.geomspace(1e-30, 0.1, 100_000).astype(np.float32)
    sines, _, _ = derive(with_zero(np.concatenate((turns, -turns))))
    np.testing.assert_allclose(sines[:, 0], turned(np.concatenate((turns, -turns)))[:, 0], rtol=2.5e-7)


def test_quarter_turns_are_exact(derive):
    quarters = np.arange(-40, 41)
    sines, _, _ = derive(with_zero(quarters / 4))
    cycle = np.array([[0, 1], [1, 0], [0, -1], [-1, 0]])
    np.testing.assert_array_equal(sines, cycle[quarters % 4])


def test_sines_and_cosines_are_those_of_a_unit_vector(derive):
    turns = np.random.default_rng(12).uniform(0, 1, 200_000)
    sines, _, _ = derive(with_zero(turns))
    np.testing.assert_allclose((sines.astype(np.float64) ** 2).sum(axis=1), 1, rtol=0, atol=3e-7)


@pytest.mark.parametrize("scale", [1e-30, 1e-3, 1, 1e30])
def test_arctangents(derive, scale):
    vectors = scale * np.random.default_rng(13).normal(size=(200_000, 2))
    # Thin angles and their neighbours, on all sides of both axes and of the diagonals.
    vectors[:20_000, 0] *= np.geomspace(1e-6, 1, 20_000)
    vectors[20_000:40_000, 1] *= np.geomspace(1e-6, 1, 20_000)
    vectors[40_000:60_000, 0] = vectors[40_000:60_000, 1] * np.linspace(-2.5, 2.5, 20_000)
    vectors = vectors.astype(np.float32)
    _, angles, _ = derive(vectors)
    expected = np.arctan2(vectors[:, 1].astype(np.float64), vectors[:, 0].astype(np.float64))
    np.testing.assert_allclose(angles, expected, rtol=ARCTANGENT_ERROR)


def test_arctangents_on_the_axes(derive):
    x, y = np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0])
    vectors = np.stack((x.ravel(), y.ravel()), axis=1)
    _, angles, _ = derive(vectors)
    np.testing.assert_allclose(angles, np.arctan2(vectors[:, 1], vectors[:, 0]), rtol=1e-7)
    assert angles[4] == 0


def test_arccosines(derive):
    near_one = 1 - np.geomspace(1e-7, 1, 50_000)
    cosines = np.concatenate((np.linspace(-1, 1, 100_001), near_one, -near_one)).astype(np.float32)
    _, _, angles = derive(with_zero(cosines))
    np.testing.assert_allclose(angles, np.arccos(cosines.astype(np.float64)), rtol=ARCCOSINE_ERROR)


def test_arccosines_beyond_one_are_limited(derive):
    _, _, angles = derive(with_zero(np.array([1.0, 1.0000001, 2, -1, -1.0000001, -2])))
    np.testing.assert_allclose(angles, [0, 0, 0, np.pi, np.pi, np.pi], rtol=1e-7)
