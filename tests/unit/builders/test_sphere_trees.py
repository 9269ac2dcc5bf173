"""Trees over spheres, by every builder."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import BuildOptions, Spheres, validate_tree
from clbvh.builders.build import build_tree
from clbvh.builders.ladder.variants import VARIANTS
from clbvh.builders.options import MAX_DEPTH, QUALITIES


def make_spheres(count, seed=0):
    rng = np.random.default_rng([seed, count])
    return Spheres(rng.normal(size=(count, 3)), 10.0 ** rng.uniform(-3, -1, count))


RECIPES = [("sah", quality) for quality in QUALITIES] + [(name, "default") for name in VARIANTS]


@pytest.mark.parametrize(("builder", "quality"), RECIPES)
@pytest.mark.parametrize("count", [1, 2, 700])
def test_every_builder_builds_a_valid_tree_over_spheres(builder, quality, count):
    spheres = make_spheres(count)
    bvh = build_tree(spheres, builder, None, BuildOptions(quality=quality))
    validate_tree(bvh, max_depth=MAX_DEPTH)
    assert sorted(bvh.prim_ids.tolist()) == list(range(count))
    assert bvh.shape is spheres


@pytest.mark.parametrize(("builder", "quality"), [("sah", "default"), ("sah", "fast"), ("frontier", "default")])
def test_spheres_within_each_other_have_a_tree(builder, quality):
    spheres = Spheres(np.zeros((300, 3)), np.geomspace(1e-30, 1, 300))
    validate_tree(build_tree(spheres, builder, None, BuildOptions(quality=quality)), max_depth=MAX_DEPTH)
