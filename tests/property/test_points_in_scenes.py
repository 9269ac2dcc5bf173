"""Any shapes, placed anywhere: every layout finds the same closest points, and they are those of the oracle."""

import warnings

import numpy as np
import pytest
from hypothesis import given

from clbvh.errors import OpenMeshWarning
from clbvh.structs import LAYOUT_WIDTHS
from clbvh.trace.world.trees import BRUTE

from ..profiles import examples, seeds
from ..scene_points import ScenePoints
from ..state_tracer import open_tracer
from .random_scenes import LINEAR, RAY_MASKS, make_scene, random_scenes

# Float64 rounds placed coordinates, relative to the scene and the points.
ROUNDING = 2.0**-44


@pytest.fixture(scope="module")
def opened(_opened_device):
    return _opened_device


def ask(scene, opened, layout, points, mask):
    with open_tracer(scene, opened.info, layout) as tracer, warnings.catch_warnings():
        warnings.simplefilter("ignore", OpenMeshWarning)
        closest = tracer.closest_point(points, mask=mask)
        return {
            "distance": closest.distance,
            "point": closest.point,
            "prim_id": closest.prim_id,
            "geometry_id": closest.geometry_id,
            "instance_id": closest.instance_id,
            "contains": tracer.contains(points, mask=mask),
            "signed_distance": tracer.signed_distance(points, mask=mask),
        }


def check(scene, opened):
    """Compare all layouts with each other and with the oracle; return the number of points that are decided."""
    # Origins of rays are anywhere, in a box around the scene and on its surfaces.
    points = scene.origins[np.isfinite(scene.origins).all(axis=1)][:200]
    mask = int(scene.generator.choice(RAY_MASKS))
    answers = {layout: ask(scene, opened, layout, points, mask) for layout in (*LAYOUT_WIDTHS, BRUTE)}
    first, *others = answers
    for layout in others:
        for name, expected in answers[first].items():
            assert answers[layout][name].tobytes() == expected.tobytes(), (name, layout)
    found, oracle = answers[first], ScenePoints(scene.state, mask)
    expected = oracle.closest_point(points)
    np.testing.assert_array_equal(np.isinf(found["distance"]), np.isinf(expected.distance))
    is_seen = np.isfinite(expected.distance)
    reach = np.abs(points).max(initial=0) + np.abs(scene.state.transforms[:, :3]).max(initial=0)
    error = found["distance"][is_seen] - expected.distance[is_seen]
    assert (error >= -ROUNDING * reach).all()
    assert (error <= expected.slack[is_seen] + ROUNDING * reach).all()
    own = oracle.distance_to(points, found["instance_id"], found["prim_id"])
    np.testing.assert_allclose(own[is_seen], found["distance"][is_seen], rtol=0, atol=ROUNDING * reach)
    if not all(shape.is_watertight for shape in scene.state.shapes):
        return 0
    inside, is_decided = oracle.contains(points)
    np.testing.assert_array_equal(found["contains"][is_decided], inside[is_decided])
    signed, is_sure, slack = oracle.signed_distance(points)
    is_sure &= is_seen
    error = np.abs(found["signed_distance"][is_sure] - signed[is_sure])
    assert (error <= slack[is_sure] + ROUNDING * reach).all()
    return int(is_sure.sum())


@examples(short=20, long=1000)
@given(scene=random_scenes())
def test_layouts_and_the_oracle_agree(opened, scene):
    check(scene, opened)


@pytest.mark.parametrize("is_far", [False, True], ids=["near", "far"])
@pytest.mark.parametrize("seed", seeds(2))
def test_insides_of_closed_shapes(opened, seed, is_far):
    scene = make_scene(seed, ("cube", "ball", "spheres"), tuple(LINEAR), is_far=is_far)
    assert check(scene, opened) > 20
