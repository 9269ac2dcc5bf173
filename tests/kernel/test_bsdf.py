"""Scattering at surfaces: samples agree with values, densities and energies with integrals by their formulas."""

import numpy as np
import pytest

from clbvh.structs import LAYOUTS

VALUE, DRAWN = (np.float32, (4,)), (np.float32, (8,))
GRID = 256

# Roughness 0.05 is a highlight of a fifth of a degree.
ROUGHNESSES = (0.05, 0.3, 0.6, 1.0)
COSINES = (1.0, 0.8, 0.3, 0.05)


@pytest.fixture(scope="module")
def scatter(run_shell):
    """A function from a material, an eye's cosine, samples and directions to (drawn, at_drawn, at_light)."""

    def run(samples, cosine, to_light=None, **material):
        values = {"base_colour": (1, 1, 1), "metallic": 0, "roughness": 0.5, "ior": 1.5, "transmission": 0, "back": 0}
        row = np.hstack([*(values | material).values()]).astype(np.float32)
        count = len(samples)
        samples = np.hstack([samples, np.zeros((count, 1))]).astype(np.float32)
        eye = np.array([np.sqrt(1 - cosine**2), 0, cosine], np.float32)
        light = np.tile(np.float32([0, 0, 1]), (count, 1)) if to_light is None else np.float32(to_light)
        inputs = [np.tile(row, (count, 1)), np.tile(eye, (count, 1)), samples, light]
        results = run_shell(
            "scatter_light", inputs, [DRAWN, VALUE, VALUE], "scatter_light", {"LAYOUT": LAYOUTS["brute"]}
        )
        return [result.astype(np.float64) for result in results]

    return run


@pytest.fixture(scope="module")
def samples():
    """(GRID^2, 3) float: a lobe and a point of the square each; the lobes are in every part of the square."""
    generator = np.random.default_rng(7)
    cells = np.stack(np.meshgrid(np.arange(GRID), np.arange(GRID)), axis=-1).reshape(-1, 2)
    return np.hstack([generator.random((GRID**2, 1)), (cells + generator.random((GRID**2, 2))) / GRID])


def hemisphere_grid(rows=512, columns=512):
    """Directions, and their solid angles: closer to each other opposite to the eye."""
    angle = np.pi / 2 * (np.arange(rows) + 0.5) / rows
    place = (2 * np.arange(columns) + 1) / columns - 1
    angle, place = (each.ravel() for each in np.meshgrid(angle, place))
    z, level, turn = np.cos(angle), np.sin(angle), np.pi * (1 + place**3)
    solid_angles = (np.pi / 2 * level / rows) * (2 * np.pi * 3 * place**2 / columns)
    return np.column_stack([level * np.cos(turn), level * np.sin(turn), z]), solid_angles


@pytest.mark.parametrize("cosine", COSINES)
@pytest.mark.parametrize("roughness", ROUGHNESSES)
@pytest.mark.parametrize("metallic", [0, 0.5, 1])
def test_weight_times_density_is_the_value(scatter, samples, metallic, roughness, cosine):
    drawn, at_drawn, _ = scatter(
        samples[::16], cosine, metallic=metallic, roughness=roughness, base_colour=(0.9, 0.5, 0.1)
    )
    is_drawn = drawn[:, 7] > 0
    assert is_drawn.sum() > 100
    np.testing.assert_allclose(drawn[:, 6], at_drawn[:, 3], rtol=1e-6)
    np.testing.assert_allclose(drawn[:, 3:6] * drawn[:, 6:7], at_drawn[:, :3], rtol=1e-5, atol=1e-30)


@pytest.mark.parametrize("cosine", COSINES)
@pytest.mark.parametrize("roughness", [0, 1])
def test_without_a_coat_all_is_diffuse(scatter, samples, roughness, cosine):
    drawn, at_drawn, _ = scatter(samples, cosine, ior=1, roughness=roughness, base_colour=(0.9, 0.5, 0.1))
    density = drawn[:, 2] / np.pi
    np.testing.assert_allclose(drawn[:, 6], density, rtol=1e-6)
    np.testing.assert_allclose(drawn[:, 3:6], np.tile([0.9, 0.5, 0.1], (len(drawn), 1)), rtol=1e-6)
    np.testing.assert_allclose(at_drawn[:, :3], density[:, None] * [0.9, 0.5, 0.1], rtol=1e-6)
    # A cosine and a turn that are independent, and evenly spread.
    turns = np.arctan2(drawn[:, 1], drawn[:, 0]) / (2 * np.pi) % 1
    counts = np.histogram2d(drawn[:, 2] ** 2, turns, bins=4, range=[[0, 1], [0, 1]])[0]
    assert np.abs(counts / len(drawn) * 16 - 1).max() < 0.05


