"""What rays cost: by hand on tiny trees, by formula on regular ones, in worlds of instances, and what they hit."""

import numpy as np
import pytest

from clbvh import Mesh, build, make_shape
from clbvh.rendering.heat_map import mean_steps, open_counter
from clbvh.trace.hits.closest import count_steps
from clbvh.tree_layouts import TREE_LAYOUTS

from ..hand_made import make_leaf, make_tree
from .scene_states import affine, make_state


@pytest.fixture
def count(session):
    """Count the steps of rays at a tree or a state."""

    def count_in(source, origins, directions, layout="bvh2"):
        with open_counter(source, session.info, layout) as caster:
            return count_steps(caster, origins, directions)

    return count_in


def test_steps_by_hand(count):
    """Nodes, leaves and primitives, and what is hit, by rays straight down at some (x, y)."""
    triangle = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    above, hidden = affine(offset=(0, 0, 2)), 0
    for source, layouts, rows in (
        (make_tree(), ("bvh2",), {
            (0.25, 0.25): (1, 1, 2, 0),  # the box of the first leaf only
            (6.25, 0.25): (2, 1, 1, 3),  # the other child, and one of its leaves
            (9.0, 0.25): (1, 0, 0, -1),  # neither child: the root's step is all
            # Both; the second one's box is entered first. It has the hit; what was pushed is visited all the same.
            (2.25, 0.25): (2, 2, 3, 1),
        }),
        *((make_leaf(prims), TREE_LAYOUTS, {(0.25, 0.25): (1, 1, prims, 0), (50.0, 0.25): (1, 0, 0, -1)})
          for prims in (1, 3, 4)),
        # The root of the tree over two instances, and that of each, are a step each; behind a hit no leaf is visited.
        (make_state([triangle], (0, affine()), (0, above)), ("bvh2",),
         {(0.25, 0.25): (3, 1, 1, 0), (0.75, 0.75): (3, 2, 2, -1), (3.0, 3.0): (1, 0, 0, -1)}),
        (make_state([triangle], (0, affine()), (0, above, hidden)), ("bvh2",), {(0.25, 0.25): (2, 1, 1, 0)}),
    ):  # fmt: skip
        for layout in layouts:
            steps = count(source, [[x, y, 10.0] for x, y in rows], [0.0, 0.0, -1.0], layout)
            assert steps.tolist() == list(rows.values()), layout
    steps = count(make_tree(), [[0.25, 0.25, 10.0], [2.25, 0.25, 10.0]], [0.0, 0.0, -1.0])
    assert mean_steps(steps) == {"node_steps": 1.5, "leaf_visits": 1.5, "triangle_tests": 2.5, "tests": 4.0}
    assert set(mean_steps(count(make_tree(), np.empty((0, 3)), np.empty((0, 3)))).values()) == {0.0}


@pytest.mark.parametrize("name", ["knot", "boxes"])
def test_axis_parallel_rays_visit_no_more_than_slightly_turned_ones(count, name):
    """A slab test that lets 0 x infinity through makes them visit nearly every leaf."""
    mesh, generator = make_shape(name, triangles=20_000, seed=2), np.random.default_rng(2)
    lower, size = mesh.vertices.min(axis=0), np.ptp(mesh.vertices, axis=0)
    directions = np.zeros((6000, 3))
    directions[np.arange(6000), np.arange(6000) % 3] = np.where(np.arange(6000) % 2 == 0, 1.0, -1.0)
    directions[directions == 0] *= np.where(generator.random(12_000) < 0.5, 1, -1)  # zeros of both signs
    # Half of them in planes in which vertices lie, and so do sides of boxes.
    targets = lower + generator.random((6000, 3)) * size
    targets[::2] = mesh.vertices[generator.integers(0, len(mesh.vertices), 3000)]
    turned = directions + 2e-3 * generator.normal(size=(6000, 3)) * (directions == 0)
    visits = []
    for way in (directions, turned):
        means = mean_steps(count(build(mesh), targets - 2 * size.max() * way + mesh.origin, way))
        visits.append(means["node_steps"] + means["leaf_visits"])
    assert visits[0] <= 1.1 * visits[1]
