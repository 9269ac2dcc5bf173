"""What rays cost: by hand on tiny trees, by formula on regular ones, and against what the device finds."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import Mesh, Tracer, build, make_shape
from clbvh.trace.check.visits import count_visits

from ...rays import centred, hard_rays
from ...soup import make_soup
from ..hand_made import make_leaf, make_tree

DOWN = [0.0, 0.0, -1.0]
ABOVE = 10.0


def per_ray(visits):
    return visits.node_steps_per_ray + visits.leaf_visits_per_ray


def cast_down(bvh, x, y, **limits):
    visits = count_visits(bvh, [[x, y, ABOVE]], [DOWN], **limits)
    return visits.node_steps[0], visits.leaf_visits[0], visits.triangle_tests[0], visits.prim_id[0]


@pytest.mark.parametrize(
    ("x", "limits", "expected"),
    [
        (0.25, {}, (1, 1, 2, 0)),  # the box of the first leaf only
        (6.25, {}, (2, 1, 1, 3)),  # the other child, and one of its leaves
        (9.0, {}, (1, 0, 0, -1)),  # neither child: the root's step is all
        # Both children; the second one's box is entered first. It has the hit; what was pushed is visited all the same.
        (2.25, {}, (2, 2, 3, 1)),
        (2.25, {"any_hit": True}, (2, 1, 1, 1)),
        (2.25, {"t_max": 7.5}, (2, 0, 0, -1)),  # ends between the box at t = 7 and the leaf at t = 9
        (2.25, {"t_min": 10.5}, (1, 0, 0, -1)),  # begins behind all that there is
    ],
)
def test_the_hand_made_tree(x, limits, expected):
    assert cast_down(make_tree(), x, 0.25, **limits) == expected


@pytest.mark.parametrize("count", [1, 3])
def test_a_tree_that_is_one_leaf(count):
    assert cast_down(make_leaf(count), 0.25, 0.25) == (1, 1, count, 0)
    assert cast_down(make_leaf(count), 50.0, 0.25) == (1, 0, 0, -1)


@pytest.mark.parametrize("count", [2, 5, 64])
def test_a_ray_through_every_box_and_no_triangle(count):
    """Triangles one behind the other, which leave half of their boxes' faces free."""
    corners = np.zeros((count, 3, 3))
    corners[:, :, 0] = np.arange(count)[:, None]
    corners[:, 1, 1] = corners[:, 2, 2] = 1
    mesh = Mesh.from_arrays(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
    visits = count_visits(build(mesh, leaf_size=1), [[-1, 0.9, 0.9]], [[1, 0, 0]])
    assert (visits.node_steps[0], visits.leaf_visits[0], visits.triangle_tests[0]) == (count - 1, count, count)
    assert visits.tests_per_ray == 2 * count - 1
    assert per_ray(visits) == 2 * count - 1
    # From within: only what lies ahead.
    within = count_visits(build(mesh, leaf_size=1), [[count - 1.5, 0.9, 0.9]], [[1, 0, 0]])
    assert (within.leaf_visits[0], within.triangle_tests[0]) == (1, 1)


def test_means():
    visits = count_visits(make_tree(), [[0.25, 0.25, ABOVE], [2.25, 0.25, ABOVE]], [DOWN, DOWN])
    assert visits.tests_per_ray == (3 + 5) / 2
    assert per_ray(visits) == (2 + 4) / 2
    nothing = count_visits(make_tree(), np.empty((0, 3)), np.empty((0, 3)))
    assert (nothing.tests_per_ray, per_ray(nothing)) == (0, 0)


@pytest.mark.parametrize("seed", [3])
def test_the_walk_finds_what_the_device_finds(session, seed):
    mesh = centred(make_soup(2000, seed, grid=200))
    bvh = build(mesh)
    origins, directions = hard_rays(mesh, 6000, np.random.default_rng(seed))
    visits = count_visits(bvh, origins, directions)
    with Tracer(bvh) as tracer:
        hits = tracer.closest_hit(origins, directions)
        assert (visits.prim_id == hits.prim_id).all()
        any_hit = count_visits(bvh, origins, directions, any_hit=True)
        assert ((any_hit.prim_id >= 0) == tracer.any_hit(origins, directions)).all()
    assert (any_hit.node_steps <= visits.node_steps).all()
    assert any_hit.tests_per_ray < visits.tests_per_ray


def test_bad_rays_are_refused():
    with pytest.raises(ValueError, match=r"directions\[1\] has length zero"):
        count_visits(make_tree(), np.zeros((2, 3)), [[1, 0, 0], [0, 0, 0]])


@pytest.mark.parametrize("seed", [2])
@pytest.mark.parametrize("name", ["knot", "blobs", "boxes", "icosphere", "terrain", "palace"])
def test_axis_parallel_rays_visit_no_more_than_slightly_turned_ones(name, seed):
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
    along, aslant = (
        per_ray(count_visits(bvh, targets - reach * way + mesh.origin, way)) for way in (directions, turned)
    )
    assert along <= 1.1 * aslant