@pytest.mark.parametrize("cosine", COSINES)
@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
@pytest.mark.parametrize("metallic", [0, 1])
def test_density_and_energy(scatter, samples, metallic, roughness, cosine):
    """The density's integral is the share of samples that are drawn; the value's is the mean weight, 1 at most."""
    directions, solid_angles = hemisphere_grid()
    _, _, values = scatter(np.zeros((len(directions), 3)), cosine, directions, metallic=metallic, roughness=roughness)
    drawn, *_ = scatter(samples, cosine, metallic=metallic, roughness=roughness)
    drawn_share = (drawn[:, 7] > 0).mean()
    integral = solid_angles @ values
    assert integral[3] <= 1 + 1e-3
    np.testing.assert_allclose(integral[3], drawn_share, rtol=0, atol=4e-3)
    np.testing.assert_allclose(drawn[:, 3:6].mean(axis=0), integral[:3], rtol=1e-2)
    assert integral[:3].max() <= 1 + 2e-3


@pytest.mark.parametrize("cosine", COSINES)
@pytest.mark.parametrize("back", [0, 1])
@pytest.mark.parametrize("roughness", [0, 0.05, 0.5, 1])
def test_glass_keeps_energy(scatter, samples, roughness, back, cosine):
    """A smooth boundary loses nothing; a rough one what facets hide."""
    drawn, *_ = scatter(samples, cosine, transmission=1, roughness=roughness, back=back)
    weight = drawn[:, 3].mean()
    assert weight <= 1 + 2e-3
    if roughness == 0:
        np.testing.assert_allclose(drawn[:, 3], 1, rtol=1e-4)
        # Snell's law, and Fresnel's share of the samples.
        ratio = 1 / 1.5 if back else 1.5
        sine = np.sqrt(1 - cosine**2) / ratio
        below = drawn[drawn[:, 7] == 2]
        if sine > 1:
            assert len(below) == 0
            return
        inner = np.sqrt(1 - sine**2)
        np.testing.assert_allclose(below[:, :3], np.tile([-sine, 0, -inner], (len(below), 1)), atol=2e-6)
        parallel = (ratio * cosine - inner) / (ratio * cosine + inner)
        across = (cosine - ratio * inner) / (cosine + ratio * inner)
        assert abs(1 - len(below) / len(drawn) - (parallel**2 + across**2) / 2) < 6e-3


def test_narrow_highlights_keep_their_density(scatter):
    """The GGX distribution at its centre and flanks, to float32's precision, for nearly smooth surfaces."""
    alpha, slopes = 0.04**2, np.array([0, 0.25, 1, 4, 20])
    tangent = alpha * slopes
    facet = np.column_stack([tangent, 0 * tangent, np.ones(5)]) / np.sqrt(1 + tangent**2)[:, None]
    light = 2 * facet[:, 2:] * facet - [0, 0, 1]
    _, _, values = scatter(np.zeros((5, 3)), 1.0, light, metallic=1, roughness=0.04)
    cosine_4 = facet[:, 2] ** 4
    expected = alpha**2 / (np.pi * cosine_4 * (alpha**2 + tangent**2) ** 2) / 4
    np.testing.assert_allclose(values[:, 0], expected, rtol=2e-3)


@pytest.mark.parametrize("seed", [1])
def test_any_material_gives_numbers(scatter, samples, seed):
    generator = np.random.default_rng(seed)
    edge = np.array([0, 0, 1, 2**-24, 1 - 2**-24])
    last = np.float32(1) - np.float32(2**-24)
    for _ in range(40):
        material = {
            "base_colour": generator.choice([0, 1e-30, 1], 3),
            "metallic": generator.choice(edge[:4]),
            "roughness": generator.choice([0, 0.03, 0.032, 1]),
            "ior": generator.choice([1, 1.0000001, 1.5, 100]),
            "transmission": generator.choice(edge[:4]),
            "back": generator.integers(2),
        }
        points = np.minimum(samples[:2000], last)
        points[:8] = np.array(np.meshgrid([0, last], [0, last], [0, last])).reshape(3, 8).T
        for cosine in (1.0, 0.5, 1e-3, 1e-7, 0.0):
            drawn, at_drawn, at_light = scatter(points, cosine, **material)
            for values in (drawn, at_drawn, at_light):
                assert np.isfinite(values).all(), (material, cosine)
                assert (values[:, 3:] >= 0).all()
