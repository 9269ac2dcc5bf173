"""Comparison of pictures with stored references.

`REFRESH=1 make test TESTS=tests/image` writes the references anew; look at them before committing. A failure
leaves obtained, expected and difference in `out/image-tests/`.
"""

import os
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest

REFERENCES = Path(__file__).parent / "reference"
FAILURES = Path(__file__).parents[2] / "out" / "image-tests"

# Colours are rounded from values that devices may compute one rounding apart.
COLOUR_STEPS = 1


@pytest.fixture
def compare_with_reference():
    """A function that compares a picture with the stored one of that name."""

    def compare(name: str, rgb: np.ndarray) -> None:
        path = REFERENCES / f"{name}.png"
        if os.environ.get("REFRESH"):
            imageio.imwrite(path, rgb)
        expected = imageio.imread(path)
        assert expected.shape == rgb.shape
        difference = np.abs(expected.astype(int) - rgb)
        if difference.max() > COLOUR_STEPS:
            FAILURES.mkdir(parents=True, exist_ok=True)
            kinds = {"obtained": rgb, "expected": expected, "difference": difference.astype(np.uint8)}
            for kind, picture in kinds.items():
                imageio.imwrite(FAILURES / f"{name}-{kind}.png", picture)
            count = np.count_nonzero(difference.max(axis=2) > COLOUR_STEPS)
            pytest.fail(f"{name}: {count} pixels differ by more than {COLOUR_STEPS}; see {FAILURES}")

    return compare
