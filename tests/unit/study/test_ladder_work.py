"""The counted work of the ladder, against formulas and against the trees that it builds."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import BuildOptions, Mesh, build, make_shape
from clbvh.builders.ladder.variants import VARIANTS
from clbvh.study.ladder_work import count_ladder_work

COUNT = 1500


@pytest.fixture(scope="module")
def mesh():
    return make_shape("knot", triangles=COUNT)


@pytest.fixture(scope="module")
def works(mesh):
    return {name: count_ladder_work(mesh, name) for name in VARIANTS}


def pair_of_triangles():
    """Return two triangles along x, in the wrong order."""
    corners = np.array([[[5, 0, 0], [6, 0, 0], [5, 1, 0]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]]], float)
    return Mesh.from_arrays(corners.reshape(-1, 3), np.arange(6).reshape(2, 3))


def test_two_triangles_by_hand():
    options = BuildOptions(leaf_size=1)
    # One comparison; the second number is written to the first place, and the first to the second. Leaves write theirs.
    work = count_ladder_work(pair_of_triangles(), "range", options)
    assert (work.comparisons, work.bin_lookups) == (1, 0)
    assert work.moves == 2 + 2
    # Three nodes from the heap, no lists.
    assert work.allocations == 3
    # The root bounds both, each leaf one; each bound asks for a box and three coordinates; a comparison for two more.
    assert work.boxes == 4 * (2 + 1 + 1) + 2
    # Lists: two more allocations, and both numbers are copied.
    copying = count_ladder_work(pair_of_triangles(), "naive", options)
    assert (copying.allocations, copying.moves) == (5, work.moves + 2)
    # Each is looked up once to count and once to part them.
    binned = count_ladder_work(pair_of_triangles(), "flat", options)
    assert (binned.comparisons, binned.bin_lookups, binned.allocations, binned.boxes) == (0, 4, 0, 2)


def test_variants_that_make_the_same_steps_have_the_same_counts(works):
    assert works["sequential"] == works["naive"]
    assert works["range"].comparisons == works["cached"].comparisons == works["naive"].comparisons
    assert works["bin"].bin_lookups == works["flat"].bin_lookups == works["atomic"].bin_lookups


def test_boxes_are_computed_once_from_cached_on(works, mesh):
    for name, variant in VARIANTS.items():
        if variant.cached:
            assert works[name].boxes == mesh.face_count
        else:
            assert works[name].boxes > 2 * works[name].comparisons


def test_each_idea_saves_what_it_should(works):
    assert works["range"].allocations < works["naive"].allocations
    assert works["median"].comparisons < works["cached"].comparisons
    assert works["median"].moves < works["cached"].moves
    assert works["frontier"].bin_lookups < works["flat"].bin_lookups


def test_a_sort_needs_n_log_n_comparisons_at_most(works, mesh):
    n = mesh.face_count
    levels = np.log2(n)
    # Each level of the tree sorts all primitives once more; insertion makes short runs a little dearer.
    assert works["cached"].comparisons < 1.5 * n * levels * levels


@pytest.mark.parametrize("name", ["sequential", "bin", "flat"])
def test_allocations_are_those_of_the_tree(works, mesh, name):
    nodes = build(mesh, builder=name).node_count
    expected = {"sequential": nodes + nodes - 1, "bin": nodes, "flat": 0}
    assert works[name].allocations == expected[name]


def test_the_default_number_of_bins_is_the_ladders(mesh):
    assert count_ladder_work(mesh, "flat") == count_ladder_work(mesh, "flat", BuildOptions(bins=8))
    assert count_ladder_work(mesh, "flat") != count_ladder_work(mesh, "flat", BuildOptions(bins=4))
