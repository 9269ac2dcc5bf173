"""From lanes to bits, by the compiler's own functions and without them."""

import numpy as np
import pytest

from clbvh.layout import WIDE_NODES


@pytest.mark.parametrize("portable", [False, True])
@pytest.mark.parametrize("width", WIDE_NODES)
def test_every_mask(run_shell, width, portable):
    masks = np.arange(2**width)
    is_set = (masks[:, None] >> np.arange(width)) & 1
    values = np.where(is_set, -1, np.where(np.arange(width) % 2, 0, np.nan)).astype(np.float32)
    defines = {"WIDTH": width} | ({"PORTABLE": 1} if portable else {})
    bits, lowest = run_shell("pack_lanes", [values], [np.uint32, np.int32], defines)
    np.testing.assert_array_equal(bits, masks)
    np.testing.assert_array_equal(lowest, np.where(is_set.any(axis=1), is_set.argmax(axis=1), -1))
