"""Sample points: the bits of the algorithms written in numpy, and how evenly the points are spread."""

import numpy as np
import pytest

SAMPLES = (np.float32, (6,))
BITS = (np.uint32, (4,))

# The columns of `samples` that one call of sample_2d fills, and those of sample_1d.
PAIRS = ((0, 1), (3, 4))
SINGLES = (2, 5)


@pytest.fixture(scope="module")
def draw(run_shell):
    """A function from number, sample index, seed and a fourth number, each broadcast, to samples and bits."""

    def run(number=0, sample_index=0, seed=0, fourth=0):
        begins = np.stack(np.broadcast_arrays(number, sample_index, seed, fourth), axis=-1).astype(np.uint32)
        return run_shell("draw_samples", [begins], [SAMPLES, BITS], "sampling_shells", {})

    return run


def count_in_cells(points, columns, rows):
    """How many points, (n, 2), each cell of a grid has."""
    cells = np.floor(points[:, 0].astype(np.float64) * columns) * rows + np.floor(
        points[:, 1].astype(np.float64) * rows
    )
    return np.bincount(cells.astype(int), minlength=columns * rows)


@pytest.mark.parametrize("seed", [0, 1, 77, 2**32 - 1])
@pytest.mark.parametrize("exponent", [0, 1, 2, 4, 6, 10])
def test_every_elementary_interval_has_one_of_the_first_points(draw, exponent, seed):
    count = 1 << exponent
    for number in (0, 1, 12345):
        samples, _ = draw(number, np.arange(count), seed)
        for pair in PAIRS:
            for power in range(exponent + 1):
                counts = count_in_cells(samples[:, pair], 1 << power, count >> power)
                np.testing.assert_array_equal(counts, 1)
        for column in SINGLES:
            np.testing.assert_array_equal(np.sort(np.floor(samples[:, column] * count)), np.arange(count))


def test_every_aligned_block_of_points_is_spread_as_evenly(draw):
    # A picture that is refined adds such blocks.
    samples, _ = draw(3, 64 + np.arange(64), 5)
    for pair in PAIRS:
        np.testing.assert_array_equal(count_in_cells(samples[:, pair], 8, 8), 1)


def test_samples_are_below_one(draw):
    samples, _ = draw(np.arange(100_000), 0, 9)
    assert samples.min() >= 0
    assert samples.max() < 1


def test_first_points_of_numbers_are_even_in_distribution(draw):
    # Scrambling makes each point uniform over the numbers; chi-square of 32 x 32 cells, 6 standard deviations.
    samples, _ = draw(np.arange(1 << 17), 3, 0)
    cells = 1024
    for pair in (*PAIRS, (0, 2), (1, 3), (2, 5), (0, 4)):
        counts = count_in_cells(samples[:, pair], 32, 32)
        expected = len(samples) / cells
        chi_square = ((counts - expected) ** 2 / expected).sum()
        assert abs(chi_square - (cells - 1)) < 6 * np.sqrt(2 * (cells - 1))


def test_pairs_seeds_and_numbers_are_independent(draw):
    count = 1 << 14
    base, _ = draw(0, np.arange(count), 0)
    others = [draw(1, np.arange(count), 0)[0], draw(0, np.arange(count), 1)[0]]
    columns = [base[:, column] for column in range(6)] + [other[:, column] for other in others for column in range(6)]
    correlation = np.corrcoef(np.array(columns, np.float64))
    np.fill_diagonal(correlation, 0)
    # Independent columns would correlate by 1 / sqrt(count) = 0.008; those of one pair do far less.
    assert np.abs(correlation).max() < 6 / np.sqrt(count)
    for other in others:
        assert not (base == other).all(axis=1).any()


def test_the_error_of_a_mean_falls_faster_than_that_of_random_points(draw):
    # Of a smooth integrand, the error of scrambled Sobol points falls by n^-1.5, that of random ones by n^-0.5.
    numbers, counts = np.arange(64), [16, 256]
    errors = []
    for count in counts:
        samples, _ = draw(*(part.ravel() for part in np.meshgrid(numbers, np.arange(count), indexing="ij")), 0)
        for pair in PAIRS:
            values = np.exp(samples[:, pair].astype(np.float64).sum(axis=1)).reshape(len(numbers), count)
            errors.append(np.sqrt(np.mean((values.mean(axis=1) - (np.e - 1) ** 2) ** 2)))
    for coarse, fine in zip(errors[:2], errors[2:], strict=True):
        assert fine < coarse / 16**1.2


def reverse_bits(x):
    return np.array([int(f"{value:032b}"[::-1], 2) for value in x.tolist()], np.uint32)


def hash_number(x):
    x = x ^ (x >> np.uint32(16))
    x = x * np.uint32(0x21F0AAAD)
    x = x ^ (x >> np.uint32(15))
    x = x * np.uint32(0xD35A2D97)
    return x ^ (x >> np.uint32(15))


def test_bits_are_those_of_numpy(draw):
    numbers = np.random.default_rng(21).integers(0, 1 << 32, 4000, dtype=np.uint32)
    _, bits = draw(0, 0, 0, numbers)
    np.testing.assert_array_equal(bits[:, 0], hash_number(numbers))
    np.testing.assert_array_equal(bits[:, 1], reverse_bits(numbers))


def test_the_second_dimension_is_that_of_sobol(draw):
    indices = np.arange(1 << 12)
    _, bits = draw(0, 0, 0, indices)
    # The direction numbers of the primitive polynomial x + 1 (Sobol, 1967): m becomes 2 m ^ m.
    expected, number = np.zeros(len(indices), np.uint32), 1
    for bit in range(12):
        expected ^= np.where(indices >> bit & 1, np.uint32(number << (31 - bit)), np.uint32(0))
        number ^= 2 * number
    np.testing.assert_array_equal(reverse_bits(bits[:, 2]), expected)


def test_a_scrambled_bit_depends_on_those_above_it_and_on_itself_alone(draw):
    generator = np.random.default_rng(22)
    for bit in range(32):
        numbers = generator.integers(0, 1 << 32, 500, dtype=np.uint32)
        seeds = generator.integers(0, 1 << 32, 500, dtype=np.uint32)
        _, before = draw(0, 0, seeds, numbers)
        _, after = draw(0, 0, seeds, numbers ^ np.uint32(1 << bit))
        changed = before[:, 3] ^ after[:, 3]
        assert (changed >> np.uint32(bit) == 1).all()
        # Each bit below is swapped for about half of the numbers.
        for below in range(max(bit - 12, 0), bit - 1):
            assert 0.3 < np.mean(changed >> np.uint32(below) & np.uint32(1)) < 0.7


def test_a_hash_changes_half_of_the_bits(draw):
    numbers = np.random.default_rng(23).integers(0, 1 << 32, 2000, dtype=np.uint32)
    _, before = draw(0, 0, 0, numbers)
    for bit in range(32):
        _, after = draw(0, 0, 0, numbers ^ np.uint32(1 << bit))
        changed = (before[:, 0] ^ after[:, 0])[:, None] >> np.arange(32, dtype=np.uint32) & 1
        assert np.abs(changed.mean(axis=0) - 0.5).max() < 0.08
