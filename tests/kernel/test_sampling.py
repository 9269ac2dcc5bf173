"""Sample points, and what they become: evenly spread points, directions by their densities, frames around normals."""

import numpy as np
import pytest

pytestmark = pytest.mark.on_both

# Numbers of a sampler that are drawn: sample_2d, sample_1d, sample_2d, sample_1d.
DRAW = """
    sobol_sampler_t sampler = make_sampler(begin.x, begin.y, begin.z);
    const float2 first = sample_2d(&sampler);
    const float third = sample_1d(&sampler);
    const float2 fourth = sample_2d(&sampler);
    drawn = (float8)(first, third, fourth, sample_1d(&sampler), 0.0f, 0.0f);
"""
PAIRS = ((0, 1), (3, 4))
SINGLES = (2, 5)


@pytest.fixture
def draw(call):
    """A function from number, sample index and seed, each broadcast, to the numbers drawn, (n, 6)."""

    def run(number, sample_index, seed):
        begin = np.stack(np.broadcast_arrays(number, sample_index, seed, 0), axis=-1).astype(np.uint32)
        return call("sampling/sampler.cl", DRAW, "float8 drawn", begin=begin)[:, :6]

    return run


def test_pairs_that_are_drawn_at_once_are_those_drawn_one_by_one(call):
    body = """
        sobol_sampler_t sampler = make_sampler(begin.x, begin.y, begin.z);
        sampler.dimension = begin.w;
        sobol_sampler_t other = sampler;
        uint numbers[2 * PAIR_COUNT];
        sample_pairs(&sampler, numbers);
        difference = (float8)(sample_2d(&other), sample_2d(&other), sample_2d(&other), sample_2d(&other));
        for (int i = 0; i < 2 * PAIR_COUNT; i++) {
            ((float *)&difference)[i] -= as_unit_float(numbers[i]);
        }
        difference += (float8)((float)(sampler.dimension - other.dimension));
    """
    begin = np.random.default_rng(5).integers(0, 2**32, (1000, 4), dtype=np.uint32)
    assert not call("sampling/sampler.cl", body, "float8 difference", begin=begin).any()


def count_in_cells(points, columns, rows):
    """How many points, (n, 2), each cell of a grid has."""
    cells = np.floor(points.astype(np.float64) * (columns, rows)).astype(int)
    return np.bincount(cells[:, 0] * rows + cells[:, 1], minlength=columns * rows)


@pytest.mark.parametrize("exponent", [0, 1, 4, 10])
def test_every_elementary_interval_has_one_of_the_first_points(draw, exponent):
    count = 1 << exponent
    for number, seed in ((0, 0), (1, 77), (12345, 2**32 - 1)):
        samples = draw(number, np.arange(count), seed)
        for pair in PAIRS:
            for power in range(exponent + 1):
                np.testing.assert_array_equal(count_in_cells(samples[:, pair], 1 << power, count >> power), 1)
        for column in SINGLES:
            np.testing.assert_array_equal(np.sort(np.floor(samples[:, column] * count)), np.arange(count))


def test_first_points_of_numbers_are_even_in_distribution_and_below_one(draw):
    # Scrambling makes each point uniform over the numbers; chi-square of 32 x 32 cells, 6 standard deviations.
    samples = draw(np.arange(1 << 17), 3, 0)
    assert 0 <= samples.min() <= samples.max() < 1
    for pair in (*PAIRS, (0, 2), (1, 3), (2, 5), (0, 4)):
        counts, expected = count_in_cells(samples[:, pair], 32, 32), len(samples) / 1024
        chi_square = ((counts - expected) ** 2 / expected).sum()
        assert abs(chi_square - 1023) < 6 * np.sqrt(2 * 1023)


def test_pairs_seeds_and_numbers_are_independent(draw):
    count = 1 << 14
    drawn = [draw(*begin) for begin in ((0, np.arange(count), 0), (1, np.arange(count), 0), (0, np.arange(count), 1))]
    correlation = np.corrcoef(np.concatenate(drawn, axis=1).T.astype(np.float64))
    np.fill_diagonal(correlation, 0)
    # Independent columns would correlate by 1 / sqrt(count) = 0.008; those of one pair do far less.
    assert np.abs(correlation).max() < 6 / np.sqrt(count)


