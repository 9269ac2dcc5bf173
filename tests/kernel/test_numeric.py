"""The rules of arithmetic: what the device rounds is what numpy rounds."""

import numpy as np
import pytest

from clbvh.device.program import expand_source
from clbvh.support.folders import find_folder

KERNELS = sorted(path.stem for path in (find_folder("cl") / "kernels").glob("*.cl"))


def test_products_are_rounded_before_they_are_added(run_shell):
    factors = np.random.default_rng(1).uniform(-1, 1, (10_000, 4)).astype(np.float32)
    a, b, c, d = factors.T
    sums, differences = run_shell("round_off", [factors], [np.float32, np.float32])

    np.testing.assert_array_equal(sums, a * b + c)
    np.testing.assert_array_equal(differences, a * b - c * d)
    # Contraction would be seen: it rounds once, as float64 arithmetic followed by a cast does.
    wide = factors.astype(np.float64).T
    assert np.mean((wide[0] * wide[1] + wide[2]).astype(np.float32) != a * b + c) > 0.1


def test_equal_products_cancel(run_shell):
    pairs = np.random.default_rng(2).uniform(-1, 1, (10_000, 2)).astype(np.float32)
    _, differences = run_shell("round_off", [np.concatenate((pairs, pairs), axis=1)], [np.float32, np.float32])
    assert (differences == 0).all()


@pytest.mark.parametrize("name", KERNELS)
def test_every_kernel_forbids_contraction_before_it_computes(name):
    text = expand_source(f"kernels/{name}.cl")
    pragma = text.index("#pragma OPENCL FP_CONTRACT OFF")
    assert text.index("return") > pragma
    assert text.index(" = ") > pragma


def test_smaller_and_larger(run_shell):
    values = np.array([-np.inf, -3.4e38, -1, -0.5, 0, 1e-30, 0.5, 1, 3.4e38, np.inf], np.float32)
    pairs = np.stack(np.meshgrid(values, values), axis=-1).reshape(-1, 2)
    lesser, greater = run_shell("order_pairs", [pairs], [np.float32, np.float32])
    np.testing.assert_array_equal(lesser, pairs.min(axis=1))
    np.testing.assert_array_equal(greater, pairs.max(axis=1))


def test_nan_loses_in_the_first_place(run_shell):
    # The slab test relies on it.
    pairs = np.array([[np.nan, 3], [np.nan, -np.inf], [np.nan, np.inf]], np.float32)
    for result in run_shell("order_pairs", [pairs], [np.float32, np.float32]):
        np.testing.assert_array_equal(result, pairs[:, 1])
