"""Powers of two by the bits of float64, against the library."""

import math

import numpy as np
import pytest

from clbvh.support.loop_functions import exponent_of, power_of_two, times_power_of_two

VALUES = [1.0, 1.5, 2.0, 3.999, 0.1, 1e300, 1e-300, np.finfo(float).max, np.finfo(float).tiny, 1e-310, 5e-324]


@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("sign", [1, -1])
def test_the_exponent_is_that_of_the_power_below(value, sign):
    assert exponent_of(sign * value) == math.frexp(value)[1] - 1
    # Scaled by its own exponent, every number is from 1 to 2.
    assert 1 <= times_power_of_two(value, -exponent_of(value)) < 2


def test_zero_has_an_exponent():
    assert exponent_of(0.0) == -1


@pytest.mark.parametrize("exponent", [-1022, -1, 0, 1, 52, 1023])
def test_a_power_is_exact(exponent):
    assert power_of_two(exponent) == math.ldexp(1.0, exponent)


@pytest.mark.parametrize("exponent", [-1100, -1074, -1023, -1022, 0, 1023])
@pytest.mark.parametrize("value", [1.0, 1.7, -1.25, 0.0])
def test_a_product_is_rounded_once(value, exponent):
    assert times_power_of_two(value, exponent) == math.ldexp(value, exponent)


def test_a_product_beyond_normal_powers():
    assert times_power_of_two(5e-324, 1074) == 1.0
    assert times_power_of_two(2.0**-1000, 2000) == 2.0**1000
