"""Any shapes, placed anywhere, any points: every layout gives the same answers, and they are those of the oracle."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from clbvh import Tracer
from clbvh.structs import LAYOUT_WIDTHS

from ..profiles import examples, seeds
from ..scene_points import ScenePoints
from ..unit.trace.scene_states import ALL
from .random_scenes import GRID, LINEAR, make_scene, random_scenes, scale_scene

POINTS = 80
CLOSED = ("cube", "ball", "spheres", "more spheres")
QUERIES = ("closest_point", "contains", "signed_distance")

# Float64's own rounding of a distance, as a share of the coordinates.
EXACT = 2.0**-44


@pytest.fixture(scope="module")
def opened(_opened_device):
    return _opened_device


def make_points(scene):
    """Points on the grid and between, in and around instances, and a few far away."""
    generator, transforms = scene.generator, scene.state.transforms
    chosen = generator.integers(0, len(transforms), POINTS)
    local = generator.uniform(-GRID, GRID, (POINTS, 3))
    on_grid = generator.random(POINTS) < 0.5
    local[on_grid] = np.round(2 * local[on_grid]) / 2
    local *= generator.choice([1, 10, 1e5], (POINTS, 1), p=[0.8, 0.15, 0.05])
    return np.einsum("nij,nj->ni", transforms[chosen, :3, :3], local) + transforms[chosen, :3, 3]


def ask(scene, points, opened, layout, mask):
    with Tracer(scene.contents(), device=opened.info, layout=layout) as tracer:
        return {query: getattr(tracer, query)(points, mask=mask) for query in QUERIES}


def as_bytes(answer):
    if isinstance(answer, np.ndarray):
        return [answer.tobytes()]
    names = ("distance", "point", "prim_id", "geometry_id", "instance_id")
    return [np.asarray(getattr(answer, name)).tobytes() for name in names]


def check_closest(scene, points, found, mask):
    """Compare the closest points with the oracle's; return the number of points whose instance is decided."""
    oracle = ScenePoints(scene.state, mask=mask)
    expected = oracle.closest_point(points)
    is_found = found.instance_id >= 0
    np.testing.assert_array_equal(is_found, expected.instance_id >= 0)
    assert (found.distance[~is_found] == np.inf).all()
    assert (found.prim_id[~is_found] == -1).all()
    assert (found.geometry_id[~is_found] == -1).all()
    if not is_found.any():
        return 0
    geometry_ids = scene.state.geometry_ids[found.instance_id[is_found]]
    np.testing.assert_array_equal(found.geometry_id[is_found], geometry_ids)

    # No primitive is nearer by more than the slack, and the distance is that of the primitive, and of the point.
    distance, nearest = found.distance[is_found], expected.distance[is_found]
    assert (distance <= nearest + expected.slack[is_found]).all()
    own = oracle.distance_to(points, found.instance_id, found.prim_id)[is_found]
    lengths = np.linalg.norm(found.point - points, axis=1)[is_found]
    rounding = EXACT * (np.abs(points).max(axis=1) + np.abs(found.point).max(axis=1))[is_found]
    assert (np.abs(distance - own) <= rounding).all()
    assert (np.abs(distance - lengths) <= rounding).all()

    # Of coincident instances the first one is found.
    visible = (scene.state.masks & np.uint32(mask)) != 0
    for instance in np.unique(found.instance_id[is_found]):
        same = (scene.state.transforms == scene.state.transforms[instance]).all(axis=(1, 2)) & visible
        same &= scene.state.geometry_ids == scene.state.geometry_ids[instance]
        assert np.flatnonzero(same)[0] == instance
    return int((expected.slack < 1e-3 * expected.distance).sum())


def check(scene, opened, mask):
    points = make_points(scene)
    answers = {layout: ask(scene, points, opened, layout, mask) for layout in LAYOUT_WIDTHS}
    first, *others = LAYOUT_WIDTHS
    for layout in others:
        for query, expected in answers[first].items():
            assert as_bytes(answers[layout][query]) == as_bytes(expected), (layout, query)
    certain = check_closest(scene, points, answers[first]["closest_point"], mask)

    is_inside, is_decided = ScenePoints(scene.state, mask=mask).contains(points)
    found = answers[first]["contains"]
    np.testing.assert_array_equal(found[is_decided], is_inside[is_decided])
    distance, is_certain, slack = ScenePoints(scene.state, mask=mask).signed_distance(points)
    signed = answers[first]["signed_distance"]
    is_seen = np.isfinite(distance)
    assert (signed[~is_seen] == -np.inf).all()
    is_certain &= is_seen
    assert (np.abs(signed[is_certain] - distance[is_certain]) <= slack[is_certain]).all()
    return certain, is_decided.sum(), is_inside.sum()


@examples(short=25, long=1000)
@given(scene=random_scenes(kinds=CLOSED), mask=st.sampled_from([ALL, ALL, 1, 2, 4]))
def test_layouts_and_the_oracle_agree(opened, scene, mask):
    check(scene, opened, mask)


@examples(short=15, long=500)
@given(scene=random_scenes())
def test_closest_points_of_open_meshes_too(opened, scene):
    points = make_points(scene)
    with Tracer(scene.contents(), device=opened.info) as tracer:
        check_closest(scene, points, tracer.closest_point(points), ALL)


@pytest.mark.parametrize("scale", [1.0, 1e-30, 1e30])
@pytest.mark.parametrize("seed", seeds(2))
def test_most_points_are_decided(opened, seed, scale):
    """So that the tests above can fail."""
    scene = scale_scene(make_scene(seed, CLOSED, tuple(LINEAR)), scale)
    certain, decided, inside = check(scene, opened, ALL)
    assert certain > 0.5 * POINTS
    assert decided > 0.7 * POINTS
    assert 0.1 * POINTS < inside < 0.9 * POINTS


@pytest.mark.parametrize("seed", seeds(3))
def test_each_geometry_alone(opened, seed):
    scene = make_scene(seed, CLOSED, tuple(LINEAR))
    points = make_points(scene)
    contents = scene.contents()
    with Tracer(contents, device=opened.info) as tracer:
        for geometry in contents.geometries:
            mine = scene.state.geometry_ids == geometry.id
            masks = np.where(mine, scene.state.masks, 0).astype(np.uint32)
            alone = scene.state.__class__(**{**vars(scene.state), "masks": masks})
            found = tracer.closest_point(points, geometry=geometry)
            expected = ScenePoints(alone).closest_point(points)
            assert set(np.unique(found.geometry_id)) <= {geometry.id, -1}
            assert (found.distance <= expected.distance + expected.slack).all()
            is_inside, is_decided = ScenePoints(alone).contains(points)
            obtained = tracer.contains(points, geometry=geometry)
            np.testing.assert_array_equal(obtained[is_decided], is_inside[is_decided])
