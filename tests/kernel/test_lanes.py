"""From lanes to bits, by the compiler's own functions and without them."""

import numpy as np
import pytest

from clbvh.structs import LAYOUT_WIDTHS

from .test_slabs import LAYOUT_NAMES


@pytest.mark.parametrize("portable", [False, True])
@pytest.mark.parametrize("layout", LAYOUT_NAMES)
def test_every_mask(run_lane_shell, layout, portable):
    width = LAYOUT_WIDTHS[layout]
    masks = np.arange(2**width)
    is_set = (masks[:, None] >> np.arange(width)) & 1
    values = np.where(is_set, -1, np.where(np.arange(width) % 2, 0, np.nan)).astype(np.float32)
    bits, lowest = run_lane_shell(layout, "pack_lanes", [values], [np.uint32, np.int32], portable=portable)
    np.testing.assert_array_equal(bits, masks)
    np.testing.assert_array_equal(lowest, np.where(is_set.any(axis=1), is_set.argmax(axis=1), -1))
