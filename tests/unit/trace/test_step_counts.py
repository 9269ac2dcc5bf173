"""What rays cost: by hand on tiny trees, by formula on regular ones, in worlds of instances, and what they hit."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Mesh, RenderOptions, Spheres, Tracer, build, make_shape
from clbvh.builders.build import build_shape
from clbvh.rendering.built_scene import BuiltScene
from clbvh.rendering.heat_map import mean_steps, open_counter
from clbvh.structs import LAYOUT_WIDTHS
from clbvh.trace.hits.closest import count_steps

from ...rays import centred, hard_rays
from ...soup import make_soup
from ...state_tracer import StateTracer
from ..hand_made import make_leaf, make_tree
from .scene_states import affine, make_state, random_linear

DOWN = [0.0, 0.0, -1.0]
ABOVE = 10.0
TRIANGLE = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])


@pytest.fixture
def count(session):
    """Count the steps of rays at a tree or a state."""

    def count_in(source, origins, directions, layout="bvh2"):
        world = BuiltScene(source, RenderOptions()) if hasattr(source, "shapes") else source
        with open_counter(world, session.info, layout) as caster:
            return count_steps(caster, origins, directions)

    return count_in


@pytest.fixture
def cast_down(count):
    def count_at(source, *at, layout="bvh2"):
        return count(source, [[x, y, ABOVE] for x, y in at], DOWN, layout).tolist()

    return count_at


def per_ray(steps):
    means = mean_steps(steps)
    return means["node_steps"] + means["leaf_visits"]


@pytest.mark.parametrize(
    ("x", "expected"),
    [
        (0.25, (1, 1, 2, 0)),  # the box of the first leaf only
        (6.25, (2, 1, 1, 3)),  # the other child, and one of its leaves
        (9.0, (1, 0, 0, -1)),  # neither child: the root's step is all
        # Both children; the second one's box is entered first. It has the hit; what was pushed is visited all the same.
        (2.25, (2, 2, 3, 1)),
    ],
)
def test_the_hand_made_tree(cast_down, x, expected):
    assert cast_down(make_tree(), (x, 0.25)) == [expected]


@pytest.mark.parametrize("layout", LAYOUT_WIDTHS)
@pytest.mark.parametrize("prims", [1, 3, 4])
def test_a_tree_that_is_one_leaf(cast_down, prims, layout):
    assert cast_down(make_leaf(prims), (0.25, 0.25), (50.0, 0.25), layout=layout) == [(1, 1, prims, 0), (1, 0, 0, -1)]


@pytest.mark.parametrize("prims", [2, 5, 64])
def test_a_ray_through_every_box_and_no_triangle(count, prims):
    """Triangles one behind the other, which leave half of their boxes' faces free."""
    corners = np.zeros((prims, 3, 3))
    corners[:, :, 0] = np.arange(prims)[:, None]
    corners[:, 1, 1] = corners[:, 2, 2] = 1
    mesh = Mesh.from_arrays(corners.reshape(-1, 3), np.arange(3 * prims).reshape(-1, 3))
    # From before all, and from within: only what lies ahead.
    steps = count(build(mesh, leaf_size=1), [[-1, 0.9, 0.9], [prims - 1.5, 0.9, 0.9]], [1, 0, 0])
    assert steps[0].tolist() == (prims - 1, prims, prims, -1)
    assert steps[1].tolist()[1:3] == (1, 1)


def test_means(count):
    steps = count(make_tree(), [[0.25, 0.25, ABOVE], [2.25, 0.25, ABOVE]], DOWN)
    assert mean_steps(steps) == {"node_steps": 1.5, "leaf_visits": 1.5, "triangle_tests": 2.5, "tests": 4.0}
    nothing = count(make_tree(), np.empty((0, 3)), np.empty((0, 3)))
    assert set(mean_steps(nothing).values()) == {0.0}


@pytest.mark.parametrize("seed", [3])
def test_wide_trees_have_fewer_and_larger_steps(count, seed):
    mesh = centred(make_soup(2000, seed, grid=200))
    bvh = build(mesh)
    rays = hard_rays(mesh, 6000, np.random.default_rng(seed))
    with Tracer(bvh) as tracer:
        prim_id = tracer.closest_prim(*rays)
    before = np.inf
    for layout, width in LAYOUT_WIDTHS.items():
        steps = count(bvh, *rays, layout)
        np.testing.assert_array_equal(steps["prim_id"], prim_id)
        assert mean_steps(steps)["node_steps"] < before
        before = mean_steps(steps)["node_steps"]
        if width > 2:
            assert (steps["prim_tests"] >= steps["leaf_visits"]).all()
            assert (steps["prim_tests"] <= width * steps["leaf_visits"]).all()


def test_bad_rays_are_refused(count):
    with pytest.raises(ValueError, match=r"directions\[1\] has length zero"):
        count(make_tree(), np.zeros((2, 3)), [[1, 0, 0], [0, 0, 0]])


