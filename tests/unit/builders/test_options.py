"""The options of a build: their limits, and what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from clbvh import BuildOptions, Mesh, build
from clbvh.builders.build import find_builder
from clbvh.builders.options import MAX_BINS, MAX_FRONTIER, MAX_LEAF_SIZE, MIN_BINS, MIN_FRONTIER, QUALITIES
from clbvh.errors import ConfigError
from clbvh.rendering.options import RenderOptions


def test_defaults_are_allowed_and_fixed():
    options = BuildOptions()
    assert (options.bins, options.leaf_size, options.traversal_cost, options.task_threshold) == (None, 4, 1.0, None)
    assert (options.frontier, options.quality) == (64, "default")
    with pytest.raises(dataclasses.FrozenInstanceError):
        options.bins = 8


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("bins", MIN_BINS),
        ("bins", MAX_BINS),
        ("leaf_size", 1),
        ("leaf_size", MAX_LEAF_SIZE),
        ("traversal_cost", 1e-300),
        ("traversal_cost", 1e300),
        ("task_threshold", 1),
        ("task_threshold", 2**40),
        ("frontier", MIN_FRONTIER),
        ("frontier", MAX_FRONTIER),
    ],
)
def test_the_ends_of_each_range_are_allowed(name, value):
    assert getattr(BuildOptions(**{name: value}), name) == value


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("bins", MIN_BINS - 1),
        ("bins", MAX_BINS + 1),
        ("bins", -16),
        ("leaf_size", 0),
        ("leaf_size", MAX_LEAF_SIZE + 1),
        ("traversal_cost", 0),
        ("traversal_cost", -1.0),
        ("traversal_cost", float("inf")),
        ("traversal_cost", float("nan")),
        ("task_threshold", 0),
        ("task_threshold", -5),
        ("frontier", MIN_FRONTIER - 1),
        ("frontier", MAX_FRONTIER + 1),
    ],
)
def test_what_lies_outside_is_refused_by_name_and_value(name, value):
    with pytest.raises(ConfigError, match=rf"{name} must be .*not {value}"):
        BuildOptions(**{name: value})


@pytest.mark.parametrize("name", ["bins", "leaf_size", "traversal_cost", "task_threshold", "frontier"])
@pytest.mark.parametrize("value", ["8", [8], True, 8 + 0j])
def test_what_is_no_number_is_refused(name, value):
    with pytest.raises(ConfigError, match=f"{name} must be a .*number"):
        BuildOptions(**{name: value})


@pytest.mark.parametrize("name", ["bins", "leaf_size", "task_threshold", "frontier"])
@pytest.mark.parametrize("value", [8.0, 8.5, np.float64(8)])
def test_counts_are_whole_numbers(name, value):
    with pytest.raises(ConfigError, match=f"{name} must be a whole number"):
        BuildOptions(**{name: value})


@pytest.mark.parametrize("name", ["leaf_size", "traversal_cost", "frontier"])
def test_none_is_for_bins_and_the_threshold_only(name):
    assert BuildOptions(bins=None, task_threshold=None) == BuildOptions()
    with pytest.raises(ConfigError, match=name):
        BuildOptions(**{name: None})


def test_numpy_numbers_become_plain_ones():
    options = BuildOptions(np.int64(8), np.uint8(3), np.float32(2), np.int16(100), np.uint16(500))
    assert dataclasses.astuple(options) == (8, 3, 2.0, 100, 500, "default")
    assert [type(value) for value in dataclasses.astuple(options)] == [int, int, float, int, int, str]


def test_every_quality_has_its_build():
    options = [BuildOptions(quality=quality) for quality in QUALITIES]
    assert [one.quality for one in options] == list(QUALITIES)
    builds = [find_builder("sah", one) for one in options]
    assert [build.__name__ for build in builds] == ["build_hlbvh", "build_sah", "build_high"]


@pytest.mark.parametrize("value", ["best", "Default", "", None, 1, ["default"]])
def test_an_unknown_quality_is_refused(value):
    with pytest.raises(ConfigError, match="quality must be one of fast, default, high") as caught:
        BuildOptions(quality=value)
    assert str(caught.value).endswith(f"not {value!r}")


def test_a_variant_of_the_ladder_refuses_another_quality():
    mesh = Mesh.from_arrays(np.eye(3), [[0, 1, 2]])
    with pytest.raises(ConfigError, match="the builder median has one quality, default: leave 'fast' out"):
        build(mesh, builder="median", quality="fast")
    with pytest.raises(ConfigError, match="the builder brute has one quality"):
        RenderOptions(builder="brute", build=BuildOptions(quality="fast"))
    assert build(mesh, builder="median", quality="default").depth == 0


def test_a_build_refuses_the_same_and_an_unknown_builder():
    mesh = Mesh.from_arrays(np.eye(3), [[0, 1, 2]])
    with pytest.raises(ConfigError, match="bins must be 2 to 64, not 1"):
        build(mesh, bins=1)
    with pytest.raises(ConfigError, match=r"builder must be one of sah, sequential, .*, frontier, not 'magic'"):
        build(mesh, builder="magic")
