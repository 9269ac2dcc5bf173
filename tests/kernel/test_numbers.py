"""Numbers on the device: what it rounds is what numpy rounds, and structs lie where the host has them."""

import math
from itertools import product

import numpy as np
import pytest

from clbvh.device.sources import expand_source
from clbvh.structs import DEVICE_STRUCTS
from clbvh.support.folders import find_folder
from clbvh.tree_layouts import LAYOUTS, WIDE_LAYOUTS

pytestmark = pytest.mark.on_both


def test_products_are_rounded_before_they_are_added(call):
    factors = np.random.default_rng(1).uniform(-1, 1, (10_000, 4)).astype(np.float32)
    factors[5000:, 2:] = factors[5000:, :2]
    a, b, c, d = factors.T
    body = "total = f.x * f.y + f.z; difference = f.x * f.y - f.z * f.w;"
    totals, differences = call("math/numeric.cl", body, "float total, float difference", f=factors)
    np.testing.assert_array_equal(totals, a * b + c)
    np.testing.assert_array_equal(differences, a * b - c * d)
    assert (differences[5000:] == 0).all()
    # Contraction would be seen: it rounds once, as float64 arithmetic followed by a cast does.
    wide = factors.astype(np.float64).T
    assert np.mean((wide[0] * wide[1] + wide[2]).astype(np.float32) != a * b + c) > 0.1


def test_every_kernel_forbids_contraction_before_it_computes():
    for path in (find_folder("cl") / "kernels").glob("*.cl"):
        text = expand_source(f"kernels/{path.name}")
        pragma = text.index("#pragma OPENCL FP_CONTRACT OFF")
        assert min(text.index("return"), text.index(" = ")) > pragma, path.name


def test_the_smaller_and_the_larger_and_nan_loses_in_the_first_place(call):
    values = np.array([-np.inf, -3.4e38, -1, -0.5, 0, 1e-30, 0.5, 1, 3.4e38, np.inf], np.float32)
    pairs = np.stack(np.meshgrid([*values, np.nan], values), axis=-1).reshape(-1, 2)
    body = "lesser = smaller(a, b); greater = larger(a, b);"
    lesser, greater = call("math/numeric.cl", body, "float lesser, float greater", a=pairs[:, 0], b=pairs[:, 1])
    np.testing.assert_array_equal(lesser, np.fmin(*pairs.T))
    np.testing.assert_array_equal(greater, np.fmax(*pairs.T))


@pytest.mark.parametrize("portable", [{}, {"PORTABLE": 1}], ids=["built-in", "portable"])
@pytest.mark.parametrize("layout", WIDE_LAYOUTS)
def test_lanes_become_bits(call, layout, portable):
    width = LAYOUTS[layout].width
    masks = np.arange(2**width)
    is_set = (masks[:, None] >> np.arange(width)) & 1
    values = np.where(is_set, -1, np.where(np.arange(width) % 2, 0, np.nan))
    body = "bits = mask_bits(lanes < 0.0f); lowest = bits == 0 ? -1 : lowest_bit(bits);"
    includes = "traversal/traverse.cl math/lanes.cl"
    bits, lowest = call(includes, body, "uint bits, int lowest", lanes=values, layout=layout, defines=portable)
    np.testing.assert_array_equal(bits, masks)
    np.testing.assert_array_equal(lowest, np.where(is_set.any(axis=1), is_set.argmax(axis=1), -1))


def turned(turns):
    """Sines and cosines of float32 turns in float64; whole turns are taken off exactly."""
    angle = 2 * np.pi * (turns.astype(np.float64) - np.rint(turns.astype(np.float64)))
    return np.stack((np.sin(angle), np.cos(angle)), axis=1)


def test_sines_and_cosines_have_the_stated_error(call):
    generator = np.random.default_rng(11)
    turns = [generator.uniform(-reach, reach, 100_000) for reach in (1e-20, 1e-3, 0.6, 1, 4, 1000, 1e6)]
    turns = np.concatenate((np.geomspace(1e-30, 0.1, 100_000), np.arange(-40, 41) / 4, *turns)).astype(np.float32)
    sines = call("math/trigonometry.cl", "sines = sin_cos_turns(turns);", "float2 sines", turns=turns)
    np.testing.assert_allclose(sines, turned(turns), rtol=0, atol=1e-7)
    # Small sines keep their digits, and quarter turns are exact.
    np.testing.assert_allclose(sines[:100_000, 0], turned(turns[:100_000])[:, 0], rtol=2.5e-7)
    cycle = np.array([[0, 1], [1, 0], [0, -1], [-1, 0]])
    np.testing.assert_array_equal(sines[100_000:100_081], cycle[np.arange(-40, 41) % 4])


