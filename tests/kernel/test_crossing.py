"""What is remembered of the nearest crossing."""

import numpy as np
import pytest

from clbvh.structs import HIT, NO_PRIM


@pytest.fixture(scope="module")
def kept(run_shell, make_rays):
    rays = make_rays([[0, 0, 0]] * 4, [[0, 0, 1]], t_min=0, t_max=[np.inf, np.inf, 2, 5])
    earlier = np.array(
        [(np.inf, 0, 0, NO_PRIM), (3, 0.25, 0.5, 0), (3, 0.25, 0.5, 41), (3, 0.125, 0.75, 2**31 - 1)], HIT
    )
    return earlier, run_shell("keep_crossing", [rays, earlier], [HIT, HIT, np.int32, np.float32])


def test_nothing_is_a_miss(kept):
    _, (none, _, _, _) = kept
    assert none.tolist() == [(np.inf, 0.0, 0.0, NO_PRIM)] * 4


def test_a_crossing_becomes_a_hit(kept):
    earlier, (_, hits, _, _) = kept
    np.testing.assert_array_equal(hits, earlier)


def test_face_0_counts_as_found(kept):
    _, (_, _, is_found, _) = kept
    assert is_found.tolist() == [0, 2, 2, 2]


def test_the_search_ends_at_the_crossing_or_at_t_max(kept):
    _, (_, _, _, limits) = kept
    assert limits.tolist() == [np.inf, 3, 2, 3]
