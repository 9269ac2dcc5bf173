"""Any triangles, any rays: the hits of the device are right, and a tree changes none of them.

Coordinates lie on a grid, where float32 decides exactly: near-misses cannot make two answers right.
"""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from clbvh import Mesh, Tracer, build
from clbvh.structs import LAYOUT_WIDTHS
from clbvh.trace.hits.hits import Hits

from ..kernel.casting import open_caster
from ..mesh_reference import find_differences, find_wrong_crossings
from ..profiles import examples
from ..rays import centred

GRID = 16
RAYS = 200

# Repeated triangles, axis-parallel ones and lines are more frequent than by chance.
coordinate = st.integers(-GRID, GRID)
corner = st.tuples(coordinate, coordinate, coordinate)
triangle = st.one_of(
    st.tuples(corner, corner, corner),
    st.tuples(corner, st.integers(0, 2), st.integers(1, 5), st.integers(-5, 5)).map(
        lambda p: tuple(
            tuple(x + (i == (p[1] + 1) % 3) * step + (i == (p[1] + 2) % 3) * lift for i, x in enumerate(p[0]))
            for step, lift in ((0, 0), (p[2], 0), (0, p[3]))
        )
    ),
)
soup = st.lists(triangle, min_size=1, max_size=60)


@st.composite
def scenes(draw):
    """A soup, a leaf size, and rays: some aimed at corners, some along axes, all of them from the grid."""
    corners = np.array(draw(soup), np.float64)
    generator = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    mesh = centred(Mesh.from_arrays(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)))
    origins = generator.integers(-2 * GRID, 2 * GRID, (RAYS, 3), endpoint=True).astype(np.float64)
    directions = generator.integers(-GRID, GRID, (RAYS, 3), endpoint=True).astype(np.float64)
    vertices = mesh.vertices[generator.integers(0, len(mesh.vertices), RAYS)]
    kind = generator.integers(0, 4, RAYS)
    directions[kind == 1] = (vertices - origins)[kind == 1]
    axis = generator.integers(0, 3, RAYS)
    along = np.eye(3)[axis] * generator.choice([-1.0, 1.0], (RAYS, 1))
    directions[kind >= 2] = along[kind >= 2]
    origins[kind == 3] = (vertices - along * generator.integers(0, GRID, (RAYS, 1)))[kind == 3]
    directions[(directions == 0).all(axis=1)] = [0, 0, 1]
    return mesh, draw(st.sampled_from([1, 2, 8])), origins, directions


@pytest.fixture(scope="module")
def opened(_opened_device):
    return _opened_device


@examples(short=40, long=2000)
@given(scene=scenes())
def test_hits_are_right_with_and_without_a_tree(opened, scene):
    mesh, leaf_size, origins, directions = scene
    bvh = build(mesh, leaf_size=leaf_size)
    with open_caster(opened, mesh, None) as brute:
        hits = brute("closest_hit", origins, directions)
    # Rays of like directions beside each other, so that their beams are narrow.
    order = np.lexsort((*origins.T, *directions.T))
    for layout in LAYOUT_WIDTHS:
        with open_caster(opened, mesh, bvh, layout) as cast:
            assert hits.tobytes() == cast("closest_hit", origins, directions).tobytes(), layout
            is_hit = cast("any_hit", origins, directions)
        np.testing.assert_array_equal(is_hit, hits["prim_id"] >= 0)
        with open_caster(opened, mesh, bvh, layout, tile=(4, 1), with_entry_points=True) as cast:
            assert hits[order].tobytes() == cast("closest_hit", origins[order], directions[order]).tobytes(), layout
    differences = find_differences(mesh, origins, directions, Hits(hits["t"], hits["u"], hits["v"], hits["prim_id"]))
    assert [str(difference) for difference in differences] == []


@examples(short=20, long=1000)
@given(scene=scenes())
def test_all_crossings_are_right_and_every_query_agrees(opened, scene):
    mesh, leaf_size, origins, directions = scene
    with Tracer(build(mesh, leaf_size=leaf_size), device=opened.info) as tracer:
        hits = tracer.all_hits(origins, directions)
        closest = tracer.closest_hit(origins, directions)
        np.testing.assert_array_equal(tracer.count_hits(origins, directions), hits.counts)
    np.testing.assert_array_equal(closest.is_hit, hits.counts > 0)
    np.testing.assert_array_equal(hits.prim_id[hits.offsets[:-1][closest.is_hit]], closest.prim_id[closest.is_hit])
    assert find_wrong_crossings(mesh, origins, directions, hits).tolist() == []
    differences = find_differences(mesh, origins, directions, closest)
    assert [str(difference) for difference in differences] == []
