"""Any meshes, each placed once, so that they are merged: every layout finds the hits of the oracle."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from clbvh import Tracer
from clbvh.structs import LAYOUT_WIDTHS

from ..profiles import examples, seeds
from ..scene_points import ScenePoints
from ..unit.trace.scene_states import affine, make_state
from .random_scenes import GRID, KINDS, LINEAR, MASKS, MESH_KINDS, RAYS, RandomScene, make_rays, scale_scene
from .test_scenes import check_against_the_oracle, compare_layouts, make_limits

# How far apart the meshes are, in units of the grid: from one place to the widest group.
SPREADS = (0, 1, 5, 20, 40)


def make_single_scene(seed, spread, linear=tuple(LINEAR)):
    """Eight meshes and a group of spheres, each placed once."""
    generator = np.random.default_rng(seed)
    kinds = [*generator.choice(list(MESH_KINDS), 8), "spheres"]
    placed = []
    for index, _ in enumerate(kinds):
        offset = spread * generator.integers(-GRID, GRID, 3, endpoint=True)
        matrix = affine(LINEAR[generator.choice(linear)](generator), offset)
        placed.append((index, matrix, int(generator.choice(MASKS)) if generator.random() < 0.2 else MASKS[0]))
    state = make_state([KINDS[kind](generator) for kind in kinds], *placed)
    call = f"make_single_scene({seed}, {spread}, {linear})"
    return RandomScene(call, state, *make_rays(state, generator), generator)


def check(scene, opened):
    """Return how many instances are merged, and for how many rays the closest hit is decided."""
    with Tracer(scene.contents(), device=opened.info) as tracer:
        first = tracer.closest_hit(scene.origins, scene.directions)
        radii = tracer._caster.tree.merging.measure_radii(scene.state.instance_count)
    limits = make_limits(scene, first)
    answers = compare_layouts(scene, opened, limits, LAYOUT_WIDTHS)
    return int((radii > 0).sum()), check_against_the_oracle(scene, answers, limits, radii)


@pytest.fixture(scope="module")
def opened(_opened_device):
    return _opened_device


@examples(short=30, long=2000)
@given(
    seed=st.integers(0, 2**32 - 1), spread=st.sampled_from(SPREADS), scale=st.sampled_from([1.0, 2.0**99, 1e-30, 1e30])
)
def test_layouts_and_the_oracle_agree(opened, seed, spread, scale):
    check(scale_scene(make_single_scene(seed, spread), scale), opened)


@pytest.mark.parametrize("spread", SPREADS)
@pytest.mark.parametrize("seed", seeds(2))
def test_most_are_merged_and_most_rays_are_decided(opened, seed, spread):
    """So that the test above can fail."""
    merged, decided = check(make_single_scene(seed, spread, ("right turn", "turn")), opened)
    assert merged >= 3
    assert decided > 0.2 * 2 * RAYS


@examples(short=15, long=500)
@given(seed=st.integers(0, 2**32 - 1), spread=st.sampled_from(SPREADS))
def test_closest_points_are_those_of_the_oracle(opened, seed, spread):
    scene = make_single_scene(seed, spread)
    visible = scene.state.masks != 0
    with Tracer(scene.contents(), device=opened.info) as tracer:
        found = tracer.closest_point(scene.origins)
        radii = tracer._caster.tree.merging.measure_radii(scene.state.instance_count)
    expected = ScenePoints(scene.state, merged_radii=radii).closest_point(scene.origins)
    assert visible.any()
    assert (np.abs(found.distance - expected.distance) <= expected.slack).all()
