import itertools

import pytest

from clbvh.support.host_threads import cut_range


@pytest.mark.parametrize("count", [1, 2, 3, 7])
@pytest.mark.parametrize(("begin", "end"), [(0, 0), (5, 6), (0, 100), (17, 1_000_003)])
def test_parts_cover_a_range_once_and_are_nearly_equal(begin, end, count):
    parts = cut_range(begin, end, count)
    assert len(parts) == count
    assert (parts[0][0], parts[-1][1]) == (begin, end)
    assert all(left[1] == right[0] for left, right in itertools.pairwise(parts))
    sizes = [part_end - part_begin for part_begin, part_end in parts]
    assert max(sizes) - min(sizes) <= 1
