"""Any shapes, placed anywhere, any points: every layout gives the same answers, and they are those of the oracle."""

import warnings

import numpy as np
import pytest
from hypothesis import given, strategies as st

from clbvh import OpenMeshWarning
from clbvh.trace.world.trees import BRUTE
from clbvh.tree_layouts import TREE_LAYOUTS

from ..profiles import examples, seeds
from ..state_tracer import open_tracer
from ..unit.trace.scene_distances import SceneDistances
from ..unit.trace.scene_states import ALL
from .random_scenes import GRID, LINEAR, make_scene, random_scenes, scale_scene

POINTS = 80
CLOSED = ("cube", "ball", "spheres", "more spheres")


def make_points(scene):
    """Points on the grid and between, in and around instances, and a few far away."""
    generator, transforms = scene.generator, scene.state.transforms
    chosen = generator.integers(0, len(transforms), POINTS)
    local = generator.uniform(-GRID, GRID, (POINTS, 3))
    on_grid = generator.random(POINTS) < 0.5
    local[on_grid] = np.round(2 * local[on_grid]) / 2
    local *= generator.choice([1, 10, 1e5], (POINTS, 1), p=[0.8, 0.15, 0.05])
    return np.einsum("nij,nj->ni", transforms[chosen, :3, :3], local) + transforms[chosen, :3, 3]


def ask(tracer, points, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OpenMeshWarning)
        return [getattr(tracer, name)(points, **options) for name in ("closest_point", "contains", "signed_distance")]


def as_bytes(closest, *others):
    return [array.tobytes() for array in (*closest, closest.instance_id, closest.geometry_id, *others)]


def check(scene, opened, mask):
    """Compare all layouts with each other and with the oracle; return how many points are inside, and are sure."""
    points, answers = make_points(scene), {}
    for layout in (*TREE_LAYOUTS, BRUTE):
        with open_tracer(scene, opened.info, layout) as tracer:
            answers[layout] = ask(tracer, points, mask=mask)
    closest, contains, signed = answers[BRUTE]
    for layout in TREE_LAYOUTS:
        assert as_bytes(*answers[layout]) == as_bytes(closest, contains, signed), layout

    known, state, seen = SceneDistances(scene.state, points), scene.state, (scene.state.masks & np.uint32(mask)) != 0
    known.check_point(closest, seen)
    # Of coincident instances the first one is found.
    for instance in np.unique(closest.instance_id[closest.instance_id >= 0]):
        is_same = (state.transforms == state.transforms[instance]).all(axis=(1, 2)) & seen
        assert np.flatnonzero(is_same & (state.geometry_ids == state.geometry_ids[instance]))[0] == instance
    if not all(shape.is_watertight for shape in state.shapes):
        return 0, 0
    return np.count_nonzero(known.is_inside.any(axis=1)), known.check_insides(contains, signed, seen)


@pytest.mark.on_both
@examples(short=30, long=1000)
@given(scene=random_scenes(), mask=st.sampled_from([ALL, ALL, ALL, 1, 2, 4, 0]))
def test_layouts_and_the_oracle_agree(opened, scene, mask):
    check(scene, opened, mask)


@pytest.mark.parametrize("scale", [1.0, 1e-30, 1e30])
@pytest.mark.parametrize("seed", seeds(2))
def test_most_points_are_decided(opened, seed, scale):
    """So that the tests above can fail."""
    inside, sure = check(scale_scene(make_scene(seed, CLOSED, tuple(LINEAR)), scale), opened, ALL)
    assert sure > 0.5 * POINTS
    assert 0.1 * POINTS < inside < 0.9 * POINTS