@pytest.mark.parametrize("seed", [2])
@pytest.mark.parametrize("name", ["knot", "blobs", "boxes", "icosphere", "terrain", "palace"])
def test_axis_parallel_rays_visit_no_more_than_slightly_turned_ones(count, name, seed):
    """A slab test that lets 0 x infinity through makes them visit nearly every leaf."""
    mesh = make_shape(name, triangles=20_000, seed=seed)
    bvh = build(mesh)
    generator = np.random.default_rng(seed)
    lower, upper = (corner.astype(np.float64) for corner in (mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)))
    axis = np.arange(6000) % 3
    sign = np.where(np.arange(6000) % 2 == 0, 1.0, -1.0)
    directions = np.zeros((6000, 3))
    directions[np.arange(6000), axis] = sign
    directions[directions == 0] *= np.where(generator.random(12_000) < 0.5, 1, -1)  # zeros of both signs
    # Half of them in planes in which vertices lie, and so do sides of boxes.
    targets = lower + generator.random((6000, 3)) * (upper - lower)
    if name not in ("palace", "terrain"):  # whose vertices share whole planes, which a turned ray leaves
        targets[::2] = mesh.vertices[generator.integers(0, len(mesh.vertices), 3000)]
    reach = 2 * float((upper - lower).max())
    turned = directions + 2e-3 * generator.normal(size=(6000, 3)) * (directions == 0)
    along, aslant = (per_ray(count(bvh, targets - reach * way + mesh.origin, way)) for way in (directions, turned))
    assert along <= 1.1 * aslant


def test_two_triangles_one_above_the_other(cast_down):
    """The root of the tree over both, and that of each instance, are a step each; behind a hit no leaf is visited."""
    state = make_state([TRIANGLE], (0, affine()), (0, affine(offset=(0, 0, 2))))
    hit, beside_both, past = (3, 1, 1, 0), (3, 2, 2, -1), (1, 0, 0, -1)
    assert cast_down(state, (0.25, 0.25), (0.75, 0.75), (3.0, 3.0)) == [hit, beside_both, past]


def test_instances_that_nothing_sees_are_not_entered(cast_down):
    state = make_state([TRIANGLE], (0, affine()), (0, affine(offset=(0, 0, 2)), 0))
    assert cast_down(state, (0.25, 0.25)) == [(2, 1, 1, 0)]


@pytest.mark.parametrize("layout", LAYOUT_WIDTHS)
def test_the_tree_of_an_instance_is_that_of_its_mesh(count, layout):
    """Behind the only instance's box, the steps are those through the mesh, and one over the instance."""
    knot = make_shape("knot", triangles=2000)
    generator = np.random.default_rng(3)
    origins, targets = generator.normal(size=(2, 500, 3))
    origins *= 4 / np.linalg.norm(origins, axis=1)[:, None]
    steps = count(make_state([knot], (0, affine((2, 2, 2)))), 2 * origins, 2 * (targets - origins), layout)
    alone = count(build(knot), origins, targets - origins, layout)
    entered = steps["node_steps"] > 1
    assert entered.sum() > 300
    np.testing.assert_array_equal(steps["node_steps"][entered], 1 + alone["node_steps"][entered])
    for field in ("prim_tests", "leaf_visits", "prim_id"):
        np.testing.assert_array_equal(steps[field], alone[field], field)


@pytest.mark.parametrize("seed", [5])
@pytest.mark.parametrize("layout", LAYOUT_WIDTHS)
def test_spheres_are_counted_as_triangles_are(count, seed, layout):
    """Alone, and as an instance beside one that no ray meets."""
    generator = np.random.default_rng(seed)
    balls = Spheres(generator.uniform(-1, 1, (300, 3)), generator.uniform(0.05, 0.2, 300))
    origins, targets = generator.normal(size=(2, 500, 3))
    alone = count(make_state([balls], (0, affine())), origins, targets - origins, layout)
    far = count(make_state([balls], (0, affine()), (0, affine(offset=1e6))), origins, targets - origins, layout)
    assert (alone["prim_id"] >= 0).sum() > 100
    for field in ("prim_tests", "leaf_visits", "prim_id"):
        np.testing.assert_array_equal(alone[field], far[field], field)
    assert mean_steps(alone)["node_steps"] < mean_steps(far)["node_steps"]


@pytest.mark.parametrize("seed", [5])
@pytest.mark.parametrize("far", [0.0, 1e7], ids=["near", "far"])
def test_what_is_hit_is_what_a_tracer_hits(count, session, seed, far):
    generator = np.random.default_rng(seed)
    shapes = [make_shape("knot", triangles=2000), Spheres(generator.uniform(-1, 1, (300, 3)), 0.1)]
    state = make_state(
        shapes,
        *((number % 2, affine(random_linear(generator), far + generator.uniform(-9, 9, 3))) for number in range(20)),
        (0, affine(), 0),
    )
    origins = far + generator.uniform(-20, 20, (4000, 3))
    directions = far + generator.uniform(-9, 9, (4000, 3)) - origins
    steps = count(state, origins, directions)
    with StateTracer(state, session.info, [build_shape(shape) for shape in shapes]) as tracer:
        hits = tracer.closest_prim(origins, directions)
    assert 1000 < (hits >= 0).sum() < 4000
    np.testing.assert_array_equal(steps["prim_id"], hits)
