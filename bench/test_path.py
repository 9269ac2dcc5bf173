"""Path tracing beside Mitsuba 3: the processor time until the pictures of both have the same error.

`pip install mitsuba` brings the scalar variant; the `llvm` ones need a newer LLVM than 16, such as 19, by the path in
the environment variable DRJIT_LIBLLVM_PATH.

The error of a picture is the mean of (x - y)^2 / (y^2 + 0.01) over all pixels and channels, y from many more samples.
"""

from __future__ import annotations

import importlib.util
import os
import statistics
from pathlib import Path

import numpy as np
import pytest

from clbvh.study.engines import Rival

from .path_engines import REFERENCE_SAMPLES, SAMPLE_COUNTS, make_cornell_box, make_statue, serve_mitsuba, serve_ours

SIDE = 128

# Of each engine; the mean of all is what pictures are compared with.
REFERENCE_PICTURES = 2

# Pictures of each count: the mean of their errors, and the median of their times.
RUNS = {4: 8, 16: 6, 64: 3, 256: 2}

# Mitsuba's default sampler, and the one of its others that has the most samples per second at equal error here.
VARIANTS = [("llvm_ad_rgb", "independent"), ("llvm_ad_rgb", "multijitter"), ("scalar_rgb", "independent")]

# Pixels at the edges have samples from one side alone in Mitsuba.
EDGE = 2

# The pictures of many samples differ by their noise: the share of the mean, and the relative error.
LARGEST_DIFFERENCE = 2e-3
LARGEST_ERROR = 1e-3


@pytest.fixture(scope="module", params=["cornell", "statue"])
def stage(request):
    """Return a closed box with a lamp, and the benchmark mesh under a white sky."""
    if request.param == "cornell":
        return make_cornell_box(SIDE)
    mesh = request.getfixturevalue("mesh")
    return make_statue(mesh.vertices, mesh.faces, SIDE)


def find_error(picture, reference):
    """Return the relative squared error."""
    inner = np.s_[EDGE:-EDGE, EDGE:-EDGE]
    return float(((picture - reference)[inner] ** 2 / (reference[inner] ** 2 + 0.01)).mean())


def draw_reference(engine):
    """Return the mean of pictures with many samples."""
    return np.mean(
        [engine.measure(str(REFERENCE_SAMPLES)).result[0].astype(np.float64) for _ in range(REFERENCE_PICTURES)], axis=0
    )


def measure_curves(engines, reference):
    """Return for each engine the errors and the seconds of processor time, by the counts of samples."""
    curves = [([], []) for _ in engines]
    for count in SAMPLE_COUNTS:
        pictures = [[engine.measure(str(count)).result for engine in engines] for _ in range(RUNS[count])]
        for (errors, times), drawn in zip(curves, zip(*pictures, strict=True), strict=True):
            errors.append(statistics.mean(find_error(picture, reference) for picture, _ in drawn))
            times.append(statistics.median(seconds for _, seconds in drawn))
    return curves


def time_of_error(curve, error):
    """Return the processor time after which an engine has an error, between its counts of samples or beyond them."""
    errors, times = np.log(curve[0]), np.log(curve[1])
    slope, start = np.polyfit(errors, times, 1)
    inside = errors.min() <= np.log(error) <= errors.max()
    return np.exp(np.interp(np.log(error), errors[::-1], times[::-1]) if inside else start + slope * np.log(error))


@pytest.mark.parametrize(("variant", "sampler"), VARIANTS, ids=["-".join(names) for names in VARIANTS])
def test_against_mitsuba(stage, variant, sampler):
    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip("mitsuba is not installed")
    if variant.startswith("llvm") and not Path(os.environ.get("DRJIT_LIBLLVM_PATH", "")).is_file():
        pytest.skip("the llvm variants need a libLLVM newer than 16 in DRJIT_LIBLLVM_PATH")
    with Rival(serve_ours, stage) as ours, Rival(serve_mitsuba, stage, variant, sampler) as theirs:
        ours.measure(str(SAMPLE_COUNTS[0]))
        references = [draw_reference(engine) for engine in (ours, theirs)]
        means = [reference.mean() for reference in references]
        print(f"\n{variant}, {sampler}: mean {means[0]:.5f}, peer {means[1]:.5f}")
        assert abs(means[0] / means[1] - 1) < LARGEST_DIFFERENCE
        assert find_error(*references) < LARGEST_ERROR
        curves = measure_curves((ours, theirs), np.mean(references, axis=0))
    for name, (errors, times) in zip(("ours", "peer"), curves, strict=True):
        for count, error, seconds in zip(SAMPLE_COUNTS, errors, times, strict=True):
            rate = SIDE**2 * count / seconds / 1e6
            print(f"{name} {count:4d} samples: error {error:.5f}, {seconds:.3f} s, {rate:.2f} million samples/s")
    ratios = [seconds / time_of_error(curves[0], error) for error, seconds in zip(*curves[1], strict=True)]
    print("rate at equal error, ours / peer: " + ", ".join(f"{ratio:.2f}" for ratio in ratios))
