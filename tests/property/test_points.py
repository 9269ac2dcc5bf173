"""Any triangles, any points: the nearest triangle is right, and a tree changes no answer."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from clbvh import Mesh, Tracer, build

from ..profiles import examples
from ..rays import centred
from ..unit.trace.nearest_point import CHOICE, check_tree_and_brute_agree, expected_distance

GRID = 8

coordinate = st.integers(-GRID, GRID)
corner = st.tuples(coordinate, coordinate, coordinate)
soup = st.lists(st.tuples(corner, corner, corner), min_size=1, max_size=40)


@pytest.fixture(scope="module")
def opened(_opened_device):
    return _opened_device


@examples(short=25, long=1000)
@given(triangles=soup, seed=st.integers(0, 2**32 - 1), leaf_size=st.sampled_from([1, 2, 8]))
def test_soups_on_a_grid(opened, triangles, seed, leaf_size):
    corners = np.array(triangles, np.float64).reshape(-1, 3)
    mesh = centred(Mesh.from_arrays(corners, np.arange(len(corners)).reshape(-1, 3)))
    points = np.random.default_rng(seed).integers(-3 * GRID, 3 * GRID, (300, 3), endpoint=True) / 2
    prim_id = check_tree_and_brute_agree(opened, mesh, points, leaf_size=leaf_size)
    degenerate = mesh.degenerate_faces
    if degenerate.all():
        assert (prim_id == -1).all()
        return
    assert not degenerate[prim_id].any()
    with Tracer(build(mesh), device=opened.info) as tracer:
        distance = tracer.closest_point(points).distance
    np.testing.assert_allclose(distance, expected_distance(mesh, points), rtol=0, atol=CHOICE * 4 * GRID)