def test_arctangents_have_the_stated_error(call):
    vectors = np.random.default_rng(13).normal(size=(200_000, 2))
    # Thin angles and their neighbours, on all sides of both axes and of the diagonals; and the axes.
    vectors[:20_000, 0] *= np.geomspace(1e-6, 1, 20_000)
    vectors[20_000:40_000, 1] *= np.geomspace(1e-6, 1, 20_000)
    vectors[40_000:60_000, 0] = vectors[40_000:60_000, 1] * np.linspace(-2.5, 2.5, 20_000)
    vectors[:8] = [[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, 1], [1, -1], [0, 0]]
    for scale in (1e-30, 1, 1e30):
        x, y = (scale * vectors).astype(np.float32).T
        angles = call("math/trigonometry.cl", "angle = arctangent2(y, x);", "float angle", x=x, y=y)
        np.testing.assert_allclose(angles, np.arctan2(*np.float64([y, x])), rtol=2e-7)


def test_arccosines_have_the_stated_error_and_are_limited_beyond_one(call):
    near_one = 1 - np.geomspace(1e-7, 1, 50_000)
    cosines = np.concatenate((np.linspace(-2, 2, 200_001), near_one, -near_one)).astype(np.float32)
    angles = call("math/trigonometry.cl", "angle = arccosine(x);", "float angle", x=cosines)
    np.testing.assert_allclose(angles, np.arccos(np.clip(cosines.astype(np.float64), -1, 1)), rtol=2.5e-7)


def scalars_of(dtype):
    """The C expression of every scalar of a struct, and whether it is a float."""
    for name in dtype.names:
        for index in product(*map(range, dtype[name].shape)):
            yield name + "".join(f"[{place}]" for place in index), dtype[name].base == np.float32


@pytest.mark.parametrize("name", DEVICE_STRUCTS)
def test_every_field_is_where_the_device_looks_for_it(call, name):
    dtype = DEVICE_STRUCTS[name]
    scalars = list(scalars_of(dtype))
    # No two scalars are equal, and a float that is converted to an integer on the way does not survive.
    given = np.zeros(3, dtype)
    numbers = iter(range(1, 1 + 3 * len(scalars)))
    for row, field in product(range(3), dtype.names):
        half = 0.5 if dtype[field].base == np.float32 else 0
        values = [next(numbers) + half for _ in range(given[field][row].size)]
        given[field][row] = np.reshape(values, dtype[field].shape)
    reads = [f"lanes[{n}] = {'as_int' * is_float}(given->{text});" for n, (text, is_float) in enumerate(scalars)]
    writes = [f"made.{text} = {'as_float' * is_float}(lanes[{n}]);" for n, (text, is_float) in enumerate(scalars)]
    body = f"size = sizeof({name}); {' '.join(reads + writes)}"
    outputs = f"int size, {name} made, int lanes[{max(len(scalars), 9)}]"
    sizes, made, lanes = call("structs.cl", body, outputs, given=given)
    expected = np.concatenate([given[field].reshape(3, -1).view(np.int32) for field in dtype.names], axis=1)
    np.testing.assert_array_equal(lanes[:, : len(scalars)], expected)
    assert (sizes == dtype.itemsize).all()
    assert made.tobytes() == given.tobytes()


def test_powers_of_two_are_those_of_the_library(call):
    values = np.array([5e-324, 3e-320, 2.0**-1022, 1e-300, 0.1, 1.0, 1.5, 2.0, 3.9, 2.0**64, 1e300, 1.7e308])
    values = np.concatenate((values, -values))
    body = "exponent = exponent_of(value); scaled = times_power_of_two(value, -exponent);"
    exponents, scaled = call("math/doubles.cl", body, "int exponent, double scaled", value=values, has_doubles=True)
    assert exponents.tolist() == [math.frexp(value)[1] - 1 for value in values]
    assert scaled.tolist() == [math.ldexp(value, 1 - math.frexp(value)[1]) for value in values]
    # A product is rounded once, and may be beyond normal powers.
    cases = [(1.7, power) for power in (-1100, -1074, -1023, -1022, 0, 1023)] + [(5e-324, 1074), (2.0**-1000, 2000)]
    factors, powers = (np.array(column) for column in zip(*cases, strict=True))
    body = "product = times_power_of_two(factor, power);"
    given = {"factor": factors, "power": powers.astype(np.int32)}
    products = call("math/doubles.cl", body, "double product", has_doubles=True, **given)
    assert products.tolist() == [math.ldexp(*case) for case in cases]
