"""PPM and PGM files have a plain head and the pixels as they are."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh.errors import ConfigError
from clbvh.rendering.formats.ppm import encode_ppm


@pytest.mark.parametrize(("channel_count", "kind"), [(1, b"P5"), (3, b"P6")])
@pytest.mark.parametrize(("dtype", "most"), [(np.uint8, b"255"), (np.uint16, b"65535")])
def test_the_head_and_the_high_byte_come_first(channel_count, kind, dtype, most):
    pixels = np.arange(2 * 5 * channel_count, dtype=dtype).reshape(2, 5, channel_count) * dtype(7)
    data = encode_ppm(pixels)
    head = b"\n".join((kind, b"5 2", most)) + b"\n"
    assert data.startswith(head)
    assert (np.frombuffer(data[len(head) :], np.dtype(dtype).newbyteorder(">")) == pixels.ravel()).all()


def test_alpha_is_refused():
    with pytest.raises(ConfigError, match="1 or 3 channels, not 4"):
        encode_ppm(np.zeros((2, 2, 4), np.uint8))