def test_a_scrambled_bit_depends_on_those_above_it_and_on_itself_alone(call):
    def scramble(numbers):
        return call("sampling/sampler.cl", "bits = scramble(number, seed);", "uint bits", number=numbers, seed=seeds)

    numbers, seeds = np.random.default_rng(22).integers(0, 1 << 32, (2, 500), dtype=np.uint32)
    for bit in range(32):
        changed = scramble(numbers) ^ scramble(numbers ^ np.uint32(1 << bit))
        assert (changed >> np.uint32(bit) == 1).all()
        # Each bit below is swapped for about half of the numbers.
        for below in range(max(bit - 12, 0), bit - 1):
            assert 0.3 < np.mean(changed >> np.uint32(below) & np.uint32(1)) < 0.7


SIDE = 8


@pytest.mark.parametrize("corner", [(0, 0), (SIDE, 3 * SIDE), (16384 - SIDE, 0)])
def test_the_pixels_of_a_square_share_out_the_points(call, corner):
    columns, rows = (begin + np.arange(SIDE) for begin in corner)
    begin = np.stack(np.meshgrid(columns, rows, np.arange(8), [5]), axis=-1).reshape(-1, 4).astype(np.uint32)
    body = """
        sobol_sampler_t sampler = make_screen_sampler(begin.x, begin.y, begin.z, begin.w);
        drawn = sample_2d(&sampler);
    """
    points = call("film/pixel.cl sampling/screen.cl", body, "float2 drawn", begin=begin)
    # 512 points, one in each cell of a grid of 16 x 32, and of one of 32 x 16.
    assert (count_in_cells(points, 16, 32) == 1).all()
    assert (count_in_cells(points, 32, 16) == 1).all()


ROWS = 1024

# The means of products of powers of x, y and z.
MOMENTS = {
    "disk": {(1, 0): 0, (0, 1): 0, (1, 1): 0, (2, 0): 1 / 4, (0, 2): 1 / 4, (4, 0): 1 / 8},
    "tent": {(1, 0): 0, (0, 1): 0, (1, 1): 0, (2, 0): 1 / 6, (0, 2): 1 / 6, (4, 0): 1 / 15, (0, 4): 1 / 15},
    # Of the density z / pi.
    "hemisphere": {(0, 0, 1): 2 / 3, (0, 0, 2): 1 / 2, (0, 0, 3): 2 / 5, (1, 0, 0): 0, (0, 1, 0): 0, (2, 0, 0): 1 / 4},
    "sphere": {(1, 0, 0): 0, (0, 0, 1): 0, (1, 1, 0): 0, (2, 0, 0): 1 / 3, (0, 0, 2): 1 / 3, (0, 4, 0): 1 / 5},
}


def warp(call, samples, width=0.5):
    """What samples, (n, 2), become: by name, in float64."""
    names = {"disk": 2, "tent": 2, "hemisphere": 3, "sphere": 3, "cone": 3}
    body = """
        disk = sample_disk(sample); tent = sample_tent_2d(sample); hemisphere = sample_hemisphere(sample);
        sphere = sample_sphere(sample); cone = sample_cone(sample, width);
    """
    outputs = ", ".join(f"float{length} {name}" for name, length in names.items())
    found = call("sampling/warps.cl", body, outputs, sample=np.float32(samples), width=[width])
    return {name: points.astype(np.float64) for name, points in zip(names, found, strict=True)}


