"""The quality `high`: what it is worth, and when it steps back."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import BuildOptions, Mesh, build, make_shape, sah_cost, validate_tree
from clbvh.builders.reinsertion import build_high as optimise
from clbvh.rendering.heat_map import mean_steps, open_counter
from clbvh.trace.hits.closest import count_steps


def cast(mesh, count=4000, seed=3):
    """Rays from anywhere in the mesh's box to anywhere."""
    generator = np.random.default_rng(seed)
    lower, upper = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    origins = lower + generator.random((count, 3)) * (upper - lower) + mesh.origin
    return origins, generator.normal(size=(count, 3))


@pytest.mark.parametrize(("name", "share"), [("palace", 0.92), ("boxes", 0.92), ("knot", 1.0)])
def test_rays_find_less_to_test(name, share):
    mesh = make_shape(name, triangles=50_000, seed=2)
    plain, high = build(mesh), build(mesh, quality="high")
    steps = []
    for bvh in (plain, high):
        with open_counter(bvh) as caster:
            steps.append(count_steps(caster, *cast(mesh)))
    before, after = steps
    assert mean_steps(after)["tests"] <= share * mean_steps(before)["tests"]
    assert (after["prim_id"] == before["prim_id"]).all()
    assert sah_cost(high) < share * sah_cost(plain)


def test_a_tree_that_would_be_too_deep_is_given_up(monkeypatch):
    mesh = make_shape("boxes", triangles=5000, seed=1)
    plain = build(mesh, bins=16)
    monkeypatch.setattr(optimise, "MAX_DEPTH", 3)
    high = build(mesh, bins=16, quality="high")
    assert high.nodes.tobytes() == plain.nodes.tobytes()
    assert high.prim_ids.tobytes() == plain.prim_ids.tobytes()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_triangles(count):
    mesh = Mesh.from_arrays(np.eye(3), np.tile(np.arange(3), (count, 1)))
    validate_tree(build(mesh, quality="high"), max_depth=count - 1)


def test_the_phases_are_timed():
    mesh = make_shape("icosphere", triangles=2000)
    timings, plain = build(mesh, quality="high").timings_ms, build(mesh).timings_ms
    assert list(timings) == [*plain, "finer bins", "expand_leaves", "reinsert", "collapse"]
    assert "finer bins" not in build(mesh, quality="high", bins=8).timings_ms


def test_the_options_know_the_word():
    assert BuildOptions(quality="high").quality == "high"