def test_warps_have_their_densities_and_neighbours_stay_neighbours(call):
    # Means over the centres of the cells of a grid are integrals; roots are steep at an edge of the square.
    centres = (np.arange(ROWS) + 0.5) / ROWS
    grid = np.stack(np.meshgrid(centres, centres, indexing="ij"), axis=-1).reshape(-1, 2)
    found = warp(call, grid)
    for name, moments in MOMENTS.items():
        for powers, expected in moments.items():
            product = np.prod([found[name][:, axis] ** power for axis, power in enumerate(powers) if power], axis=0)
            assert abs(product.mean() - expected) < 3e-5, (name, powers)
    for name in ("hemisphere", "sphere"):
        np.testing.assert_allclose((found[name] ** 2).sum(axis=1), 1, rtol=0, atol=1e-6)
    assert found["hemisphere"][:, 2].min() > 0
    assert np.abs(found["tent"]).max() <= 1
    assert (found["disk"] ** 2).sum(axis=1).max() <= 1
    for axis in (0, 1):
        step = np.linalg.norm(np.diff(found["disk"].reshape(ROWS, ROWS, 2), axis=axis), axis=-1)
        assert step.max() < 3.2 / ROWS
    for width in (1e-5, 0.5, 1, 2):
        cone = warp(call, grid, width)["cone"]
        np.testing.assert_allclose((cone**2).sum(axis=1), 1, rtol=0, atol=1e-6)
        depth = 1 - cone[:, 2]
        assert depth.max() <= width + 1e-7
        # z is even from 1 - width to 1, and the mean of x^2 + y^2 = depth (2 - depth).
        np.testing.assert_allclose(depth.mean(), width / 2, rtol=0, atol=1e-7)
        np.testing.assert_allclose(cone[:, :2].mean(axis=0), 0, rtol=0, atol=1e-6 * np.sqrt(width))
        np.testing.assert_allclose((cone[:, :2] ** 2).mean(axis=0), (width - width**2 / 3) / 2, rtol=2e-6)


def test_corners_of_the_square(call):
    last = np.nextafter(np.float32(1), np.float32(0))
    found = warp(call, [[0, 0], [0, last], [last, 0], [last, last], [0.5, 0.5], [0.5, 0], [0, 0.5]])
    assert all(np.isfinite(points).all() for points in found.values())
    np.testing.assert_allclose(found["disk"][0], -np.sqrt([0.5, 0.5]), atol=1e-6)
    np.testing.assert_array_equal(found["disk"][4:], [[0, 0], [0, -1], [-1, 0]])
    np.testing.assert_array_equal(found["hemisphere"][4], [0, 0, 1])
    assert (found["hemisphere"][:, 2] >= 0).all()


def test_frames_are_orthonormal_and_right_handed_and_vectors_go_in_and_out(call):
    generator = np.random.default_rng(31)
    normals = generator.normal(size=(50_000, 3))
    # Close to both poles and to the equator, where the formula changes sides; and the axes.
    normals[:10_000, :2] *= np.geomspace(1e-12, 1, 10_000)[:, None]
    normals[10_000:20_000, 2] *= np.geomspace(1e-30, 1, 10_000)
    normals[-9:] = np.concatenate((np.eye(3), -np.eye(3), [[1, 0, -0.0], [0, 1, -0.0], [-0.0, -0.0, -1]]))
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    vectors = generator.normal(size=normals.shape).astype(np.float32)
    body = """
        const frame_t frame = frame_around(normal);
        tangent = frame.tangent; bitangent = frame.bitangent; third = frame.normal;
        outside = from_frame(&frame, vector); inside = to_frame(&frame, vector);
    """
    outputs = "float3 tangent, float3 bitangent, float3 third, float3 outside, float3 inside"
    *frames, outside, inside = call("sampling/frame.cl", body, outputs, normal=normals, vector=vectors)
    frames = np.stack(frames, axis=1).astype(np.float64)
    np.testing.assert_array_equal(frames[:, 2], normals)
    products = frames @ frames.transpose(0, 2, 1)
    np.testing.assert_allclose(products, np.broadcast_to(np.eye(3), products.shape), rtol=0, atol=4e-7)
    np.testing.assert_allclose(np.linalg.det(frames), 1, rtol=0, atol=4e-7)
    np.testing.assert_allclose(outside, np.einsum("ni,nij->nj", vectors, frames), rtol=0, atol=2e-6)
    np.testing.assert_allclose(inside, np.einsum("nj,nij->ni", vectors, frames), rtol=0, atol=2e-6)
